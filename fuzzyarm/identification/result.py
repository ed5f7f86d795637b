"""From a log to an arm: rigid parameters by least squares, refined by output error, with remarks for the user.

The residual plot shows measured less simulated, for each motor, with the band in which 95 % of white noise lies.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from fuzzyarm.common.checks import instance, sequence_of
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.identification._fit import DEVIATIONS, Fit, fit_elastic
from fuzzyarm.identification._rigid import (
    BASE,
    KEPT,
    UNKNOWNS,
    RigidFit,
    arm_of,
    base_of,
    fit_rigid,
    rigid_arm,
    start_of,
)  # fmt: skip
from fuzzyarm.identification.log import Log, Motion

__all__ = ["Identified", "identify"]

_CORRELATED = 0.2  # correlation of neighbouring residuals above which the intervals are too narrow to be believed
_DOUBT = 3.0  # standard errors
_UNLIKELY = 30.0  # torques of a log over those of the start, from which on their unit is wrong
_MOST_LATE = 9  # samples
_INERTIAL = 5  # of `BASE`, the first ones; the others are friction
_ROWS = (("angle", "µrad", 1e6), ("velocity", "mrad/s", 1e3))
_DRAWN = 4000  # points a curve


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """The arm that was identified from a log.

    Attributes:
        arm: the arm, with the values of the log where it determines them and those of the start elsewhere.
        start: the arm from which the search began.
        rigid: the least-squares estimate of the rigid arm.
        fit: the output-error estimate of the elastic arm.
        samples: number of samples of the log.
        period: sampling period of the log [s].
    """

    arm: ArmParameters
    start: ArmParameters
    rigid: RigidFit
    fit: Fit
    samples: int
    period: float

    def rows(self) -> list[dict[str, Any]]:
        """Return name, unit, start, value and 95 % interval of each parameter; None for an unknown interval."""
        before, error = start_of(self.start), self.fit.error
        return [
            {
                "name": one.name,
                "unit": one.unit,
                "start": float(before[k]),
                "value": float(self.fit.theta[k]),
                "low": float(self.fit.theta[k] - DEVIATIONS * error[k]) if self.fit.determined[k] else None,
                "high": float(self.fit.theta[k] + DEVIATIONS * error[k]) if self.fit.determined[k] else None,
                "told": bool(self.fit.determined[k]),
            }
            for k, one in enumerate(UNKNOWNS)
        ]

    def remarks(self) -> list[str]:
        """Return remarks on the numbers, one or two sentences each."""
        untold = [row["name"] for row in self.rows() if not row["told"]]
        found = [f"Motors alone never tell {', '.join(KEPT)}: they are those of the start."]
        if untold:
            found.append(f"This log does not tell {', '.join(untold)}: the values of the start are kept.")
        if self.fit.at_bound.any():
            ends = ", ".join(one.name for one, ends in zip(UNKNOWNS, self.fit.at_bound, strict=True) if ends)
            found.append(
                f"At the end of the allowed range: {ends}. Masses or lengths of the start hardly fit; weigh and "
                "measure them."
            )
        if self.fit.correlation > _CORRELATED:
            found.append(
                f"Neighbouring residuals are correlated by {self.fit.correlation:.2f}: the arm does something that the "
                "equations do not, and the intervals are too narrow."
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return all results as plain numbers, lists and strings for JSON."""
        return {
            "samples": self.samples,
            "period": self.period,
            "parameters": self.rows(),
            "kept": list(KEPT),
            "condition": self.fit.condition,
            "noise": self.fit.noise.tolist(),
            "correlation": self.fit.correlation,
            "rigid": {
                "parameters": [
                    {"tells": name, "value": float(value), "error": float(error)}
                    for name, value, error in zip(BASE, self.rigid.base, self.rigid.error, strict=True)
                ],
                "condition": self.rigid.condition,
                "residual": self.rigid.residual.tolist(),
            },
            "remarks": self.remarks(),
            "arm": self.arm.to_dict(),
        }

    def write_residuals(self, path: Path) -> None:
        """Write the figure of the residuals as PNG: rows of angles and measured velocities, a column for each joint.

        Raises:
            OSError: the file cannot be written.
        """
        residual, noise = self.fit.residual, self.fit.noise
        rows = _ROWS[: residual.shape[1] // 2]
        every = max(1, len(residual) // _DRAWN)
        time = np.arange(len(residual)) * self.period
        with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
            figure = Figure(figsize=(9.0, 1.2 + 2.1 * len(rows)))
            grid = figure.subplots(len(rows), 2, sharex=True, squeeze=False)
            for row, (name, unit, factor) in enumerate(rows):
                for joint, axes in enumerate(grid[row]):
                    channel = 2 * row + joint
                    rms = factor * noise[channel]
                    axes.plot(time[::every], factor * residual[::every, channel], linewidth=0.5)
                    for side in (-DEVIATIONS, DEVIATIONS):
                        axes.axhline(side * rms, color="black", linewidth=0.9)
                    axes.set_title(f"{name} of motor {joint + 1}, {rms:.3g} {unit} rms")
                    axes.set_ylabel(f"residual [{unit}]")
            for axes in grid[-1]:
                axes.set_xlabel("time [s]")
            figure.suptitle("Measured less simulated; between the lines: 95 % of white noise")
            content = io.BytesIO()
            figure.savefig(content, format="png")
        write_atomically(path, content.getvalue())


def identify(logs: Sequence[Log], start: ArmParameters, progress: Callable[[], None] | None = None) -> Identified:
    """Return the two-joint arm that fits a log best, with confidence intervals.

    Args:
        logs: measurements of the motors, one log.
        start: the arm from which the search begins. Lengths, masses, gravity, limits and all parameters that the log
            does not determine keep its values.
        progress: called after each step of the refinement.

    Raises:
        ValueError: the log excites the arm too little, or no arm fits it; the message names the parameter.
    """
    if len(sequence_of("logs", logs)) > 1:
        raise ValueError(f"logs has {len(logs)} entries; allowed: one, without a gap")
    log = logs[0]
    motion = instance("log", log, Log).smoothed()
    rigid = fit_rigid(motion, instance("start", start, ArmParameters))
    if rigid.undetermined:
        raise ValueError(
            f"too little excitation: the log does not determine {', '.join(rigid.undetermined)} (condition number "
            f"{rigid.condition:.3g}); move both joints to and fro, faster and further, as the motion of --suggest does"
        )
    negative = [
        name
        for name, value, error in zip(BASE, rigid.base, rigid.error, strict=True)
        if "friction" not in name and value < -_DOUBT * error
    ]
    if negative:
        raise ValueError(
            f"the log gives no valid arm: least squares give {', '.join(negative)} a value below 0; check signs and "
            "units of the log, and masses and lengths of the start"
        )
    heavier = float(np.median(np.abs(rigid.base[:_INERTIAL] / base_of(start)[:_INERTIAL])))
    unit = (
        f"its torques are {heavier:.2g} times those of the start: check their unit, and the start's masses and lengths"
    )
    if not 1.0 / _UNLIKELY < heavier < _UNLIKELY:
        raise ValueError(f"the log gives no valid arm: {unit}")
    try:
        fit = fit_elastic(log, motion, rigid_arm(rigid.base, start), start, progress)
        arm = arm_of(fit.theta, start)
    except (ValueError, np.linalg.LinAlgError) as error:
        found = "the simulated arm does not follow it" if isinstance(error, np.linalg.LinAlgError) else error
        cause = _lag(motion, rigid, start, log.period) or unit
        raise ValueError(f"the log gives no valid arm: {found}; {cause}") from None
    return Identified(arm, start, rigid, fit, len(log.angle), log.period)


def _lag(motion: Motion, rigid: RigidFit, start: ArmParameters, period: float) -> str:
    """Return the delay of the torque in words if the rigid arm fits better with the torque shifted; empty if not."""

    def left(lag: int) -> float:
        shifted = motion._replace(torque=np.roll(motion.torque, -lag, axis=0))
        return float(np.sum((fit_rigid(shifted, start).residual / rigid.residual) ** 2))

    lag = min(range(-_MOST_LATE, _MOST_LATE + 1), key=left)
    late, way = f"{abs(lag) * 1e3 * period:g} ms", "late" if lag > 0 else "early"
    return f"its torque seems to be {late} {way}: shift it by {abs(lag)} sample(s)" if lag else ""
