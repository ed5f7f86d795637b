"""The observation that every policy receives: motor angles and velocities, then the reference at the same instant.

An observation is an array (..., 5 n) for an arm of n joints; only this module defines the order of its parts.
"""

from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import JOINTS

__all__ = ["ACTION_SCALE", "JOINTS", "OBSERVATION_SCALE", "PARTS", "Observation", "observed", "starts"]


class Observation(NamedTuple):
    """The parts of an observation, each with one entry per joint."""

    q_motor: Any  # motor angles as measured, with encoder noise if there is any [rad]
    dq_motor: Any  # motor velocities, likewise [rad/s]
    q_reference: Any  # reference angles q_d [rad]
    dq_reference: Any  # reference velocities [rad/s]
    ddq_reference: Any  # reference accelerations [rad/s²]


PARTS = len(Observation._fields)  # an arm of n joints has `PARTS` n numbers in its observation
_SIZE = JOINTS * PARTS  # numbers in an observation of the paper's arm

OBSERVATION_SCALE = np.array([0.67, 1.9, 1.4, 1.6, 0.67, 1.9, 1.4, 1.6, 19.0, 21.0])
"""Typical magnitudes of the paper's arm, in the order and units of `Observation`.

They are root mean squares over `default_reference.reference_family`; motors are assumed to follow these references.
"""
ACTION_SCALE = np.array(ArmParameters().torque_limit)
"""The torque limits of the paper's arm [N m]."""
OBSERVATION_SCALE.flags.writeable = ACTION_SCALE.flags.writeable = False


def starts(joints: int) -> Observation:
    """Return the index at which each part begins in the observation of an arm with this number of joints."""
    return Observation(*range(0, joints * PARTS, joints))


def observed(array: Any) -> Observation:
    """Return the parts of observations (..., `PARTS` n) as views (..., n)."""
    n = array.shape[-1] // PARTS
    return Observation(
        array[..., :n], array[..., n : 2 * n], array[..., 2 * n : 3 * n], array[..., 3 * n : 4 * n], array[..., 4 * n :]
    )
