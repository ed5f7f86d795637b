"""The metrics of a rollout, each defined once; `add_metric` adds one.

Results, their table, the report, sweeps and leaderboards use only this definition of a metric. A metric covers all
control steps of the episode unless its description says otherwise.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.common.registry import Registry
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.eval.episodes.loop import TipErrors
from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = [
    "LOST", "METRICS", "RESOLUTION", "Metric", "add_metric", "columns", "is_lost", "metrics_of", "millimetres",
    "ranked", "swept",
]  # fmt: skip

LOST = 100.0
"""The tip error [mm] above which an episode is lost, see `is_lost`: half the radius of the paper's circle."""

RESOLUTION = 1e-3  # [mm]; smaller errors are neither stated nor ranked: the time step's error is a fifth of it

_FRINGE = 0.1  # s, at both ends of an episode


@dataclasses.dataclass(frozen=True)
class Metric:
    """A number computed from a rollout."""

    name: str  # key in results and heading of the CSV column
    unit: str  # empty for a pure number
    description: str  # its definition, in one or more sentences
    compute: Callable[[Rollout], float]  # [unit]
    reproducible: bool = True  # whether it is the same in every run; a wall time is not
    joint: int = 0  # its joint, counted from 1; 0: no joint
    column: str = ""  # heading in the table of results, without the unit; metrics with one heading share a cell
    form: str = "{:#.3g}"  # format of the number in that table
    swept: Callable[[TipErrors], np.ndarray] | None = None  # its values in the episodes of a sweep, (lanes,) [unit]
    key: str = ""  # name in a sweep's files
    words: str = ""  # heading in a sweep's table, without the unit
    ranked: bool = False  # whether leaderboards show it for each case, beside the metrics of the score

    def text(self, value: float) -> str:
        """Return a value [unit] as the table of results shows it."""
        return millimetres(value, self.form.format) if self.unit == "mm" else self.form.format(value)


_MOTOR_CIRCULARITY = (
    "The same, computed from the motor angles as if the joints were rigid. It does not measure accuracy at the tip: a "
    "policy that keeps the tip on the reference keeps the motors millimetres away from it."
)


def _of_joint(joint: int) -> tuple[Metric, Metric]:
    """Return the metrics of one joint, counted from 1: the peak and the root mean square of its motor torque."""
    peak, rms, of = f"torque_peak_{joint}", f"torque_rms_{joint}", f"motor torque of joint {joint}."
    return (
        Metric(peak, "N m", f"Largest {of}", lambda r: float(np.abs(r.torque).max(axis=0)[joint - 1]),
               joint=joint, column="peak torque", form="{:.0f}"),
        Metric(rms, "N m", f"Root mean square {of}",
               lambda r: float(np.sqrt(np.mean(r.torque**2, axis=0))[joint - 1]), joint=joint),
    )  # fmt: skip


