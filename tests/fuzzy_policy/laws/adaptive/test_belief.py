"""The constants of the arm of p, against the arms that the environment itself makes of the same factors."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import (
    BELIEF,
    BELIEFS,
    FORCES,
    affine_constants,
    allowed,
    first_guess,
    first_spread,
    walks,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights, unit_force

ARM = ArmParameters()
FIELDS = {
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "friction": ("static_friction", "coulomb_friction"),
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
}


def test_constants_of_any_belief_are_those_of_the_arm_with_these_factors_and_payload():
    rng = np.random.default_rng(0)
    base, slopes = affine_constants(ARM)
    for _ in range(20):
        p = first_guess()
        p[BELIEF.payload] = rng.uniform(0.0, 10.0)
        changes = {}
        for name, fields in FIELDS.items():
            factors = p[getattr(BELIEF, name)] = rng.uniform(0.7, 1.4, 2)
            for field in fields:
                changes[field] = tuple(np.array(getattr(ARM, field)) * factors)
        expected = arm_constants(dataclasses.replace(ARM, **changes), Payload(float(p[BELIEF.payload][0])))
        np.testing.assert_allclose(base + slopes @ (p - first_guess()), expected, rtol=1e-12)


def test_forces_come_first_and_change_no_constant():
    assert BELIEF.force.stop == FORCES
    assert np.all(affine_constants(ARM)[1][:, :FORCES] == 0.0)
    assert np.all(affine_constants(ARM)[1][:, BELIEF.lateness] == 0.0)


def test_first_guess_lies_within_what_is_allowed_and_only_loads_walk():
    low, high = allowed(ARM, 3.0)
    assert np.all(low <= first_guess()) and np.all(first_guess() <= high)
    assert np.all(first_spread(ARM, AdaptiveWeights()) > 0.0)
    walking = walks(ARM, AdaptiveWeights())
    assert np.all(walking[:FORCES] > 0.0) and np.all(walking[FORCES:] == 0.0)
    assert len(walking) == BELIEFS


def test_unit_force_at_the_stretched_arm_takes_the_first_motor_to_its_limit():
    assert unit_force(ARM) * sum(ARM.length) == ARM.torque_limit[0]


def test_weights_out_of_range_are_refused_by_name():
    with pytest.raises(ValueError, match=r"AdaptiveWeights.gate = 0.*allowed"):
        AdaptiveWeights(gate=0.0)
    with pytest.raises(TypeError, match=r"AdaptiveWeights.dead_zone"):
        AdaptiveWeights(dead_zone="wide")
