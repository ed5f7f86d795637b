"""A robot of n joints from logs: the regressor against the inverse dynamics, bodies that can exist, held-out torque."""

import dataclasses

import numpy as np
import pytest
from support.recorded import recorded

from fuzzyarm.envs.physics.joint import Link, as_rows
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.identification._links import _Cones, _numbers_of, _robot_with, body_regressor
from fuzzyarm.identification.result import identify


def wrong(robot, seed=1):
    """The robot with links and drives that are 0.7 to 1.4 times the true ones."""
    rng, joints = np.random.default_rng(seed), []
    for joint in robot.joints:
        heavier, rotor = rng.uniform(0.7, 1.4, 2)
        center = tuple(np.array(joint.link.center) * rng.uniform(0.8, 1.2))
        link = Link(heavier * joint.link.mass, center, as_rows(heavier * np.array(joint.link.inertia)))
        drive = dataclasses.replace(joint.drive, motor_inertia=rotor * joint.drive.motor_inertia)
        joints.append(dataclasses.replace(joint, link=link, drive=drive))
    return dataclasses.replace(robot, joints=tuple(joints))


@pytest.mark.parametrize("name", ["planar-3r", "ur5", "panda"])
def test_the_inverse_dynamics_are_linear_in_the_numbers_of_the_links(name):
    robot, (q, dq, ddq) = robot_named(name), np.random.default_rng(0).normal(size=(3, 20, len(robot_named(name))))
    other = wrong(robot)
    Y = body_regressor(robot, q, dq, ddq)
    for one in (robot, other):
        torque = Y @ _numbers_of(one)[: Y.shape[-1]]
        np.testing.assert_allclose(torque, inverse_dynamics(one, q, dq, ddq), rtol=1e-9, atol=1e-9)
    again = _robot_with(_numbers_of(other), other)
    np.testing.assert_allclose(_numbers_of(again), _numbers_of(other), rtol=1e-9, atol=1e-12)


def test_the_least_squares_of_bodies_that_can_exist_are_optimal():
    """No feasible point nearby costs less, and the unconstrained point is found where it is feasible."""
    robot, rng = robot_named("planar-3r"), np.random.default_rng(0)
    cones = _Cones(robot)
    root = rng.normal(size=(len(cones.scale), len(cones.scale)))
    H, inside = root @ root.T + np.eye(len(root)), _numbers_of(robot) / cones.scale
    np.testing.assert_allclose(cones.minimum(H, H @ inside), inside, atol=1e-5)
    b = H @ (inside + rng.normal(size=len(inside)))
    best = cones.minimum(H, b)
    np.testing.assert_allclose(cones.projected(cones.matrix @ best), cones.matrix @ best, atol=1e-9)

    def cost(x):
        return 0.5 * x @ H @ x - b @ x

    for _ in range(200):
        beside = cones.projected(cones.matrix @ (best + 1e-2 * rng.normal(size=len(best))))
        assert cost(np.linalg.pinv(cones.matrix) @ beside) > cost(best) - 1e-6 * abs(cost(best))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [("planar-3r", 0.07), ("ur5", 0.045)])
def test_the_torque_of_held_out_logs_is_explained(name, share, tmp_path):
    robot = robot_named(name)
    found = identify([recorded(robot, seed) for seed in range(3)], wrong(robot))
    assert max(found.held_out["robot"]) < share
    assert np.less(found.held_out["robot"], found.held_out["start"]).all()
    path = tmp_path / "robot.toml"
    path.write_text(found.to_toml())
    assert Robot.from_toml(path) == found.arm
    found.write_figure(tmp_path / "torques.png")
