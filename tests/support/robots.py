"""Robots for tests: all shipped ones, one with axes and frames of every direction, and the same in MuJoCo."""

import dataclasses

import mujoco
import numpy as np

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics.joint import Drive, Joint, Link
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots

DRIVE = Drive(0.5, 1e4, 3.0, 1.0, 3.0, 2.0, 0.1, 100.0)


def skewed_robot(joints=4, seed=0):
    """A robot whose rotations, axes, centers and inertias have no zeros."""
    generator = np.random.default_rng(seed)
    parts = []
    for k in range(joints):
        rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        axis = generator.normal(size=3)
        points = generator.normal(size=(6, 3))  # six point masses have an inertia that a body can have
        inertia = 0.02 * (np.einsum("ki,ki->", points, points) * np.eye(3) - points.T @ points)
        center, position = generator.normal(scale=0.2, size=(2, 3))
        link = Link(generator.uniform(1.0, 5.0), tuple(center), tuple(map(tuple, inertia)))
        axis /= np.linalg.norm(axis)
        frame = tuple(map(tuple, rotation))
        parts.append(Joint(f"j{k}", tuple(position), frame, tuple(axis), link, DRIVE, (-3.0, 3.0), 5.0))
    return Robot("skewed", tuple(parts), tip=(0.1, -0.2, 0.3), gravity=(1.0, -2.0, -9.0))


ROBOTS = {name: robot_named(name) for name in shipped_robots()} | {"skewed": skewed_robot()}


def kinetic_energy(robot, q, dq):
    """q̇ᵀ M(q) q̇ / 2 [J], shape (...), at velocities [rad/s] of shape (..., n)."""
    return 0.5 * np.einsum("...i,...ij,...j->...", dq, rigid_body.mass_matrix(robot, q), dq)


def potential_energy(robot, q):
    """-Σ m_i gᵀ (p_i + R_i c_i) [J], shape (...), whose gradient is g(q)."""
    links, now = rigid_body.frames(robot, q), robot.arrays
    centers = links.origin + np.einsum("...kij,kj->...ki", links.rotation, now.center)
    return -np.einsum("k,...kj,j->...", now.mass, centers, now.gravity)


def without_losses(robot):
    """The robot without friction and damping."""
    lossless = {"damping": 0.0, "viscous_friction": 0.0, "static_friction": 0.0, "coulomb_friction": 0.0}
    return with_drives(robot, **lossless)


def with_drives(robot, **changes):
    """The robot with other values in all its drives."""
    joints = (dataclasses.replace(j, drive=dataclasses.replace(j.drive, **changes)) for j in robot.joints)
    return dataclasses.replace(robot, joints=tuple(joints))


def in_mujoco(robot):
    """The rigid robot as a MuJoCo model with a site at the tip."""

    def numbers(values):
        return " ".join(repr(float(value)) for value in values)

    body = f'<site name="tip" pos="{numbers(robot.tip)}"/>'
    for joint in reversed(robot.joints):
        rotation, inertia = np.array(joint.rotation), np.array(joint.link.inertia)
        moments = numbers([*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]])
        body = (
            f'<body pos="{numbers(joint.position)}" xyaxes="{numbers(rotation[:, :2].T.ravel())}">'
            f'<inertial pos="{numbers(joint.link.center)}" mass="{joint.link.mass!r}" fullinertia="{moments}"/>'
            f'<joint name="{joint.name}" axis="{numbers(joint.axis)}"/>{body}</body>'
        )
    option = f'<option gravity="{numbers(robot.gravity)}"><flag contact="disable"/></option>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>")
