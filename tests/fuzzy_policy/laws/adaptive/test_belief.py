"""The constants of the arm of p, against the arms that the environment itself makes of the same factors."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm import ArmParameters, robot_named
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants
from fuzzyarm.envs.physics.equations import equations_of, two_joints
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.fuzzy_policy.known_arm import with_drives
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights, affine_numbers, belief_of, prior, unit_force

ARM, ROBOT = ArmParameters(), robot_named("planar-3r")
BELIEF, PRIOR = belief_of(two_joints()), prior(ARM, AdaptiveWeights())
FIELDS = {
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "friction": ("static_friction", "coulomb_friction"),
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
}


def test_constants_of_any_belief_are_those_of_the_arm_with_these_factors_and_payload():
    rng, (base, slopes) = np.random.default_rng(0), affine_numbers(ARM)
    for payload in rng.uniform(0.0, 10.0, 20):
        p, changes = PRIOR.guess.copy(), {}
        p[BELIEF.payload] = payload
        for name, fields in FIELDS.items():
            factors = p[getattr(BELIEF, name)] = rng.uniform(0.7, 1.4, 2)
            changes |= {field: tuple(np.array(getattr(ARM, field)) * factors) for field in fields}
        expected = arm_constants(dataclasses.replace(ARM, **changes), Payload(payload))
        np.testing.assert_allclose(base + slopes @ (p - PRIOR.guess), flat(expected), rtol=1e-12)


def test_numbers_of_any_belief_are_those_of_the_robot_with_these_drives_masses_and_payload():
    physics, rng = equations_of(ROBOT), np.random.default_rng(1)
    belief, (base, slopes), guess = belief_of(physics), affine_numbers(ROBOT), prior(ROBOT, AdaptiveWeights()).guess
    p, changes = guess.copy(), {}
    p[belief.payload] = 1.5
    for name, fields in FIELDS.items():
        factors = p[getattr(belief, name)] = rng.uniform(0.7, 1.4, 3)
        if name != "mass":
            changes |= {field: factors * ROBOT.drive(field) for field in fields}
    robot, joints = with_drives(ROBOT, **changes), []
    for joint, factor in zip(robot.joints, p[belief.mass].tolist(), strict=True):
        inertia = tuple(map(tuple, (factor * np.array(joint.link.inertia)).tolist()))
        link = dataclasses.replace(joint.link, mass=factor * joint.link.mass, inertia=inertia)
        joints.append(dataclasses.replace(joint, link=link))
    expected = [*physics.plant_of(dataclasses.replace(robot, joints=tuple(joints))), 1.5]
    np.testing.assert_allclose(base + slopes @ (p - guess), expected, rtol=1e-12)


def test_the_first_guess_is_allowed_and_weights_out_of_range_are_refused_by_name():
    assert np.all(PRIOR.low <= PRIOR.guess) and np.all(PRIOR.guess <= PRIOR.high)
    assert unit_force(ARM) * sum(ARM.length) == ARM.torque_limit[0]
    with pytest.raises(ValueError, match=r"AdaptiveWeights.gate = 0.*allowed"):
        AdaptiveWeights(gate=0.0)
    with pytest.raises(TypeError, match=r"AdaptiveWeights.dead_zone"):
        AdaptiveWeights(dead_zone="wide")
