"""The metrics of a rollout, each defined once; `add_metric` adds one.

All of them are over all control steps of the episode, from the first to the last, if not said otherwise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = ["METRICS", "Metric", "add_metric", "metrics_of"]

_FRINGE = 0.1  # s, at both ends of an episode


@dataclasses.dataclass(frozen=True)
class Metric:
    """A number that a rollout is judged by.

    Attributes:
        name: key in results and heading of the CSV column.
        unit: empty for a pure number.
        description: what is computed, in one or more sentences.
        compute: the metric of a rollout [unit].
        reproducible: whether it is the same in every run; a wall time is not.
    """

    name: str
    unit: str
    description: str
    compute: Callable[[Rollout], float]
    reproducible: bool = True


_MOTOR_CIRCULARITY = (
    "The same with the motor angles, that is, as if the joints were rigid. It does not measure accuracy at the tip: a "
    "policy that brings the tip to the reference leads the motors millimetres beside it."
)
_TORQUE_PEAK, _TORQUE_RMS = "Largest motor torque of joint {}.", "Root mean square motor torque of joint {}."

_ALL = (
    Metric(
        "tip_error_max_mm",
        "mm",
        "Largest distance between the tip (link side) and its reference at the same instant.",
        lambda r: 1e3 * r.tip_error.max(),
    ),
    Metric(
        "tip_error_max_mid_mm",
        "mm",
        "The maximum without the first and the last 0.1 s, in which loads set in and fade; that of all steps if the "
        "episode is no longer than that.",
        lambda r: 1e3 * _middle(r).max(),
    ),
    Metric(
        "tip_error_rms_mm",
        "mm",
        "Root mean square of the distance between the tip and its reference.",
        lambda r: 1e3 * _rms(r.tip_error),
    ),
    Metric(
        "circularity_link_min_mm",
        "mm",
        "Smallest |tip - center| - R with the link angles; for a path that is no circle, the tip error's component "
        "along the left normal of the path. Lag along the path does not show in it.",
        lambda r: 1e3 * r.circularity_error.min(),
    ),
    Metric("circularity_link_max_mm", "mm", "Largest of the same quantity.", lambda r: 1e3 * r.circularity_error.max()),
    Metric("circularity_motor_min_mm", "mm", _MOTOR_CIRCULARITY, lambda r: 1e3 * r.circularity_error_motor.min()),
    Metric(
        "circularity_motor_max_mm",
        "mm",
        "Largest of the same quantity.",
        lambda r: 1e3 * r.circularity_error_motor.max(),
    ),
    Metric(
        "joint_error_rms_mrad",
        "mrad",
        "Root mean square of q_a - q_d over both joints: the error of a policy that leads the motors along the "
        "reference, and no error of one that leads the tip.",
        lambda r: 1e3 * _rms(r.q_motor - r.q_reference),
    ),
    Metric("torque_peak_1", "N m", _TORQUE_PEAK.format(1), lambda r: _peaks(r)[0]),
    Metric("torque_peak_2", "N m", _TORQUE_PEAK.format(2), lambda r: _peaks(r)[1]),
    Metric("torque_rms_1", "N m", _TORQUE_RMS.format(1), lambda r: _torque_rms(r)[0]),
    Metric("torque_rms_2", "N m", _TORQUE_RMS.format(2), lambda r: _torque_rms(r)[1]),
    Metric(
        "torque_rate_rms",
        "N m/s",
        "Root mean square of the change of torque from step to step over the control period, both joints.",
        lambda r: _rms(np.diff(r.torque, axis=0) / r.control_period) if len(r.torque) > 1 else 0.0,
    ),
    Metric(
        "energy",
        "J",
        "Absolute mechanical work of the motors, ∫ |Γ_1 q̇_a1| + |Γ_2 q̇_a2| dt.",
        lambda r: np.abs(r.torque * r.dq_motor).sum() * r.control_period,
    ),
    Metric(
        "domain_margin",
        "",
        "Share of the joint box (25) left unused at the worst instant: 1 - max(|q|/limit, |q̇|/limit), both sides.",
        lambda r: 1.0 - r.domain_use.max(),
    ),
    Metric("return", "", "Sum of rewards.", lambda r: r.reward.sum()),
    Metric(
        "predict_us",
        "µs",
        "Median wall time of one `predict` call; the only metric that differs between runs.",
        lambda r: 1e6 * r.step_time,
        reproducible=False,
    ),
)

METRICS: dict[str, Metric] = {metric.name: metric for metric in _ALL}
"""All metrics by name, in the order of the results' columns; `add_metric` adds one at the end."""


def add_metric(metric: Metric) -> None:
    """Have every evaluation of this process compute a metric; ValueError if there is one of that name."""
    if metric.name in METRICS:
        raise ValueError(f"there is a metric {metric.name!r} already; choose another name")
    METRICS[metric.name] = metric


def metrics_of(rollout: Rollout) -> dict[str, float]:
    """Return all `METRICS` of an episode by name."""
    return {name: float(metric.compute(rollout)) for name, metric in METRICS.items()}


def _middle(rollout: Rollout) -> np.ndarray:
    """Return the tip error without the first and the last `_FRINGE` seconds, or all of it if nothing is left."""
    time = rollout.time
    inside = (time > _FRINGE) & (time <= time[-1] - _FRINGE)
    return rollout.tip_error[inside] if inside.any() else rollout.tip_error


def _peaks(rollout: Rollout) -> np.ndarray:
    """Return the largest torque of each joint."""
    return np.asarray(np.abs(rollout.torque).max(axis=0))


def _torque_rms(rollout: Rollout) -> np.ndarray:
    """Return the root mean square torque of each joint."""
    return np.asarray(np.sqrt(np.mean(rollout.torque**2, axis=0)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
