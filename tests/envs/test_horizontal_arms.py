"""Arms that gravity does not move: none acts on them, or it points along their axes."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.cases import case_for, load_scale
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.ts_model import TSModel, premises
from fuzzyarm.identification.excitation import suggested
from fuzzyarm.synthesis import Specification, design

FLAT = ArmParameters(
    gravity=0.0,
    length=(0.325, 0.275),
    mass=(7.0, 5.0),
    mass_center=(0.16, 0.13),
    inertia=(0.12, 0.06),
    motor_inertia=(1.2, 0.5),
    stiffness=(2e4, 1e4),
    damping=(6.0, 3.0),
)
ARMS = {
    "two joints": FLAT,
    "robot of two joints": Robot.of(FLAT),
    "none": dataclasses.replace(robot_named("planar-3r"), gravity=(0.0, 0.0, 0.0)),
    "along the axes": dataclasses.replace(Robot.of(FLAT), gravity=(0.0, 0.0, -9.81)),
    "cicese": robot_named("cicese"),
}
# Structures of their own, whose kernels take half a minute to compile.


@pytest.mark.parametrize("arm", [FLAT, ARMS["robot of two joints"], ARMS["along the axes"]])
def test_a_payload_that_no_motor_holds_is_the_papers_share_of_the_links(arm):
    """5 kg of 24 kg; 12 kg of links then carry 2.5 kg."""
    assert case_for("payload", arm).disturbance.payload.mass == 2.5
    assert load_scale(arm if isinstance(arm, Robot) else Robot.of(arm))[1] == 0.5
    assert load_scale(robot_named("planar-3r")) == (0.32, 0.54)  # of a leverage


@pytest.mark.parametrize("name", slow_but(ARMS.keys() - {"none", "along the axes"}, ARMS))
@pytest.mark.parametrize("case", ["nominal", "machining", "payload"])
def test_every_case_runs_and_is_drawn(name, case):
    env = FuzzyArmEnv(case, robot=ARMS[name], render_mode="rgb_array")
    (observation, info), state, policy = env.reset(seed=0), None, load_policy("computed-torque", robot=ARMS[name])
    if name not in ("cicese", "none"):
        assert_allclose(info["q_motor"], info["q_link"], atol=1e-12)  # nothing hangs
    for _ in range(3):
        action, state = policy.predict(observation, state)
        observation, *_, info = env.step(action)
    assert info["in_domain"] and info["tip_error"] < 1e-4
    assert env.render().shape == (720, 720, 3)


@pytest.mark.parametrize("kept", [(), ("z1", "z3")])
def test_a_fuzzy_controller_is_designed_and_acts_without_gravity_within_bounds_of_some_width(kept):
    made = design(Specification(kept, alpha=20.0, gamma=2e-3), FLAT)
    assert made.certificate.proven
    torque, _ = FuzzyPolicy(made.controller).predict(np.full(10, 0.1))
    assert np.isfinite(torque).all()
    bounds = TSModel(FLAT).bounds
    assert (bounds[:, 0] < bounds[:, 1]).all() and np.abs(bounds[1:3]).max() < 1e-11
    h, v = TSModel(FLAT, ("z1", "z3")).weights(premises(np.array([0.3, 0.4]), np.array([1.0, 2.0]), FLAT))
    assert_allclose([h.sum(), v.sum()], 1.0)


def test_a_motion_to_record_is_judged_by_what_moves_the_motors(monkeypatch):
    monkeypatch.setattr("fuzzyarm.identification.excitation._REFINEMENTS", 60)
    assert suggested(FLAT, 4.0).condition() < 1e4
