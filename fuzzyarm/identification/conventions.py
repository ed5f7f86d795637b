"""The conventions of a log of a two-joint arm: units, side of the gear, angles, zeros, signs, order and delay.

The arm is assumed rigid, with base parameters π >= 0 of which the first five are near those of the starting arm, π_0.
A set of conventions is a reading of the log, with the misfit

    J² = min over π of (Σ |(Γ - Y π) / s|² + Σ_k ((π_k - π_0k) / σ_k)²) / Σ |Γ / s|²

where s is a share of the largest rms torque, σ_k a standard deviation, and `_rigid` defines Y and π. Each change must
lower J by a minimum share; the best reading is reported only if its J is below `_SPOKEN` times the J without changes.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import nnls

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.identification._rigid import base_of, regressor
from fuzzyarm.identification.log import Log
from fuzzyarm.identification.reading import held_mean

__all__ = ["Diagnosis", "Reading", "diagnosed"]

_SPOKEN, _USABLE, _EVIDENCE = 0.75, 0.6, 20.0  # share of the misfit; share of the torque; fall of the sum of squares
_PER_CHANGE = 0.85  # factor by which each further change must lower the misfit
_MOST_CHANGES = 2
_RIVAL = 1.1  # largest misfit of a rival, in best misfits
_MODEL = 0.15  # error of the rigid arm as a share of the largest rms torque
_KNOWN = np.array([0.5, 0.5, 0.5, 2.0, 0.5])  # σ as a share of π_0: the rotor is the most uncertain
_LEAST = np.array([0.05, 0.02, 0.02, 0.02, 0.05])  # least σ, as a share of the largest π_0 with the same unit
_ROWS = 400  # approximate number of instants of a log
_ALIKE = 0.2  # least relative difference between a gear ratio and 2π at which both are tried
_SLOWEST = 0.1  # share of the rms velocity below which the sign of friction is uncertain
_DELAYS = 1e-3 * np.arange(5.0, 65.0, 5.0)  # s
_NEAR = 1e-3 * np.arange(-4.0, 5.0)  # s
_SIGNS = {  # of angles 1 and 2 and torques 1 and 2; a change of all four mirrors the arm
    (1, 1, -1, -1): "both torques have the opposite sign",
    (1, 1, -1, 1): "torque 1 has the opposite sign",
    (1, 1, 1, -1): "torque 2 has the opposite sign",
    (-1, 1, 1, 1): "angle 1 has the opposite sign",
    (1, -1, 1, 1): "angle 2 has the opposite sign",
    (-1, 1, -1, 1): "joint 1 turns in the opposite direction to joint 2",
    (1, -1, -1, 1): "angle 2 and torque 1 have the opposite sign",
}


@dataclasses.dataclass(frozen=True)
class Reading:
    """The conversion of a log's data to the package's angles and torques; by default nothing changes."""

    words: tuple[str, ...] = ()  # the conventions of the log that differ from the package's
    angle: tuple[float, float] = (1.0, 1.0)  # factors of the joints' angles
    torque: tuple[float, float] = (1.0, 1.0)  # factors of the joints' torques
    exchanged: str = ""  # "both": the joints are in the other order; "torque": only their torques are
    signs: tuple[int, ...] = (1, 1, 1, 1)  # of angles 1 and 2 and torques 1 and 2
    absolute: bool = False  # whether angle 2 is measured against the vertical
    zero: tuple[float, float] = (0.0, 0.0)  # added to the angles [rad]
    delay: float = 0.0  # of the torques [s]

    def of_angles(self, values: np.ndarray, order: int = 0) -> np.ndarray:
        """Return angles (N, 2) [rad], or their derivatives of the given order, in the package's conventions."""
        turned = values * self.angle
        turned = (turned[:, ::-1] if self.exchanged == "both" else turned) * self.signs[:2]
        if self.absolute:
            turned = np.stack([turned[:, 0], turned[:, 1] - turned[:, 0]], axis=1)
        return turned + self.zero if order == 0 else turned

    def of_torques(self, values: np.ndarray) -> np.ndarray:
        """Return torques (N, 2) [N m] in the package's conventions, except that a delay remains."""
        scaled = values * self.torque
        return np.asarray((scaled[:, ::-1] if self.exchanged else scaled) * self.signs[2:])

    def applied(self, log: Log) -> Log:
        """Return the log in the package's conventions: angles [rad], velocities [rad/s] and torques [N m] (N, 2)."""
        time, torque = log.period * np.arange(len(log.angle)), log.torque
        if self.delay:
            torque = held_mean(time, torque, time + self.delay, log.period)
        velocity = None if log.velocity is None else self.of_angles(log.velocity, order=1)
        turned = self.of_angles(log.angle), self.of_torques(torque)
        return dataclasses.replace(log, angle=turned[0], torque=turned[1], velocity=velocity)


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """The conventions with which a rigid arm fits the data of a log best."""

    reading: Reading  # the likely one
    misfit: float  # J of the log as it is
    after: float  # J of the likely reading
    rivals: tuple[tuple[Reading, float], ...]  # other readings that fit nearly as well, and their J

    @property
    def doubtful(self) -> bool:
        """Whether the log probably has other conventions than the package."""
        return bool(self.reading.words)

    def sentence(self) -> str:
        """Return a sentence: the likely conventions, the misfits without and with them, and others that fit as well."""
        more = "; ".join(
            f"{' and '.join(one.words) or 'the log as it is'} ({misfit:.2g})" for one, misfit in self.rivals
        )
        return (
            f"{' and '.join(self.reading.words)}; with this interpretation, the misfit of a rigid arm falls from "
            f"{self.misfit:.2g} to {self.after:.2g}" + f"; other conventions fit nearly as well: {more}" * bool(more)
        )


