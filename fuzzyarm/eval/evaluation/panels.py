"""What the figures over time show: one `Panel` for each row of a figure."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = ["OVERVIEW", "Panel", "time_figures"]

Signal = Callable[[Rollout], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Panel:
    """One quantity over time, a row of a figure.

    Attributes:
        quantity, unit: label of the vertical axis.
        signal: what is drawn of a rollout, (n,) [unit].
        scale: panels of a figure with the same scale share their limits.
        target: what the signal should follow, (n,) [unit]; None without a target.
        log: whether the axis is logarithmic; each case has limits of its own then,
            and values below its lowest decade are drawn at its edge.
        is_error: whether the scale leaves out policies far worse than the best (see `figures.FOCUS`), which are then
            named in the panel; they would flatten the other curves.
    """

    quantity: str
    unit: str
    signal: Signal
    scale: str = ""
    target: Signal | None = None
    log: bool = False
    is_error: bool = False


_CIRCULARITY = Panel("circularity error", "mm", lambda r: 1e3 * r.circularity_error, is_error=True)
_MOTOR_CIRCULARITY = Panel("motors' circularity,\nas if rigid", "mm", lambda r: 1e3 * r.circularity_error_motor)
# Not an error panel: a policy that brings the tip to the circle leads the motors beside it.


@functools.cache
def time_figures(joints: int) -> dict[str, tuple[Panel, ...]]:
    """Return the panels of each figure over time, by its name, for an arm of so many joints."""
    each = [_of_joint(joint) for joint in range(joints)]
    names = ("torque", "velocity", "motor-position", "friction")
    return {"circularity": (_CIRCULARITY, _MOTOR_CIRCULARITY)} | dict(zip(names, zip(*each, strict=True), strict=True))


def _of_joint(k: int) -> tuple[Panel, Panel, Panel, Panel]:
    """Return the panels of one joint: torque, velocity, motor angle and friction."""
    name = f"joint {k + 1}"
    return (
        Panel(f"motor torque,\n{name}", "N m", lambda r: r.torque[:, k], scale=name),
        Panel(f"motor velocity,\n{name}", "rad/s", lambda r: r.dq_motor[:, k], target=lambda r: r.dq_reference[:, k]),
        Panel(f"motor angle less\nq_d, {name}", "mrad", lambda r: 1e3 * (r.q_motor - r.q_reference)[:, k]),
        Panel(f"friction torque,\n{name}", "N m", lambda r: r.friction_torque[:, k], scale=name),
    )


# The panels of the overview, one column for each case.
OVERVIEW = (Panel("tip error", "mm", lambda r: 1e3 * r.tip_error, scale="tip", log=True), _CIRCULARITY)
