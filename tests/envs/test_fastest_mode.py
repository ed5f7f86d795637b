"""The sub-step that the fastest mode of an arm asks for: the mode, the number, and where it is used."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.periods import default_substeps, whole_substeps
from fuzzyarm.envs.physics.dynamics import arm_constants, mass_matrix
from fuzzyarm.envs.physics.equations import chosen_arm, robot_of, two_joints
from fuzzyarm.envs.physics.integrator import hold_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.physics.robot import shipped_robots
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.stability._linearisation import largest_radius, linearise_path
from fuzzyarm.eval.sweep._plants import Plants
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.export._plant import Plant
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy

TABLE_1 = ArmParameters()
STIFF = dataclasses.replace(TABLE_1, stiffness=(1e8, 1e8))
FAST = {
    "stiff": STIFF,
    "damped": dataclasses.replace(TABLE_1, damping=(3e3, 3e3)),
    "viscous": dataclasses.replace(TABLE_1, viscous_friction=(1e4, 1e4)),
    "light rotors": dataclasses.replace(TABLE_1, motor_inertia=(1e-3, 1e-3)),
    "stiff and damped": dataclasses.replace(TABLE_1, stiffness=(1e7, 1e7), damping=(1e3, 1e3)),
}


def eigenvalues(arm, cos2=1.0):
    """Return the eigenvalues of the linear arm at rest without dry friction and gravity, at cos q2."""
    c = arm_constants(arm)
    m11, m12, m22 = mass_matrix(cos2, c)
    k, b, still = np.diag(arm.stiffness), np.diag(arm.damping), np.zeros((2, 2))
    mass = np.block([[np.diag(arm.motor_inertia), still], [still, np.array([[m11, m12], [m12, m22]])]])
    spring, damper = np.block([[k, -k], [-k, k]]), np.block([[b + np.diag(arm.viscous_friction), -b], [-b, b]])
    system = np.block([[np.zeros((4, 4)), np.eye(4)], [-np.linalg.solve(mass, spring), -np.linalg.solve(mass, damper)]])
    return np.linalg.eigvals(system)


@pytest.mark.parametrize("arm", [TABLE_1, *FAST.values()], ids=["table 1", *FAST])
def test_the_rate_bounds_every_eigenvalue_of_the_arm_closely(arm):
    largest = max(np.abs(eigenvalues(arm, cos2)).max() for cos2 in np.linspace(-1.0, 1.0, 41))
    assert largest * (1.0 - 1e-9) <= fastest_rate([arm]) <= 1.5 * largest


def test_the_worst_corner_of_what_is_drawn_is_the_stiffest_and_lightest_plant():
    light = {"mass": (0.5, 2.0), "motor_inertia": (0.2, 3.0)}
    stiff = {"stiffness": (0.1, 4.0), "damping": (0.0, 5.0), "viscous_friction": (0.0, 6.0)}
    worst = {name: ends[0] for name, ends in light.items()} | {name: ends[1] for name, ends in stiff.items()}
    worst["inertia"] = worst["mass"]
    corner = {name: tuple(factor * number for number in getattr(TABLE_1, name)) for name, factor in worst.items()}
    drawn = fastest_rate([TABLE_1], DomainRandomisation(**light, **stiff, payload=(0.0, 9.0)))
    assert_allclose(drawn, fastest_rate([dataclasses.replace(TABLE_1, **corner)]), rtol=1e-12)
    assert drawn > 3.0 * fastest_rate([TABLE_1])


@pytest.mark.parametrize("arm", FAST.values(), ids=FAST)
def test_a_step_is_stable_below_the_bound_and_the_default_shows_what_a_fine_one_does(arm):
    """The spectral radius of the discrete step, by differences, at the default and just below the bound."""
    smooth = dataclasses.replace(arm, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0), gravity=1e-9)
    constants = np.tile(np.array(flat(arm_constants(smooth)))[:, np.newaxis], 8)
    rate, hold = fastest_rate([arm]), hold_of(two_joints())
    for share in (1.0, 1.98):
        state = 1e-6 * np.eye(8)
        hold(state, np.zeros((2, 8)), np.zeros((4, 8)), constants, share / rate, 1)
        # Two modes do not move: all angles turned alike where nothing holds them.
        assert np.abs(np.linalg.eigvals(state / 1e-6)).max() < 1.0 + 1e-6

    def angles(substep):
        env = FuzzyArmEnv(parameters=arm, substep=substep)
        env.reset(seed=0)
        turns = 2.0 * np.pi / 50.0 * np.arange(60)
        return [env.step(np.sin(turn) * np.array([20.0, 8.0]))[4]["q_link"] for turn in turns]

    assert_allclose(angles(None), angles(2e-6), atol=5e-5)


@pytest.mark.parametrize("name", ["paper", *shipped_robots()])
@pytest.mark.parametrize("randomisation", ["nominal", "plants"])
def test_shipped_arms_keep_the_five_sub_steps_of_a_millisecond(name, randomisation):
    arm = chosen_arm(name, None)
    rate = fastest_rate([arm], find_randomisation(randomisation, arm))
    assert [whole_substeps(period, None, rate) for period in (2e-4, 1e-3, 2e-3)] == [1, 5, 10]


def test_every_loop_of_one_arm_has_the_same_sub_steps():
    count = default_substeps(1e-3, fastest_rate([STIFF]))
    assert count == 27
    assert FuzzyArmEnv(parameters=STIFF).substeps == count == FuzzyArmEnv("payload", robot=robot_of(STIFF)).substeps
    assert {FuzzyArmEnv(case, parameters=STIFF).substeps for case in PAPER_CASES} == {count}
    assert FuzzyArmVectorEnv(2, parameters=[TABLE_1, STIFF]).substeps == count
    assert Plant(STIFF)._substeps == ElasticObserverPolicy(STIFF)._substeps == count
    light = FAST["light rotors"]
    assert AdaptiveObserverPolicy(light).settings.substeps == FuzzyArmEnv(parameters=light).substeps == 21
    drawn = DomainRandomisation(stiffness=(1.0, 4.0))
    assert FuzzyArmEnv(parameters=STIFF, randomisation=drawn).substeps == pytest.approx(2 * count, abs=1)
    grid = ("stiffness", 1.0, 100.0, 2), ("mass", 1.0, 2.0, 2)
    config = SweepConfig.of({"grid": grid, "parameters": STIFF, "chunk": 1})
    assert {Plants(config, [member], ["nominal"]).envs.substeps for member in range(4)} == {266}
    assert largest_radius(linearise_path(ComputedTorquePolicy(STIFF), STIFF, 1e-3)) < 1.0


def test_an_arm_that_no_sub_step_can_do_is_refused_with_the_one_it_needs():
    message = r"sub-steps of 4\.87e-08 s or less, but a period of 0\.001 s may have at most 10000 sub-steps; choose a"
    with pytest.raises(ValueError, match=message):
        FuzzyArmEnv(parameters=dataclasses.replace(TABLE_1, motor_inertia=(1e-6, 1e-6)))
    with pytest.raises(ValueError, match="needs sub-steps of 0 s"):
        default_substeps(1e-3, np.inf)
    assert default_substeps(1e-3, 10_000 / 1e-3) == 10_000
    with pytest.raises(ValueError, match=r"substep = 0\.0002 s is too long: .* use substep = 3\.7037e-05 s"):
        FuzzyArmEnv(parameters=STIFF, substep=2e-4)
    assert FuzzyArmEnv(parameters=STIFF, substep=5e-5).substeps == 20
