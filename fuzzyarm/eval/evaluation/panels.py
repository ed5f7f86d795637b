"""What the figures over time show: one `Panel` for each row of a figure."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = ["OVERVIEW", "TIME_FIGURES", "Panel"]

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
TIME_FIGURES: dict[str, tuple[Panel, ...]] = {
    "circularity": (
        _CIRCULARITY,
        # Not an error panel: a policy that brings the tip to the circle leads the motors beside it.
        Panel("motors' circularity,\nas if rigid", "mm", lambda r: 1e3 * r.circularity_error_motor),
    ),
    "torque": (
        Panel("motor torque,\njoint 1", "N m", lambda r: r.torque[:, 0], scale="joint 1"),
        Panel("motor torque,\njoint 2", "N m", lambda r: r.torque[:, 1], scale="joint 2"),
    ),
    "velocity": (
        Panel("motor velocity,\njoint 1", "rad/s", lambda r: r.dq_motor[:, 0], target=lambda r: r.dq_reference[:, 0]),
        Panel("motor velocity,\njoint 2", "rad/s", lambda r: r.dq_motor[:, 1], target=lambda r: r.dq_reference[:, 1]),
    ),
    "motor-position": (
        Panel("motor angle less\nq_d, joint 1", "mrad", lambda r: 1e3 * (r.q_motor - r.q_reference)[:, 0]),
        Panel("motor angle less\nq_d, joint 2", "mrad", lambda r: 1e3 * (r.q_motor - r.q_reference)[:, 1]),
    ),
    "friction": (
        Panel("friction torque,\njoint 1", "N m", lambda r: r.friction_torque[:, 0], scale="joint 1"),
        Panel("friction torque,\njoint 2", "N m", lambda r: r.friction_torque[:, 1], scale="joint 2"),
    ),
}
# The panels of the overview, one column for each case.
OVERVIEW = (Panel("tip error", "mm", lambda r: 1e3 * r.tip_error, scale="tip", log=True), _CIRCULARITY)