(_PEAK_1, _RMS_1), (_PEAK_2, _RMS_2) = map(_of_joint, (1, 2))
_ALL = (
    Metric("tip_error_max_mm", "mm",
           "Largest distance between the tip (link side) and its reference at the same instant.",
           lambda r: 1e3 * r.tip_error.max(), column="tip error max",
           swept=lambda e: 1e3 * e.largest, key="max_mm", words="largest tip error"),
    Metric("tip_error_max_mid_mm", "mm",
           "The maximum without the first and the last 0.1 s, in which loads set in and fade; of all steps if the "
           "episode is no longer than that.", lambda r: 1e3 * _middle(r).max(),
           column="max but for 0.1 s at the ends"),
    Metric("tip_error_rms_mm", "mm", "Root mean square of the distance between the tip and its reference.",
           lambda r: 1e3 * _rms(r.tip_error), column="rms",
           swept=lambda e: 1e3 * e.rms, key="rms_mm", words="rms tip error"),
    Metric("circularity_link_min_mm", "mm",
           "Smallest |tip - center| - R with the link angles; for a path that is not a circle, the component of "
           "the tip error along the left normal of the path. It does not show a lag along the path.",
           lambda r: 1e3 * r.circularity_error.min(),
           column="tip circularity", form="{:+#.3g}"),
    Metric("circularity_link_max_mm", "mm", "Largest of the same quantity.", lambda r: 1e3 * r.circularity_error.max(),
           column="tip circularity", form="{:+#.3g}"),
    Metric("circularity_motor_min_mm", "mm", _MOTOR_CIRCULARITY, lambda r: 1e3 * r.circularity_error_motor.min()),
    Metric("circularity_motor_max_mm", "mm", "Largest of the same quantity.",
           lambda r: 1e3 * r.circularity_error_motor.max()),
    Metric("joint_error_rms_mrad", "mrad",
           "Root mean square of q_a - q_d over all joints. It measures an error only if the policy moves the motors, "
           "not the tip, along the reference.", lambda r: 1e3 * _rms(r.q_motor - r.q_reference)),
    _PEAK_1, _PEAK_2, _RMS_1, _RMS_2,
    Metric("torque_rate_rms", "N m/s",
           "Root mean square of the change of torque from step to step over the control period, all joints.",
           lambda r: _rms(np.diff(r.torque, axis=0) / r.control_period) if len(r.torque) > 1 else 0.0),
    Metric("energy", "J", "Absolute mechanical work of the motors, ∫ |Γ_1 q̇_a1| + |Γ_2 q̇_a2| + ... dt.",
           lambda r: np.abs(r.torque * r.dq_motor).sum() * r.control_period, column="work", form="{:.0f}"),
    Metric("domain_margin", "",
           "Share of the joint box (25) left unused at the worst instant: 1 - max(|q|/limit, |q̇|/limit), of "
           "motors and links; angles are measured from the middle of their range.", lambda r: 1.0 - r.domain_use.max()),
    Metric("return", "", "Sum of rewards.", lambda r: r.reward.sum(), column="return", form="{:.0f}"),
    Metric("predict_us", "µs", "Median wall time of one `predict` call; the only metric that differs between runs.",
           lambda r: 1e6 * r.step_time, reproducible=False, column="predict", form="{:.1f}"),
)  # fmt: skip

METRICS = Registry[Metric](__name__, {metric.name: metric for metric in _ALL})
"""All metrics by name, in the order of the results' columns; `add_metric` adds one at the end."""


def add_metric(metric: Metric) -> None:
    """Add a metric to every evaluation of this process; ValueError if its name is taken."""
    if metric.name in METRICS:
        raise ValueError(f"metric {metric.name!r} already exists; choose another name")
    METRICS[metric.name] = metric


def columns() -> dict[str, list[Metric]]:
    """Return the headings of the table of results, each with the metrics in a cell below it."""
    found: dict[str, list[Metric]] = {}
    for metric in METRICS.values():
        if metric.column:
            found.setdefault(f"{metric.column} [{metric.unit}]" if metric.unit else metric.column, []).append(metric)
    return found


def swept() -> dict[str, Metric]:
    """Return the metrics that sweeps compute, by `Metric.key`."""
    return {metric.key: metric for metric in METRICS.values() if metric.swept is not None}


def ranked() -> dict[str, Metric]:
    """Return the metrics that leaderboards show with the score, by their headings there."""
    return {metric.column or metric.name: metric for metric in METRICS.values() if metric.ranked}


def metrics_of(rollout: Rollout) -> dict[str, float]:
    """Return all `METRICS` of an episode by name, and those of a robot's joints beyond the second."""
    joints = instance("rollout", rollout, Rollout).torque.shape[-1]
    metrics = [metric for metric in METRICS.values() if metric.joint <= joints]
    metrics += [metric for joint in range(JOINTS + 1, joints + 1) for metric in _of_joint(joint)]
    return {metric.name: float(metric.compute(rollout)) for metric in metrics}


def is_lost(row: Mapping[str, Any]) -> bool:
    """Return whether an episode is lost, given its row of results: it ended early, or its tip error exceeded `LOST`.

    Every table, chart and sentence of the package uses this definition of a lost path. An episode "ended early" if it
    ended before its reference.
    """
    return not row["completed"] or bool(row["tip_error_max_mm"] > LOST)


def millimetres(length: float, form: Callable[[float], str] = "{:#.3g}".format) -> str:
    """Return a length [mm] as text; within ± `RESOLUTION` it is "< 0.001", or "> -0.001" if negative."""
    small = f"> -{RESOLUTION}" if length < 0.0 else f"< {RESOLUTION}"
    return small if abs(length) < RESOLUTION else form(length)


def _middle(rollout: Rollout) -> np.ndarray:
    """Return the tip error [m] without the first and last `_FRINGE` seconds, or all of it if nothing is left."""
    time = rollout.time
    inside = (time > _FRINGE) & (time <= time[-1] - _FRINGE)
    return rollout.tip_error[inside] if inside.any() else rollout.tip_error


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
