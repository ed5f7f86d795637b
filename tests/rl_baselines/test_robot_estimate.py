"""The training of `learned-observer` for robots by their frames: its draws, its teacher, and what it ships."""

import numpy as np
import pytest

pytest.importorskip("torch")

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.disturbances import ConstantForce
from fuzzyarm.envs.scenario.kinematics import freedom
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import scale_of
from fuzzyarm.rl_baselines.estimate.courses import HEAVIEST, TravelForce, _direction, _rotation, draw_courses
from fuzzyarm.rl_baselines.estimate.teacher import Teacher

PERIOD = 1e-3
SHORT = ["--chunks", "1", "--lanes", "2", "--steps", "50", "--window", "50", "--updates", "1", "--hidden", "4"]


@pytest.mark.parametrize("span", [np.eye(3)[:2], np.eye(3)[[2, 0]], np.eye(3)], ids=["xy", "zx", "space"])
def test_forces_point_where_the_tip_can_move(span):
    generator = np.random.default_rng(0)
    inside = span.T @ span
    for _ in range(50):
        direction, turn = _direction(span, generator), np.array(_rotation(span, 3, generator))
        assert np.linalg.norm(direction) == pytest.approx(1.0) and inside @ direction == pytest.approx(direction)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(inside @ turn @ direction, turn @ direction, atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)
    across = TravelForce(3.0, 0.0, 1.0, 0.0, tuple(map(tuple, turn.tolist())), 0.01).at(np.zeros(1), direction[None])
    np.testing.assert_allclose(across[0], -3.0 * turn @ direction, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("planar-3r", 96), ("ur5", 24)])
def test_what_is_drawn_is_the_robots(name, count):
    robot = robot_named(name)
    courses, scale = draw_courses(robot, count, PERIOD, np.random.default_rng(0)), scale_of(robot)
    assert np.max(courses.payload) <= HEAVIEST * scale.mass
    assert np.max(courses.payload) > 0.3 * case_for("payload", robot).disturbance.payload.mass
    courses.lanes.reset(list(range(count)))
    limit, off = robot.drive("torque_limit"), np.eye(3) - freedom(robot).motion.T @ freedom(robot).motion
    forces = []
    for lane in range(count):
        reference, schedule = courses.lanes.schedule(lane)
        time = np.linspace(0.0, reference.duration, 60)
        q, dq, ddq = reference.sample(time)[:3]
        carrying = robot.with_payload(float(courses.payload[lane]))
        torque = inverse_dynamics(carrying, q, dq, ddq) + ddq * robot.drive("motor_inertia")
        force = schedule.disturbance.tip_force
        if force is not None:
            jacobian = tip_jacobian(robot, q)
            pushed = force.at(time, np.einsum("tai,ti->ta", jacobian, dq))
            torque -= np.einsum("tai,ta->ti", jacobian, pushed)
            np.testing.assert_allclose(pushed @ off, 0.0, atol=1e-9)
            forces.append(force)
        assert np.all(np.abs(torque) < 0.92 * limit)
    assert {type(force) for force in forces} == {ConstantForce, TravelForce}


@pytest.mark.slow
def test_the_beliefs_of_the_teacher_are_the_robots_plants():
    """What a lane drew, and no more: the factors of the draw, the payload, the lateness."""
    robot = robot_named("planar-3r")
    courses, adaptive = draw_courses(robot, 6, PERIOD, np.random.default_rng(1)), AdaptiveObserverPolicy(robot, PERIOD)
    courses.lanes.reset(list(range(6)))
    p, belief = Teacher(adaptive, courses).beliefs()[:, 12:], adaptive.belief
    drawn = courses.lanes.randomisation_info()
    assert courses.lanes.randomisation.varies and np.ptp(drawn["stiffness"]) > 0.1
    for name, factor in (
        *(("stiffness", "stiffness"), ("damping", "damping"), ("friction", "dry_friction"), ("mass", "mass")),
        ("motor_inertia", "motor_inertia"),
    ):
        np.testing.assert_allclose(p[:, getattr(belief, name)], drawn[factor], atol=1e-9)
    np.testing.assert_allclose(p[:, belief.payload][:, 0], courses.payload, atol=1e-9)
    np.testing.assert_array_equal(p[:, belief.lateness][:, 0], courses.delay)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_a_training_ships_a_policy_of_the_robot(name, tmp_path):
    robot = robot_named(name)
    assert main(["train", "estimate", "--robot", name, *SHORT, "--out", str(tmp_path / "run")]) == 0
    bundle = EstimateBundle.load(tmp_path / "run" / "policy")
    assert bundle.arm == ArmDefinition(name, robot.digest)
    policy, state = load_policy(tmp_path / "run" / "policy", robot=name), None
    for _ in range(3):
        torque, state = policy.predict(np.zeros((5, 5 * len(robot))), state)
    assert torque.shape == (5, len(robot)) and np.isfinite(torque).all()
