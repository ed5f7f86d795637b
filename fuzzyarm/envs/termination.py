"""Why an episode was terminated: one enumeration for every back end."""

from __future__ import annotations

import enum
from typing import Any

__all__ = ["Termination", "reason_of"]


class Termination(enum.IntEnum):
    """Reason of termination; `text` is what ``info["reason"]`` says.

    `NONE` stands for an episode that goes on or was truncated. If several reasons hold at once, `NOT_FINITE` comes
    before `ANGLE`, and `ANGLE` before `VELOCITY`.
    """

    NONE = 0
    ANGLE = 1
    VELOCITY = 2
    NOT_FINITE = 3

    @property
    def text(self) -> str:
        """One line about the reason; empty for `NONE`."""
        return _TEXTS[self]


_TEXTS = {
    Termination.NONE: "",
    Termination.ANGLE: "a joint angle left the domain (25)",
    Termination.VELOCITY: "a joint velocity left the domain (25)",
    Termination.NOT_FINITE: "the state is not finite",
}

# Plain floats: the functions below also run on tensors, which know no enumerations.
_ANGLE, _VELOCITY, _NOT_FINITE = map(float, (Termination.ANGLE, Termination.VELOCITY, Termination.NOT_FINITE))


def reason_of(finite: Any, angles_inside: Any, velocities_inside: Any) -> Any:
    """Return the number of the `Termination` as a float, from flags that are 0.0 or 1.0.

    Elementwise: scalars, arrays and tensors alike. The products and sums of such flags are exact.

    Args:
        finite: whether the state is finite.
        angles_inside: whether every joint angle is within its limit.
        velocities_inside: whether every joint velocity is within its limit.
    """
    inside = angles_inside * (1.0 - velocities_inside) * _VELOCITY + (1.0 - angles_inside) * _ANGLE
    return finite * inside + (1.0 - finite) * _NOT_FINITE
