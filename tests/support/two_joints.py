"""What is made for the equations of the two-joint arm, under the names that its tests use."""

import dataclasses
import functools

import numpy as np

from fuzzyarm.envs.batch.layout import VECTORS, layout_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.physics.dynamics import arm_constants, mass_matrix
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.integrator import hold_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import State, filled, flat
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.envs.task import assess as assess_arm
from fuzzyarm.envs.task import target_record

PHYSICS = two_joints()
LAYOUT = layout_of(PHYSICS)
Draw, Row, Target = draw_record(2), row_record(2, 2), target_record(2)
hold, assess = hold_of(PHYSICS), functools.partial(assess_arm, PHYSICS)
TABLE_1 = ArmParameters()
FRICTIONLESS = dataclasses.replace(
    TABLE_1, viscous_friction=(0.0, 0.0), static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0)
)
CONSERVATIVE = dataclasses.replace(FRICTIONLESS, damping=(0.0, 0.0))
SWINGING = np.array([1.0, 0.5, 1.001, 0.496, 1.0, -2.0, 1.5, -1.0])


def advance(state, torque, h, substeps, force=(0.0, 0.0), arm=TABLE_1, payload=None):
    """The state (8,) of one arm after `substeps` of h [s] under a constant torque and tip force."""
    lanes, constants = np.array(state, float)[:, None], np.array(flat(arm_constants(arm, payload)))[:, None]
    line = np.array([*force, 0.0, 0.0])[:4, None]  # a constant force, or a line given with its change
    hold(lanes, np.array(torque, float)[:, None], line, constants, h, substeps)
    return lanes[:, 0]


def named(vectors):
    """The vectors by name, from the rows that a `Layout` gives."""
    return dict(zip(VECTORS, LAYOUT.each(vectors), strict=True))


def state_of(numbers):
    """The state from its eight numbers or rows."""
    return filled(State, numbers)


def energy(states, arm):
    """Kinetic energy of motors and links, of the joint springs and of gravity [J], over the last axis."""
    c = arm_constants(arm)
    motor, link, motor_velocity, link_velocity = (states[..., k : k + 2] for k in (0, 2, 4, 6))
    m11, m12, m22 = mass_matrix(np.cos(link[..., 1]), c)
    v1, v2 = link_velocity[..., 0], link_velocity[..., 1]
    kinetic = 0.5 * (m11 * v1**2 + m22 * v2**2) + m12 * v1 * v2
    motors = 0.5 * (motor_velocity**2 @ np.array(arm.motor_inertia))
    springs = 0.5 * ((motor - link) ** 2 @ np.array(arm.stiffness))
    return kinetic + motors + springs - c.c4 * np.cos(link[..., 0]) - c.c5 * np.cos(link.sum(axis=-1))
