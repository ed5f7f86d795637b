"""The arm identified from logs of its motors, with intervals and held-out errors; see `_two_joints` and `_links`."""

import dataclasses
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from fuzzyarm.common.checks import instance, sequence_of, truth
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.ranges import Ranges
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.identification._links import RobotFit, estimated_robot
from fuzzyarm.identification._rigid import UNKNOWNS, start_of
from fuzzyarm.identification._simulation import EDGE, ELASTIC, RIGID, simulated, windows_of
from fuzzyarm.identification._two_joints import _ROTOR, HORIZON, Stages, estimated, units_of
from fuzzyarm.identification.log import Log

__all__ = ["Identified", "identify"]

_SPRING = 4.0  # largest factor by which an undetermined stiffness is assumed to be wrong
_DOUBTFUL = 0.7  # least error of a doubtful result, as a share of the motion or the torque
_LITTLE = (
    f"The arm explains little of the logs: held-out errors exceed {_DOUBTFUL:g} times the {{}}. Check units, signs and "
    "delays of the logs, and lengths and masses of the starting arm."
)
_MOST_DRAWN = 4  # logs in a figure
_SHORTEST = HORIZON + 2.0 * EDGE  # s, shortest duration of a log
_NAMES = [one.name for one in UNKNOWNS]


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """The arm that was identified from logs.

    Attributes:
        arm: the arm; parameters that the logs do not determine have the values of `start`.
        start: the arm from which the search began.
        ranges: ranges of parameters that the logs do not determine but on which the stability of a controller depends.
        parameters: name, unit, start, value and 95 % interval (low, high) of each parameter, and whether the logs
            determine it; None for an unknown end of an interval.
        held_out: error of each joint on logs that were not used to find the parameters, by stage; `start` first.
        held_out_unit: unit of the held-out errors.
        interrupted: whether the search was interrupted.
        doubtful: whether the arm explains so little of the logs that units, signs or the start must be wrong.
        samples: number of samples of all logs.
    """

    arm: AnyArm
    start: AnyArm
    ranges: Ranges
    parameters: tuple[dict[str, Any], ...]
    held_out: dict[str, tuple[float, ...]]
    held_out_unit: str
    interrupted: bool
    doubtful: bool
    samples: int
    _remarks: tuple[str, ...]
    _curves: Callable[[], list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each parameter; see `parameters`."""
        return [dict(row) for row in self.parameters]

    def untold(self) -> tuple[str, ...]:
        """Return the names of inertial parameters that affect a rigid arm but are not determined by the logs."""
        return tuple(row["name"] for row in self.parameters if row["needed"] and not row["told"])

    def remarks(self) -> list[str]:
        """Return remarks on the results, one or two sentences each."""
        return list(self._remarks)

    def to_toml(self) -> str:
        """Return the text of the arm's file, with the ranges of undetermined parameters as a table."""
        return self.arm.to_toml() + self.ranges.to_toml()

    def to_dict(self) -> dict[str, Any]:
        """Return all results as plain numbers, lists and strings for JSON."""
        return {
            "samples": self.samples,
            "parameters": self.rows(),
            "held_out": {name: list(errors) for name, errors in self.held_out.items()},
            "held_out_unit": self.held_out_unit,
            "untold": list(self.untold()),
            "interrupted": self.interrupted,
            "doubtful": self.doubtful,
            "remarks": self.remarks(),
            "ranges": dataclasses.asdict(self.ranges),
            "arm": self.arm.to_dict() if isinstance(self.arm, ArmParameters) else dataclasses.asdict(self.arm),
        }

    def write_figure(self, path: Path) -> None:
        """Write a PNG figure of measured and simulated angles (robots: torques) for up to four logs.

        Raises:
            OSError: the file cannot be written.
        """
        curves = self._curves()
        joints = curves[0][2].shape[1]
        what = "angle [rad]" if isinstance(self.arm, ArmParameters) else "torque [N m]"
        with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
            figure = Figure(figsize=(9.0, 1.2 + 1.7 * joints))
            grid = figure.subplots(joints, len(curves), sharex="col", squeeze=False)
            for column, (name, time, measured, computed) in zip(grid.T, curves, strict=True):
                for joint, axes in enumerate(column):
                    axes.plot(time, measured[:, joint], color="black", linewidth=0.9, label="measured")
                    axes.plot(time, computed[:, joint], linewidth=0.9, label="simulated")
                    axes.set_ylabel(f"{what.replace(' ', f' {joint + 1} ', 1)}")
                column[0].set_title(name, parse_math=False)
                column[-1].set_xlabel("time [s]")
            grid[0, 0].legend()
            if isinstance(self.arm, ArmParameters):
                figure.suptitle(f"Simulated from measured states, each for {HORIZON:g} s")
            content = io.BytesIO()
            figure.savefig(content, format="png")
        write_atomically(path, content.getvalue())


def identify(
    logs: Log | Sequence[Log], start: AnyArm, advance: Callable[[], None] | None = None, *, stribeck: bool = False
) -> Identified:
    """Return the arm that fits the logs best, with confidence intervals and errors on held-out logs.

    Args:
        logs: one or more logs of the motors of one arm.
        start: the arm from which the search begins. It sets lengths, gravity, limits, the masses of two-joint arms, and
            all parameters that the logs do not determine.
        advance: called after each step. A KeyboardInterrupt ends the search; the result so far is returned.
        stribeck: for two-joint arms, whether to search for friction that is larger at rest than in motion; it is kept
            only if the held-out error falls.

    Raises:
        ValueError: no log moves the arm, or a log has another number of joints than the arm.
    """
    given = [logs] if isinstance(logs, Log) else [instance("logs", one, Log) for one in sequence_of("logs", logs)]
    if not isinstance(start, ArmParameters):
        instance("start", start, Robot)
    truth("stribeck", stribeck)
    joints = 2 if isinstance(start, ArmParameters) else len(start)
    for log in given:
        if log.angle.shape[1] != joints:
            raise ValueError(
                f"{log.name} has {log.angle.shape[1]} joints, but the initial arm (start, --robot) has {joints}; "
                "give logs of that arm, or another initial arm"
            )
    if not any(log.torque.any() for log in given):
        raise ValueError("all torques in the logs are zero; choose the torque columns with --columns tau1=NAME,...")
    step = advance or (lambda: None)
    try:
        if isinstance(start, Robot):
            return _of_robot(given, start, estimated_robot(given, start, step))
        return _of_stages(given, start, estimated(_long(given), start, stribeck, step))
    except np.linalg.LinAlgError:
        raise ValueError(
            "the equations built from the logs have no solution; check their units, and correct implausible numbers"
        ) from None


def _long(logs: Sequence[Log]) -> list[Log]:
    """Return the logs that are long enough for a prediction; ValueError if all are too short."""
    found = [log for log in logs if log.duration > _SHORTEST]
    if not found:
        longest = max(log.duration for log in logs)
        raise ValueError(
            f"a prediction over {HORIZON:g} s needs a part of a log without gaps that is longer than {_SHORTEST:g} s, "
            f"but the longest one is {longest:.3g} s; record without gaps, or choose another time column with "
            "--columns time=NAME"
        )
    return found


def _of_robot(logs: list[Log], start: Robot, fit: RobotFit) -> Identified:
    doubtful = max(fit.held_out.get("robot", (0.0,))) > _DOUBTFUL
    return Identified(
        arm=fit.robot, start=start, ranges=Ranges(), parameters=fit.rows, held_out=fit.held_out,
        held_out_unit="share of the torque, rms", interrupted=fit.interrupted, samples=_samples(logs),
        doubtful=doubtful, _remarks=(*[_LITTLE.format("torque")] * doubtful, *fit.remarks),
        _curves=lambda: fit.curves[:_MOST_DRAWN],
    )  # fmt: skip


def _samples(logs: list[Log]) -> int:
    return sum(len(log.angle) for log in logs)


def _of_stages(logs: list[Log], start: ArmParameters, stages: Stages) -> Identified:
    """Return the identified two-joint arm, given the results of all stages of its estimation."""
    rows, long = _rows(stages), _long(logs)
    short = [log for log in logs if log not in long]
    said = [
        f"{len(short)} part(s) shorter than {_SHORTEST:g} s are left out; the first is {log.name}, "
        f"{log.duration:.3g} s."
        for log in short[:1]
    ]
    held = {"start": stages.start_error} | stages.errors if stages.start_error is not None else {}
    return Identified(
        arm=stages.arm,
        start=start,
        ranges=_ranges(stages, rows),
        parameters=tuple(rows),
        held_out={name: tuple((1e3 * errors).tolist()) for name, errors in held.items()},
        held_out_unit="mrad, rms",
        interrupted=stages.interrupted,
        doubtful=_is_doubtful(stages),
        samples=_samples(long),
        _remarks=(*said, *_remarks(stages, len(long))),
        _curves=lambda: [_drawn(log, stages) for log in long[:_MOST_DRAWN]],
    )


def _rows(stages: Stages) -> list[dict[str, Any]]:
    """Return rows of the parameters that the logs determine, in the order of the search, then rows of the others.

    The half-width of an interval is √(w² + d²), where w is the half-width from the differences between logs and d the
    largest difference between stages: the equations of each stage leave something out.
    """
    found = stages.found
    assert found is not None
    widths, search = found.half_widths(), found.search
    differing = np.zeros(len(found.z))
    for other in stages.others:
        values = other.named()
        for k, name in enumerate(search.names):
            value = values.get(name, found.named()[name])
            own = np.log(value) if search.exponential[k] else value
            differing[k] = max(differing[k], abs(own - found.z[k]))
    rows, before, after = [], _named(stages.start), _named(stages.arm)
    for k, (name, unit) in enumerate(zip(search.names, search.units, strict=True)):
        ends = None
        if widths is not None and not np.isnan(widths[k]):
            wide = np.hypot(widths[k], differing[k])
            ends = np.clip((found.z[k] - wide, found.z[k] + wide), search.low[k], search.high[k])
        if ends is not None and search.exponential[k]:
            ends = np.exp(np.clip(ends, -50.0, 50.0))
        low, high = (None, None) if ends is None else map(float, ends)
        rows.append(_row(name, unit, before[name], after[name], low, high, told=True))
    covered = {name.split(" ")[0] for name in (*search.names, *stages.untold)}
    rest = [name for name in _NAMES if name not in covered]  # these do not affect a rigid arm
    for name in (*stages.untold, *rest):
        row = _row(name, units_of([name])[0], before[name], after[name], None, None, told=False)
        rows.append(row if name in stages.untold else row | {"needed": False})
    return rows


def _row(
    name: str, unit: str, start: float, value: float, low: float | None, high: float | None, *, told: bool
) -> dict[str, Any]:
    needed = "friction" not in name
    return {
        "name": name, "unit": unit, "start": start, "value": value, "low": low, "high": high, "told": told,
        "needed": needed,
    }  # fmt: skip


def _named(arm: ArmParameters) -> dict[str, float]:
    """Return the parameters of an arm by name, with the sums and differences that a search may contain."""
    named = dict(zip(_NAMES, start_of(arm).tolist(), strict=True))
    named["inertia[0] + motor_inertia[0]"] = named["inertia[0]"] + named["motor_inertia[0]"]
    for joint in (0, 1):
        static, coulomb = f"static_friction[{joint}]", f"coulomb_friction[{joint}]"
        named[f"{static} - {coulomb}"] = named[static] - named[coulomb]
    return named


def _ranges(stages: Stages, rows: list[dict[str, Any]]) -> Ranges:
    """Return ranges of rotor inertia and stiffness: the parameter's interval in `rows`, or a wide range without one."""
    arm, by_name = stages.arm, {row["name"]: row for row in rows}
    rotors, springs = [], []
    for joint in (0, 1):
        rotor, spring = arm.motor_inertia[joint], arm.stiffness[joint]
        whole = arm.inertia[joint] + rotor
        row = by_name.get(f"motor_inertia[{joint}]", {"low": None})
        ends = (_ROTOR[0] * whole, _ROTOR[1] * whole) if row["low"] is None else (row["low"], row["high"])
        rotors.append((min(rotor, max(ends[0], 0.01 * whole)), max(rotor, min(ends[1], _ROTOR[1] * whole))))
        row = by_name[f"stiffness[{joint}]"]
        ends = (spring / _SPRING, spring * _SPRING) if row["low"] is None else (row["low"], row["high"])
        springs.append((max(ends[0], spring / _SPRING), min(ends[1], spring * _SPRING)))
    for motor in (tuple(rotors), (rotors[0], (arm.motor_inertia[1],) * 2), ((arm.motor_inertia[0],) * 2,) * 2):
        ranges = Ranges(motor, tuple(springs))
        try:
            ranges.corners(arm)
            return ranges
        except ValueError:  # no arm with this much of its inertia in its rotors
            continue
    return Ranges(stiffness=tuple(springs))


def _is_doubtful(stages: Stages) -> bool:
    """Return whether the held-out rms error of any joint exceeds `_DOUBTFUL` times the rms motion of that joint.

    The error is that of the last stage adopted among rigid, sticking and elastic.
    """
    if stages.motion is None or not stages.errors:
        return False
    errors = stages.errors["elastic" if stages.is_elastic else "sticking" if stages.is_sticking else "rigid"]
    return bool(np.max(errors / np.maximum(stages.motion, 1e-9)) > _DOUBTFUL)


def _remarks(stages: Stages, logs: int) -> list[str]:
    found = ["Lengths, masses, gravity and limits are those of the starting arm: motors alone do not determine them."]
    if _is_doubtful(stages):
        found.append(_LITTLE.format("motion"))
    if stages.untold:
        found.append(
            f"The logs do not determine {', '.join(stages.untold)}: the values of the starting arm are kept. Move both "
            "joints to and fro, faster and further, as in the motion that --suggest writes."
        )
    if logs == 1:
        found.append("One log does not show how the values differ between logs, so there are no intervals.")
    if stages.interrupted:
        found.append("The search was interrupted, so later stages and some held-out errors are missing.")
    elif not stages.is_elastic:
        found.append(
            "Stiffness, damping and the split of inertia 1 between rotor and link are not determined: elastic joints "
            "in the model do not lower the held-out error. The file contains the ranges of these parameters; give the "
            "rotor inertia of the data sheet to narrow them."
        )
    if "Stribeck" in stages.errors and not any("static" in name for name in stages.found.search.names):  # type: ignore[union-attr]
        found.append("Friction that is larger at rest does not lower the held-out error, so it is not determined.")
    return found


def _drawn(log: Log, stages: Stages) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """Return a log's name, times [s], measured and simulated angles (N, 2) [rad]; nan outside the simulations."""
    windows = windows_of(log, 0, HORIZON, HORIZON, 10**6)
    theta, simulator = start_of(stages.arm), ELASTIC if stages.is_elastic else RIGID
    computed = np.full(log.angle.shape, np.nan)
    if len(windows):
        lanes = np.repeat(theta[:, np.newaxis], len(windows), axis=1)
        angles = simulated(simulator, windows, lanes, simulator.states(windows, theta, stages.arm), stages.arm)
        for k, first in enumerate(windows.first):
            computed[first + windows.taken[1:]] = angles[1:, :, k]
    return log.name, np.arange(len(log.angle)) * log.period, log.angle, computed
