"""A robot of n joints from logs: the regressor against the inverse dynamics, bodies that can exist, held-out torque."""

import dataclasses

import numpy as np
import pytest
from support.recorded import recorded

from fuzzyarm.envs.physics.joint import Link, as_rows
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.identification._links import _Cones, _numbers_of, _robot_with, body_regressor
from fuzzyarm.identification.log import Log
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
    robot, other = robot_named(name), wrong(robot_named(name))
    motion = np.random.default_rng(0).normal(size=(3, 20, len(robot)))
    Y = body_regressor(robot, *motion)
    for one in (robot, other):
        torque = Y @ _numbers_of(one)[: Y.shape[-1]]
        np.testing.assert_allclose(torque, inverse_dynamics(one, *motion), rtol=1e-9, atol=1e-9)
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

    near, inverse = best + 1e-2 * rng.normal(size=(200, len(best))), np.linalg.pinv(cones.matrix)
    beside = [inverse @ cones.projected(cones.matrix @ x) for x in near]
    least, *costs = (0.5 * x @ H @ x - b @ x for x in (best, *beside))
    assert min(costs) > least - 1e-6 * abs(least)


def test_friction_and_constant_torques_are_found_from_a_start_without_friction():
    """The logs are of a rigid robot, whose torques have a known constant part."""
    robot, logs, constant = robot_named("planar-3r"), [], np.array([5.0, -3.0, 1.0])
    time = np.arange(0.0, 6.0, 2e-3)[:, np.newaxis]
    rotor, viscous, coulomb = map(robot.drive, ("motor_inertia", "viscous_friction", "coulomb_friction"))
    for seed in range(2):
        rate, phase = np.random.default_rng(seed).uniform((2.0,), (5.0,), (2, 3))
        q, dq = np.sin(rate * time + phase), rate * np.cos(rate * time + phase)
        ddq = -(rate**2) * q
        torque = inverse_dynamics(robot, q, dq, ddq) + rotor * ddq + viscous * dq + coulomb * np.sign(dq) + constant
        logs.append(Log(2e-3, q, torque, None, f"log {seed}"))
    bare = dict.fromkeys(("viscous_friction", "coulomb_friction", "static_friction"), 0.0)
    start = [dataclasses.replace(joint, drive=dataclasses.replace(joint.drive, **bare)) for joint in robot.joints]
    found = identify(logs, dataclasses.replace(robot, joints=tuple(start)))
    rows = {row["name"].split(": ")[1] + row["name"][5]: row for row in found.rows()}
    for k, speed in np.ndindex(3, 4):
        pair = [rows[f"{name}{k + 1}"] for name in ("coulomb_friction", "viscous_friction")]
        assert all(row["told"] for row in pair)
        friction = pair[0]["value"] + pair[1]["value"] * (1.0 + speed)
        assert friction == pytest.approx(coulomb[k] + viscous[k] * (1.0 + speed), rel=0.05)
    (remark,) = [remark for remark in found.remarks() if "constant torques that were found" in remark]
    values = [float(word) for word in remark.split(": ")[1].removesuffix(" N m.").split(", ")]
    np.testing.assert_allclose(values, constant, rtol=0.1)


def test_torques_that_no_robot_explains_are_named_and_zeros_are_refused():
    time, robot = np.arange(0.0, 4.0, 2e-3)[:, np.newaxis], robot_named("planar-3r")
    torque = 10.0 * np.random.default_rng(0).normal(size=(len(time), 3))
    log = Log(2e-3, np.sin(time * [1.3, 2.1, 3.0]), torque * [1.0, 0.0, 1.0])  # the second motor is off
    found = identify(log, robot)
    assert found.doubtful and any("explains little" in remark for remark in found.remarks())
    assert max(found.held_out["robot"]) < 1e5
    with pytest.raises(ValueError, match=r"all torques in the logs are zero; .* --columns tau1=NAME"):
        identify(dataclasses.replace(log, torque=0.0 * torque), robot)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [("planar-3r", 0.07), ("ur5", 0.02)])
def test_the_torque_of_held_out_logs_is_explained(name, share, tmp_path):
    """The share is the rms of the unexplained torque over the rms of the torque, of all joints together."""
    robot = robot_named(name)
    logs = [recorded(robot, seed) for seed in range(3)]
    found = identify(logs, wrong(robot))
    size = np.sqrt(np.mean(np.concatenate([log.torque for log in logs]) ** 2, axis=0))
    assert np.linalg.norm(found.held_out["robot"] * size) < share * np.linalg.norm(size)
    assert np.less(found.held_out["robot"], found.held_out["start"]).all()
    path = tmp_path / "robot.toml"
    path.write_text(found.to_toml())
    assert Robot.from_toml(path) == found.arm
    found.write_figure(tmp_path / "torques.png")
