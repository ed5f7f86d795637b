"""Logs from files as robots write them: columns by name, units, uneven stamps, gaps and idle ends.

Between time stamps, angles are interpolated linearly and torques are held:

    q(t) = line through (t_i, q_i),    Γ_k = 1/T ∫ Γ(t + delay) dt from k T to (k + 1) T,    T the median step

so that an evenly spaced log does not change. A remark of the log states each assumption, omission and change.
"""

import contextlib
import dataclasses
import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from fuzzyarm.common import checks
from fuzzyarm.common.checks import shown
from fuzzyarm.identification._tables import LogTable, listing, read_table, unit_of
from fuzzyarm.identification.log import FEWEST_SAMPLES, Log

__all__ = ["held_mean", "read_log"]

_TURN = 2.0 * math.pi
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": _TURN / 360.0, "rev": _TURN, "turn": _TURN}
_UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "q": _ANGLES,
    "dq": {f"{name}/s": size for name, size in _ANGLES.items()}
    | dict.fromkeys(("rpm", "1/min", "rev/min"), _TURN / 60.0),
    "tau": {"nm": 1.0, "mnm": 1e-3, "ncm": 1e-2, "nmm": 1e-3, "knm": 1e3, "lbfin": 0.1129848, "ozin": 7.061552e-3},
}
"""Size of each unit in SI units; the units are spelled as `_tables.unit_of` returns them."""
# Endings of column names that state neither an angle nor a torque; lower-case a or v may be the name of a joint.
_RAW = frozenset(
    ["counts", "count", "cnt", "ticks", "mA", "ma", "A", "amp", "amps", "ampere", "V", "mV", "mv", "percent"]
)
_ENDINGS = ("s", "ms", "us", "ns", "rad", "deg", "rev", "rads", "degs", "rpm", "nm", "mnm")  # in a name: time_ms
_WORDS = {
    "time": "time t timestamp timestamps stamp seconds sec zeit",
    "q": "q pos position positions angle angles theta phi",
    "dq": "dq qd qdot vel velocity velocities omega speed dtheta",
    "tau": "tau torque torques effort efforts moment",
}
_KIND = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_IDLE_WORDS = "joint joints state states motor meas measured actual act axis j"
_DEMANDED = (
    "des desired ref reference cmd command commanded target set goal err error link ff est std raw filtered temp"
)
_ROLE = re.compile(r"time|topic|(q|dq|tau)[1-9]\d?")
_EVEN = 0.01  # largest deviation of a time step from the median step, as a share of the median step
_FEWEST_ROWS = 0.5  # share of the rows that must have all numbers
_FASTEST, _SLOWEST = 5e-5, 0.05  # s, range of the median step in which a unit of time is plausible
_GAP, _LEAST_GAP = 5.0, 0.02  # lower limits of a gap: in median steps; in s
_NEAR = 11  # rows in the window of a running median
_USUAL = 0.8  # quantile of steps or torques that stray values do not raise
_AWAY, _FAST = 10.0, 5.0  # lower limits of a stray angle's distance: in median steps nearby; in usual steps
_PEAK = 10.0  # lower limit of a stray torque's distance, in largest lasting torques
_MOST_STRAY = 0.05  # share of the rows
_COUNTERS = 2.0 ** np.arange(8, 33)  # counts at which encoders wrap
_WRAPPED = 0.01  # largest relative difference between a jump and a turn
_REPEATED = 0.4  # share of zero time steps above which each line is assumed to contain a single joint
_MOVED = 0.02  # share of a joint's range within which the joint counts as idle
_KEPT, _LEAST_IDLE = 0.3, 0.5  # s: idle time kept at each end; least idle time that is cut off
_LATEST = 1.0  # s, largest delay
_LARGEST_GEAR = 1e4
_SAME = 0.2  # largest deviation from 1 of the ratio of a velocity to the slope of its angle