def diagnosed(logs: Sequence[Log], start: ArmParameters, gear: Sequence[float] = ()) -> Diagnosis:
    """Return the likely conventions of logs of one arm, the same for all.

    The logs have angles [rad] and torques [N m] of two joints, (N, 2) each, as `read_log` returns them. `start` is an
    arm with the right lengths; its masses may be wrong by half, other parameters by more. `gear` is the ratio or ratios
    with which the logs were converted to the joint's side, perhaps by mistake.
    """
    data = [_Thinned(log) for log in logs]
    largest = math.sqrt(max(np.mean(np.concatenate([one.torque() ** 2 for one in data]), axis=0).max(), 1e-18))
    found = [(one, *_misfit(data, one, start, largest)) for one in _readings(tuple(gear), several=len(logs) > 1)]
    plain = found[0]
    best = min(found, key=lambda one: math.log(one[1]) - len(one[0].words) * math.log(_PER_CHANGE))
    if best[0].delay:
        near = (dataclasses.replace(best[0], delay=best[0].delay + shift) for shift in _NEAR)
        best = min(((one, *_misfit(data, one, start, largest)) for one in near), key=lambda one: one[1])
        late = "late" if best[0].delay > 0.0 else "early"
        words = (f"the torques seem to be {1e3 * abs(best[0].delay):.0f} ms {late}",)
        best = dataclasses.replace(best[0], words=words), *best[1:]
    gain = (plain[1] ** 2 - best[1] ** 2) * plain[3]
    if not (best[1] < _SPOKEN * plain[1] and best[2] < _USABLE and gain > _EVIDENCE):
        best = plain
    most = max(len(best[0].words), 1)
    rivals = sorted(
        (misfit, place, one)
        for place, (one, misfit, *_) in enumerate(found)
        if len(one.words) <= most and misfit < _RIVAL * best[1] and one.words != best[0].words
        if not (best[0].delay and one.delay)
    )
    return Diagnosis(best[0], plain[1], best[1], tuple((one, misfit) for misfit, _, one in rivals[:3]))


def _readings(gear: tuple[float, ...], several: bool) -> Iterator[Reading]:
    """Yield the reading without changes, then those with one or two.

    `gear` is as for `diagnosed`. Only `several` logs allow a change of the torques' scale alone.
    """
    one, degree = (1.0, 1.0), math.pi / 180.0
    already = "seem to be on the joint's side of the gears even without --gear"
    units = [("", one, one), ("the angles seem to be in degrees", (degree, degree), one)]
    if not any(abs(ratio / math.tau - 1.0) < _ALIKE for ratio in gear):
        units.append(("the angles seem to be in turns", (math.tau, math.tau), one))
    if gear:
        more, less = (gear[0], gear[-1]), (1.0 / gear[0], 1.0 / gear[-1])
        units += [(f"the angles and torques {already}", more, less), (f"the angles {already}", more, one)]
        units += [(f"the torques {already}", one, less)] * several
    units += [("the torques seem to be in N mm", one, (1e-3, 1e-3))] * several
    zeros = (0.0, 0.5 * math.pi, -math.pi, -0.5 * math.pi)
    exchanges = {"": "", "both": "the joints seem to be exchanged", "torque": "the torques seem to be exchanged"}
    signs = {(1, 1, 1, 1): ""} | _SIGNS
    for unit, absolute, sign, zero1, zero2, exchanged in itertools.product(
        units, (False, True), signs, zeros, zeros, exchanges
    ):
        words = (
            unit[0],
            "angle 2 seems to be measured from the vertical, not from link 1" * absolute,
            signs[sign],
            f"the zero of joint 1 seems to be off by {math.degrees(-zero1):+.0f} degrees" * bool(zero1),
            f"the zero of joint 2 seems to be off by {math.degrees(-zero2):+.0f} degrees" * bool(zero2),
            exchanges[exchanged],
        )
        said = tuple(word for word in words if word)
        if len(said) <= _MOST_CHANGES:
            yield Reading(said, unit[1], unit[2], exchanged, sign, absolute, (zero1, zero2))
    for delay in (*-_DELAYS, *_DELAYS):
        yield Reading(("the torques are late",), delay=float(delay))


