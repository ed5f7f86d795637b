"""The conditions in which margins are measured, and the limits of the loop gain: the columns of `fuzzyarm margins`."""

from __future__ import annotations

import dataclasses
from typing import Literal

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.scenario.cases import case_for

__all__ = ["CONDITIONS", "LIMITS", "Condition", "Limit", "conditions_for"]


@dataclasses.dataclass(frozen=True)
class Condition:
    """How the loop differs from the one that the policy was designed for; the policy does not know.

    Attributes:
        name: heading in the table and key in the document.
        loop_gain: factor on the torque's deviation from equilibrium.
        delay: extra samples of delay, a multiple of 0.5.
        stiffness: factor on the stiffness of both joints.
        payload: what the arm carries.
    """

    name: str
    loop_gain: float = 1.0
    delay: float = 0.0
    stiffness: float = 1.0
    payload: Payload | None = None


CONDITIONS = (
    Condition("nominal"),
    Condition("loop gain x 0.67", loop_gain=0.67),
    Condition("loop gain x 1.5", loop_gain=1.5),
    Condition("half a sample later", delay=0.5),
    Condition("one sample later", delay=1.0),
    Condition("stiffness - 20 %", stiffness=0.8),
    Condition("stiffness + 20 %", stiffness=1.2),
    Condition("5 kg payload", payload=Payload(5.0)),
)
"""The conditions of the columns for the two-joint arm, in their order; `conditions_for` has those of any arm."""


@dataclasses.dataclass(frozen=True)
class Limit:
    """A limit of the loop gain on the nominal arm.

    Attributes:
        heading: in the table.
        side: which of the `GainLimits`.
        delay: extra samples of delay.
    """

    heading: str
    side: Literal["lower", "upper"]
    delay: float = 0.0


LIMITS = {
    "lower": Limit("loop gain from", "lower"),
    "upper": Limit("to", "upper"),
    "upper_one_sample_later": Limit("to, one sample later", "upper", delay=1.0),
}
"""By key in the document."""


def conditions_for(arm: AnyArm) -> tuple[Condition, ...]:
    """Return the conditions of the columns for an arm; a robot carries the payload of its case ``payload``."""
    payload = case_for("payload", arm).disturbance.payload
    return tuple(
        condition
        if condition.payload is None
        else dataclasses.replace(condition, name=f"{payload.mass:g} kg payload", payload=payload)
        for condition in CONDITIONS
    )