def read_log(
    path: Path,
    *,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str | float] | None = None,
    gear: tuple[float, ...] = (),
    delay: float = 0.0,
) -> tuple[Log, ...]:
    """Return the log in a file, cut at its gaps; formats: delimited text, NumPy, MATLAB, joint states of a ROS 2 bag.

    Args:
        path: the file, or the folder of a bag.
        columns: names or numbers (from 1) of columns by role: time, q1, q2, ..., dq1, ..., tau1, ...; topic selects
            the topic of a bag. Roles that are not given are guessed from the names in the file.
        units: unit, or its size in SI units, of time, q, dq or tau, or of one column such as tau2, where the file
            states no unit or a wrong one.
        gear: gear ratios, one or one per joint, if the log refers to the motors' side; they divide q and multiply tau.
        delay: time [s] by which torques are recorded later than their angles.

    Raises:
        ValueError: the format of the file is unknown, or a column is missing, ambiguous, without numbers or in an
            unknown unit.
        OSError: the file cannot be read.
    """
    path = checks.path_of("path", path)
    delay = checks.real("delay", delay, "s", low=-_LATEST, high=_LATEST)
    columns, units = dict(checks.instance("columns", columns or {}, dict)), checks.instance("units", units or {}, dict)
    checks.instance("gear", gear, tuple)
    checks.texts("columns", [*columns, *columns.values()])
    for role in columns:
        if not _ROLE.fullmatch(role):
            raise ValueError(
                f"columns has the unknown role {shown(role)}; allowed: time, q1, dq1, tau1, q2, ... and topic"
            )
    for kind in units:
        checks.choice("a key of units", kind.rstrip("123456789") if isinstance(kind, str) else kind, tuple(_UNITS))
    try:
        table = read_table(path, columns.pop("topic", None))
        roles = _roles_of(table, columns)
        logs = _pieces(table, roles, units, gear, delay)
    except (TypeError, ValueError) as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    names = [path.name, *(f"{path.name}, part {k}" for k in range(2, len(logs) + 1))]
    logs = [dataclasses.replace(log, name=name) for log, name in zip(logs, names, strict=True)]
    return dataclasses.replace(logs[0], remarks=tuple(dict.fromkeys(table.remarks))), *logs[1:]


def _roles_of(table: LogTable, given: dict[str, str]) -> dict[str, int]:
    """Return the column of each role: time, q1, tau1, ..., and dq1, ... if all joints have one; `given` sets some."""
    roles = {role: _column(table, role, name) for role, name in given.items()}
    guessed: dict[tuple[str, str], list[int]] = {}
    for k, name in enumerate(table.names if table.headed else ()):
        kind, label = _meaning(name)
        if kind:
            guessed.setdefault((kind, label), []).append(k)
    chosen = [int(role.lstrip("dqtau")) for role in given if role != "time"]
    labels = _labels(guessed)[: max(chosen, default=None)]
    named = [label for label in labels if not label.isdigit()]
    if named and not any(role.startswith("q") for role in given):
        table.remarks.append("the joints are taken in this order: " + ", ".join(labels))
    wanted = {("time", ""): "time"} | {
        (kind, label): f"{kind}{j}" for j, label in enumerate(labels, start=1) for kind in ("q", "dq", "tau")
    }
    for key, role in wanted.items():
        if role in roles or key not in guessed:
            continue
        several = guessed[key] if role != "time" else guessed[key][:1]
        if len(several) > 1:
            raise ValueError(
                f"columns {listing(table.names[k] for k in several)} could each be {role}; choose one with --columns "
                f"{role}=NAME"
            )
        roles[role] = several[0]
    joints = 0
    while f"q{joints + 1}" in roles or f"tau{joints + 1}" in roles:
        joints += 1
    _check_times(table, roles, "time" in given)
    needed = ["time", *(f"{kind}{j + 1}" for kind in ("q", "tau") for j in range(max(joints, 1)))]
    missing = [role for role in needed if role not in roles]
    if missing:
        example = ",".join(f"{role}=NAME" for role in missing[:5])
        asked = ", ".join(missing)
        text = f"its {len(table.names)} columns have no heading, so no column is recognised as {asked}"
        if table.headed:
            text = f"none of the columns {listing(table.names)} is recognised as {asked}"
        more = ",q2=NAME,..." if joints < 2 and any(role != "time" for role in missing) else ""
        raise ValueError(f"{text}; give the columns' names or numbers with --columns {example}{more}")
    speeds = [f"dq{j + 1}" for j in range(joints)]
    kept = needed + (speeds if all(role in roles for role in speeds) else [])
    found = {role: roles[role] for role in kept}
    twice = [role for role, k in found.items() if list(found.values()).count(k) > 1]
    if twice:
        name = shown(table.names[found[twice[0]]])
        raise ValueError(f"{' and '.join(twice[:2])} refer to the same column {name}; give each its own column")
    return found