class _Thinned:
    """The smooth motion of a log at a few hundred instants."""

    def __init__(self, log: Log) -> None:
        motion = log.smoothed()
        settled = np.arange(len(log.angle))[motion.settled]
        self._chosen = settled[:: max(1, len(settled) // _ROWS)]
        self.parts = tuple(part[self._chosen] for part in (motion.q, motion.dq, motion.ddq))
        self.weight = motion.independent / len(self._chosen)
        self._torque, self._period = motion.torque, log.period

    def torque(self, delay: float = 0.0) -> np.ndarray:
        """Return the smoothed torques (N, 2) [N m] at times `delay` [s] after the N instants of this motion."""
        at, every = self._chosen + delay / self._period, np.arange(len(self._torque))
        return np.stack([np.interp(at, every, one) for one in self._torque.T], axis=1)


def _misfit(
    data: Sequence[_Thinned], reading: Reading, start: ArmParameters, largest: float
) -> tuple[float, float, float]:
    """Return (1) the misfit J, (2) the root of Σ |(Γ - Y π) / s|² / Σ |Γ / s|² for the π of J, (3) Σ |Γ / s|².

    Γ are the torques of `data` converted by `reading`; Y and π_0 belong to the arm `start`. s is proportional to
    `largest`, the largest rms torque [N m].
    """
    normal, slope, total = np.zeros((9, 9)), np.zeros(9), 0.0
    for one in data:
        q, dq, ddq = (reading.of_angles(part, order) for order, part in enumerate(one.parts))
        torque = reading.of_torques(one.torque(reading.delay))
        moving = np.abs(dq) > _SLOWEST * np.sqrt(np.mean(dq * dq, axis=0))
        for joint, rows in enumerate(regressor(q, dq, ddq, start.length[0], start.gravity)):
            kept = moving[:, joint]
            scale = math.sqrt(one.weight) / (_MODEL * largest * max(reading.torque))
            y, known = rows[kept] * scale, torque[kept, joint] * scale
            normal, slope, total = normal + y.T @ y, slope + y.T @ known, total + float(known @ known)
    return (*_constrained(normal, slope, max(total, 1e-12), base_of(start)[:5]), total)


def _constrained(normal: np.ndarray, slope: np.ndarray, total: float, known: np.ndarray) -> tuple[float, float]:
    """Return the first two results of `_misfit`; the minimum is over π >= 0 with the first five entries near π_0.

    Without these conditions, the normal equations are `normal` (9, 9) π = `slope` (9,). `total` is Σ |Γ / s|², and
    `known` is π_0 (5,).
    """
    floor = _LEAST * known[[0, 4, 0, 0, 4]]
    weight = 1.0 / np.maximum(_KNOWN * known, np.maximum(floor, 1e-9)) ** 2
    damped, right = normal.copy(), slope.copy()
    damped[range(5), range(5)] += weight
    right[:5] += weight * known
    size = np.sqrt(np.maximum(np.diag(damped), 1e-300))
    factor = np.linalg.cholesky(damped / np.outer(size, size) + 1e-9 * np.eye(len(size)))
    base = nnls(factor.T, np.linalg.solve(factor, right / size), maxiter=1000)[0] / size
    left = max(float(base @ normal @ base - 2.0 * slope @ base) + total, 0.0)
    beside = float(np.sum(weight * (base[:5] - known) ** 2))
    return math.sqrt(max(left + beside, 1e-18) / total), math.sqrt(left / total)
