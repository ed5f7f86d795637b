"""The observation that every policy receives: motor angles and velocities, then the reference at the same instant.

An observation is an array (..., `SIZE`); only this module defines the order of its parts. `observed` gives them as
views, in NumPy, in compiled code and for tensors alike:

    o = observed(observation)
    error = o.q_motor - o.q_reference
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba.extending import register_jitable

from fuzzyarm.envs.physics.records import JOINTS

__all__ = ["JOINTS", "MEASURED", "REFERENCE", "SIZE", "START", "Observation", "observed"]


class Observation(NamedTuple):
    """The parts of an observation, one number per joint in each.

    Attributes:
        q_motor: motor angles as measured, with encoder noise if there is any [rad].
        dq_motor: motor velocities, likewise [rad/s].
        q_reference: reference angles q_d [rad].
        dq_reference: reference velocities [rad/s].
        ddq_reference: reference accelerations [rad/s²].
    """

    q_motor: Any
    dq_motor: Any
    q_reference: Any
    dq_reference: Any
    ddq_reference: Any


SIZE = JOINTS * len(Observation._fields)
"""Numbers in an observation."""

START = Observation(*range(0, SIZE, JOINTS))
"""Where each part begins."""

MEASURED = slice(START.q_motor, START.q_reference)
"""What sensors say: `q_motor` and `dq_motor`."""

REFERENCE = slice(START.q_reference, SIZE)
"""What is asked for: `q_reference`, `dq_reference` and `ddq_reference`."""


@register_jitable
def observed(array: Any) -> Observation:
    """Return the parts of observations (..., `SIZE`) as views (..., `JOINTS`) of them."""
    return Observation(
        array[..., START.q_motor : START.q_motor + JOINTS],
        array[..., START.dq_motor : START.dq_motor + JOINTS],
        array[..., START.q_reference : START.q_reference + JOINTS],
        array[..., START.dq_reference : START.dq_reference + JOINTS],
        array[..., START.ddq_reference : START.ddq_reference + JOINTS],
    )