def _check_times(table: LogTable, roles: dict[str, int], is_given: bool) -> None:
    """Set the time in `roles` to a column named stamp unless one `is_given`; ValueError if time1, time2, ... differ."""
    words = {k: re.findall(r"[^\W\d_]+", name.lower()) for k, name in enumerate(table.names if table.headed else ())}
    every = [k for k, one in words.items() if one and _KIND.get(one[-1]) == "time" and not {"des", "ref"} & set(one)]
    if "time" not in roles or len(every) < 2:
        return
    if not is_given:
        roles["time"] = next((k for k in every if "stamp" in words[k]), roles["time"])
        table.remarks.append(
            f"its time is read from column {shown(table.names[roles['time']])}; to choose another, give --columns "
            "time=NAME"
        )
    for other in every:
        apart = np.nan_to_num(np.abs(table.values[:, other] - table.values[:, roles["time"]])).max(initial=0.0)
        if words[other] == words[roles["time"]] and apart > 0.0:
            raise ValueError(
                f"its columns {roles['time'] + 1} and {other + 1} both contain times, which differ by up to "
                f"{apart:.3g}; write all signals at common instants, with a single time column"
            )


def _column(table: LogTable, role: str, name: str) -> int:
    if table.names.count(name) == 1:
        return table.names.index(name)
    if name.isdecimal() and 1 <= int(name) <= len(table.names):
        return int(name) - 1
    reason = "occurs more than once; give its number" if name in table.names else "does not exist"
    raise ValueError(f"column {shown(name)} for {role} {reason}; columns: {listing(table.names)}")


def _meaning(name: str) -> tuple[str, str]:
    """Return the kind of a column, time, q, dq, tau or "", and the label of its joint: ("q", "1") for q_meas1."""
    words = re.findall(r"[^\W\d_]+|\d+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
    if len(words) > 1 and words[-1] in _ENDINGS:
        words = words[:-1]
    kinds = [word for word in words if word in _KIND]
    if not kinds or set(_DEMANDED.split()).intersection(words):
        return "", ""
    kind = next((word for word in kinds if _KIND[word] != "time"), kinds[0])
    label = [word for word in words if word != kind and word not in _IDLE_WORDS.split()]
    return (_KIND[kind], " ".join(label)) if _KIND[kind] != "time" or not label else ("", "")


def _labels(guessed: Collection[tuple[str, str]]) -> list[str]:
    """Return the labels of the joints, in order, from pairs (kind, label) such as ("q", "1") for angle 1.

    They are the whole numbers that label angles or torques; without any, the labels of both an angle and a torque.
    """
    numbered = {label for kind, label in guessed if kind in ("q", "tau") and label.isdecimal()}
    if numbered:
        return sorted(numbered, key=int)
    named = [label for kind, label in guessed if kind == "q" and ("tau", label) in guessed]
    ends = [re.search(r"\d+$", label) for label in named]
    numbers = {int(end[0]): label for end, label in zip(ends, named, strict=True) if end}
    return [numbers[k] for k in sorted(numbers)] if len(numbers) == len(named) else named


def _unit(table: LogTable, kind: str, names: list[str], given: Mapping[str, str | float]) -> float | None:
    """Return the factor to SI units of columns of a kind (q, ...), from `given` or the heading; None if in neither."""
    stated = {table.units[name] for name in names if name in table.units}
    text = given[kind] if kind in given else stated.pop() if len(stated) == 1 else ""
    known = _UNITS[kind]
    if stated and kind not in given:
        raise ValueError(f"the columns {listing(names)} have different units; convert them to one unit")
    if isinstance(text, str) and not text:
        return None
    if isinstance(text, str):
        with contextlib.suppress(ValueError):
            text = float(text)
    if not isinstance(text, str):
        return checks.real(f"unit of {kind}", text, above=0.0)
    short = unit_of(text)
    if short not in known:
        raise ValueError(
            f"unknown unit {shown(text)} for {kind}; give --units {kind}=UNIT, where UNIT is one of {', '.join(known)} "
            "or the unit's size in SI units"
            + ", such as the torque constant for a column in A: tau=0.12"
            * (kind == "tau")
        )
    if kind not in given and known[short] != 1.0:
        table.remarks.append(f"{kind} is in {text}, according to the heading")
    return known[short]


def _pieces(
    table: LogTable, roles: dict[str, int], units: Mapping[str, str | float], gear: Sequence[float], delay: float
) -> list[Log]:
    """Return the evenly spaced logs in a table, cut at its gaps; `roles` maps roles to columns, see `read_log`."""
    values, remarks = table.values[:, list(roles.values())], table.remarks
    whole = np.isfinite(values).all(axis=1)
    for place in roles.values():
        if not np.isfinite(table.values[:, place]).any():
            text = f", but text such as {shown(table.texts[place])}" if place in table.texts else ""
            raise ValueError(
                f"column {shown(table.names[place])} contains no numbers{text}; choose another column with --columns"
            )
    if not whole.any():
        raise ValueError("no row has a number in every column that is read; resample the signals to common instants")
    if whole.mean() < _FEWEST_ROWS:
        words = [
            f"{shown(table.texts[place])} in column {shown(table.names[place])}"
            for place in roles.values()
            if place in table.texts
        ]
        raise ValueError(
            f"{np.count_nonzero(~whole)} of {len(whole)} rows lack a number{': ' + words[0] if words else ''}; write "
            "numbers without thousands separators and without words, or leave these rows out"
        )
    if not whole.all():
        remarks.append(f"{np.count_nonzero(~whole)} row(s) that lack a number are left out")
    joints = sum(role.startswith("tau") for role in roles)
    if len(gear) not in (0, 1, joints):
        raise ValueError(f"gear has {len(gear)} ratios; allowed: one, or one for each of the {joints} joints")
    ratio = np.array([checks.real("gear", one, low=1.0 / _LARGEST_GEAR, high=_LARGEST_GEAR) for one in gear] or [1.0])
    for key in units:
        if key not in _UNITS and (key.startswith("time") or not 1 <= int(key.lstrip("dqtau")) <= joints):
            allowed = f"time, q, dq, tau, or q1, dq1, tau1 and so on, up to joint {joints}"
            raise ValueError(f"units has the unknown key {shown(key)}; allowed: {allowed}")
    part, names, size = {}, {}, {}
    for kind in _UNITS:
        named = {role: table.names[k] for role, k in roles.items() if role.startswith(kind)}
        part[kind] = values[whole][:, [role in named for role in roles]]
        names[kind] = list(named.values())
        size[kind] = _unit(table, kind, [name for role, name in named.items() if role not in units], units)
    for role, place in roles.items():
        name, kind = table.names[place], role.rstrip("123456789")
        own = re.split(r"[\W_]", name)[-1]
        if own in _RAW and kind != "time" and name not in table.units and not {kind, role} & set(units):
            raise ValueError(
                f"column {shown(name)} for {role} seems to be in {own}; give the size of its unit in SI "
                f"units, as in --units {role}=0.12"
            )

    def sizes(kind: str, other: float | None = None) -> np.ndarray:
        """Return factors (n,) that convert the joints' columns of a kind to SI; `other` replaces an unknown factor."""
        common = size[kind] or other or 1.0
        one = [{kind: units[f"{kind}{j}"]} if f"{kind}{j}" in units else None for j in range(1, joints + 1)]
        return np.array([common if own is None else _unit(table, kind, [], own) or common for own in one])

    stamps = part["time"][:, 0]
    if joints == 1 and np.mean(np.diff(stamps) == 0.0) > _REPEATED:
        raise ValueError("several lines have the same time; write one line per instant, with a column for each joint")
    if (np.diff(stamps) < 0.0).all():
        stamps, part = stamps[::-1], {kind: values[::-1] for kind, values in part.items()}
        remarks.append("its time decreases throughout, so it is read from the last row to the first")
    time = _seconds(stamps, size["time"], remarks)
    for j, (name, own) in enumerate(zip(names["q"], sizes("q"), strict=True)):
        part["q"][:, j] = _unwrapped(part["q"][:, j], _TURN / own, name, remarks)
    kept = ~_stray(time, part["q"], part["tau"], [*names["q"], *names["tau"]], remarks)
    angle, torque = part["q"] * sizes("q") / ratio, part["tau"] * sizes("tau") * ratio
    velocity = part["dq"] * sizes("dq", size["q"]) / ratio if part["dq"].size else part["dq"]
    signals = np.concatenate([angle, velocity, torque], axis=1)
    logs = []
    for stamps, piece in _cut(time[kept], signals[kept], remarks):
        period, angles, held = _even(stamps, piece[:, :-joints], piece[:, -joints:], delay, remarks)
        log = Log(period, angles[:, :joints], held, angles[:, joints:] if angles.shape[1] > joints else None)
        logs.append(_trimmed(log, remarks))
    return _with_true_velocities(logs, remarks)


@np.errstate(over="ignore", invalid="ignore")  # of numbers that `Log` refuses
def _unwrapped(angle: np.ndarray, turn: float, name: str, remarks: list[str]) -> np.ndarray:
    """Return an angle (N,) without its jumps; if there are any, a remark with its `name` is added to `remarks`.

    A jump has the size of a `turn`, or else 360, or else, if all values are whole numbers, a power of two.
    """
    steps, counters = np.diff(angle), _COUNTERS if (angle == np.round(angle)).all() else ()
    span = np.ptp(angle) / (1.0 + _WRAPPED)
    for size in (turn, 360.0, *counters):
        rest = np.abs(np.abs(steps) - size)
        usual = median_filter(np.minimum(rest, np.abs(steps)), _NEAR)
        wraps = (rest < _WRAPPED * size + 3.0 * usual) & (np.maximum(_AWAY * usual, span) < size)
        if wraps.any():
            what = f"a turn ({size:.5g})" if size == turn else f"{size:.5g}"
            remarks.append(f"{name} jumps by {what} in {np.count_nonzero(wraps)} place(s), so it is unwrapped")
            return np.asarray(angle - np.append(0.0, np.cumsum(size * np.sign(steps) * wraps)))
    return angle


@np.errstate(over="ignore", invalid="ignore")
def _stray(time: np.ndarray, angle: np.ndarray, torque: np.ndarray, names: list[str], remarks: list[str]) -> np.ndarray:
    """Return the mask (N,) of rows with a stray angle or torque, (N, n) each, in any unit.

    A stray value differs from the running median: a torque by many times the largest running median, an angle by far
    more than the steps nearby. Each column with stray values gets a remark with its name; `names` are those of the
    angles, then of the torques. ValueError: too many rows have a stray value.
    """
    middle = median_filter(torque, (_NEAR, 1))
    lasting = np.maximum(np.abs(middle).max(axis=0), np.quantile(np.abs(torque), _USUAL, axis=0))
    limits = np.maximum(_PEAK * lasting, lasting.max())
    stray = [*(_away(one) for one in angle.T), *((np.abs(torque - middle) > limits) & (limits > 0.0)).T]
    for name, values, rows in zip(names, (*angle.T, *torque.T), stray, strict=True):
        if rows.any():
            k = int(np.argmax(rows))
            text = f"{name} has outliers in {np.count_nonzero(rows)} row(s), the first ({values[k]:.6g}) at t = "
            text += f"{time[k]:.4g} s"
            if rows.mean() > _MOST_STRAY:
                raise ValueError(f"{text}; allowed: at most {100.0 * _MOST_STRAY:g} % of the rows. Correct the column")
            remarks.append(f"{text}; these rows are left out")
    return np.asarray(np.any(stray, axis=0))


def _away(angle: np.ndarray) -> np.ndarray:
    """Return the mask of outliers (N,); consecutive equal angles count as one, since a sentinel may be repeated."""
    changes = np.append(True, np.diff(angle) != 0.0)
    kept = first = np.flatnonzero(changes)
    for _ in range(3):  # strays may hide others nearby
        values = angle[kept]
        steps = np.abs(np.diff(values, prepend=values[0]))
        most = np.maximum(_AWAY * median_filter(steps, _NEAR), _FAST * np.quantile(steps, _USUAL))
        kept = kept[np.abs(values - median_filter(values, _NEAR)) <= most]
    return np.asarray(~np.isin(first, kept)[np.cumsum(changes) - 1])


def _seconds(stamps: np.ndarray, unit: float | None, remarks: list[str]) -> np.ndarray:
    """Return times (N,) [s] since the first stamp; a `unit` [s] of None is guessed from the steps, with a remark."""
    steps = np.diff(stamps)
    if not (steps > 0.0).any():
        raise ValueError("its time column never increases; choose another column with --columns time=NAME")
    step = float(np.median(steps[steps > 0.0]))
    if unit is None:
        sizes = {name: size for name, size in _UNITS["time"].items() if size <= 1.0}
        fitting = [name for name, size in sizes.items() if _FASTEST <= step * size <= _SLOWEST]
        if not fitting:
            raise ValueError(
                f"the median time step {step:.4g} fits no unit of time (allowed: at most {_SLOWEST:g} s); state the "
                "unit or its size in s, as in --units time=ms, or name another column with --columns time=NAME"
            )
        unit = sizes[fitting[0]]
        if unit != 1.0:
            remarks.append(f"its time seems to be in {fitting[0]}: the median step is {step:.6g}")
    return np.asarray((stamps - stamps[0]) * unit)


def _cut(time: np.ndarray, signals: np.ndarray, remarks: list[str]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (times [s], signals) of each long part between gaps, without rows that are not later than all rows before.

    What is left out is noted in `remarks`.
    """
    steps = np.diff(time)
    longest = max(_GAP * float(np.median(steps[steps > 0.0])), _LEAST_GAP)
    gaps = np.flatnonzero(np.abs(steps) > longest) + 1
    pieces, dropped = [], 0
    for stamps, part in zip(np.split(time, gaps), np.split(signals, gaps), strict=True):
        later = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
        dropped += int(np.count_nonzero(~later))
        pieces.append((stamps[later], part[later]))
    if dropped:
        remarks.append(f"{dropped} time stamp(s) do not increase; their rows are left out")
    long = [piece for piece in pieces if len(piece[0]) >= FEWEST_SAMPLES]
    if not long:
        largest = max(len(stamps) for stamps, _ in pieces)
        raise ValueError(
            f"its longest part without a gap in time of more than {1e3 * longest:.3g} ms has only {largest} of the "
            f"{FEWEST_SAMPLES} samples needed; if another column contains the time, name it with --columns time=NAME"
        )
    if len(pieces) > 1:
        short = sum(len(stamps) for stamps, _ in pieces) - sum(len(stamps) for stamps, _ in long)
        remarks.append(
            f"it has {len(pieces) - 1} gap(s) in time of more than {1e3 * longest:.3g} ms; {len(long)} part(s) with "
            f"{FEWEST_SAMPLES} samples or more are used, and {short} sample(s) in shorter parts are left out"
        )
    return long


def _even(
    stamps: np.ndarray, lines: np.ndarray, torque: np.ndarray, delay: float, remarks: list[str]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the period [s], and `lines` (N, m) and mean torques (N, n) at instants one period apart.

    `lines` are interpolated linearly. A mean is over the period that begins `delay` [s] after the instant. Uneven
    stamps are noted in `remarks`.
    """
    steps = np.diff(stamps)
    period = float(np.median(steps))
    uneven = np.abs(steps - period) > _EVEN * period
    if not uneven.any():
        period, at = float(np.mean(steps)), stamps
        if not delay:
            return period, lines, torque
    else:
        at = stamps[0] + period * np.arange(int((stamps[-1] - stamps[0]) / period + 1e-6) + 1)
        remarks.append(
            f"{100.0 * np.mean(uneven):.2g} % of the time steps differ from {1e3 * period:.4g} ms, so the log is "
            "resampled: angles by linear interpolation, torques as the mean of the held values"
        )
        lines = np.stack([np.interp(at, stamps, line) for line in lines.T], axis=1)
    return period, lines, held_mean(stamps, torque, at + delay, period)


def held_mean(stamps: np.ndarray, torque: np.ndarray, at: np.ndarray, period: float) -> np.ndarray:
    """Return 1/T ∫ Γ dt from each instant `at` (N,) [s] over a period T [s], shape (N, n).

    Γ (M, n) [N m] is held from its stamp (M,) [s] to the next; the first and last torques also apply beyond the stamps.
    """
    begin, end = min(stamps[0], at[0]) - period, max(stamps[-1], at[-1] + period) + period
    edges = np.concatenate([[begin], stamps, [end]])
    areas = np.concatenate([torque[:1], torque]) * np.diff(edges)[:, np.newaxis]
    integral = np.concatenate([np.zeros((1, torque.shape[1])), np.cumsum(areas, axis=0)])
    sums = [np.interp(at + period, edges, one) - np.interp(at, edges, one) for one in integral.T]
    return np.stack(sums, axis=1) / period


def _trimmed(log: Log, remarks: list[str]) -> Log:
    """Return a log without most of the idle time at both ends; if time is cut off, this is noted in `remarks`."""
    near = _MOVED * np.ptp(log.angle, axis=0)
    moving = [np.flatnonzero((np.abs(log.angle - log.angle[k]) > near).any(axis=1)) for k in (0, -1)]
    if not (moving[0].size and moving[1].size):
        return log
    margin, count = round(_KEPT / log.period), len(log.angle)
    first, last = max(int(moving[0][0]) - margin, 0), min(int(moving[1][-1]) + margin + 1, count)
    if (first + count - last) * log.period < _LEAST_IDLE or last - first < FEWEST_SAMPLES:
        return log
    remarks.append(
        f"idle ends are cut off: {first * log.period:.3g} s at the beginning and {(count - last) * log.period:.3g} s "
        "at the end"
    )
    velocity = None if log.velocity is None else log.velocity[first:last]
    return dataclasses.replace(log, angle=log.angle[first:last], torque=log.torque[first:last], velocity=velocity)


def _with_true_velocities(logs: list[Log], remarks: list[str]) -> list[Log]:
    """Return the logs, without velocities if these are not the slopes of the angles (wrong unit, sign or gear)."""
    if logs[0].velocity is None:
        return logs
    pairs = [(log.smoothed().dq, dataclasses.replace(log, velocity=None).smoothed().dq) for log in logs]
    given, slope = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    ratio = np.sum(given * slope, axis=0) / np.maximum(np.sum(slope * slope, axis=0), 1e-300)
    wrong = np.flatnonzero((np.abs(ratio - 1.0) > _SAME) & (np.ptp(slope, axis=0) > 0.0))
    if not wrong.size:
        return logs
    j = int(wrong[0])
    remarks.append(
        f"the velocities of joint {j + 1} are {ratio[j]:.3g} times the slopes of its angles (another unit or sign?): "
        "the velocities are not used"
    )
    return [dataclasses.replace(log, velocity=None) for log in logs]
