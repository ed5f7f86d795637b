"""Short windows of logs, and their simulation from given initial states under the logged torques.

Without feedback, the simulation of an arm held against gravity diverges from its log within a second. The plants are:

    rigid     (M_b(q) + I_a) q̈ + C(q, q̇) q̇ + g(q) = Γ - f_v q̇ - F(q̇) q̇ / √(q̇² + v_0²),    by Runge-Kutta steps
    elastic   motors and links, with exact sticking, as in the environment

M_b, C and g belong to the links; I_a are rotor inertias, Γ torques, and f_v and F viscous and dry friction. v_0
makes the rigid arm's friction smooth, because derivatives are needed.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Arm, arm_constants, motors, rigid_inverse_dynamics
from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.integrator import force_line, hold_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, filled, places, record_type, size
from fuzzyarm.identification._rigid import constants_of
from fuzzyarm.identification.log import Log
from fuzzyarm.numbers.functions import repeat, zeros
from fuzzyarm.numbers.machine import Kernel, PortLayout
from fuzzyarm.numbers.program import Program

__all__ = ["EDGE", "ELASTIC", "RIGID", "Simulator", "Windows", "rms", "rms_errors", "simulated", "windows_of"]

_CUTOFF = 20.0  # Hz, of the filter for the initial states of windows
_HIGHEST = 0.4  # largest cut-off frequency, as a share of half the sampling rate
EDGE = 0.15  # s, at both ends of a log, in which the filter has not settled
_STILL = 0.02  # rad: windows in which no joint moves further than this are left out
_SMOOTH = 0.02  # v_0 [rad/s]
_LARGEST_STEP = 1e-3  # s, for the rigid arm
_LOST = 1e3  # rad, the angle assigned to a simulation that has diverged
_WORST = 10.0  # rad, upper limit of an rms error or motion


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """S windows (short intervals) of one log, all of the same length."""

    log: int  # number of the log
    period: float  # between two samples [s]
    first: np.ndarray  # index of each window's first sample, (S,)
    q: np.ndarray  # filtered angles, velocities and accelerations at the beginnings [rad, rad/s, rad/s²], (S, 2)
    dq: np.ndarray
    ddq: np.ndarray
    torque: np.ndarray  # held from a sample to the next [N m], (steps, 2, S)
    taken: np.ndarray  # indices of the samples that are compared, counted from the window's first, (K,)
    measured: np.ndarray  # angles at the samples `taken` [rad], (K, 2, S)

    def __len__(self) -> int:
        return len(self.first)

    def chosen(self, which: np.ndarray) -> Windows:
        """Return some of the windows, chosen by indices or by a mask (S,)."""
        ends = {name: getattr(self, name)[which] for name in ("first", "q", "dq", "ddq")}
        return dataclasses.replace(self, **ends, torque=self.torque[..., which], measured=self.measured[..., which])


def windows_of(log: Log, number: int, length: float, every: float, points: int, most: int = 10**9) -> Windows:
    """Return the windows of a log of a two-joint arm in which the arm moves; `number` identifies the log.

    `length` is that of a window [s], and `every` the time between the beginnings of two windows [s]. `points` is K, the
    number of samples of a window that are compared. Of more than `most` windows, evenly spaced ones are chosen.
    """
    rate = 1.0 / log.period
    cutoff = butter(4, min(_CUTOFF, 0.5 * _HIGHEST * rate), fs=rate, output="sos")
    q = sosfiltfilt(cutoff, log.angle, axis=0)
    dq = np.gradient(q, log.period, axis=0)
    ddq = np.gradient(dq, log.period, axis=0)
    steps, edge = max(round(length * rate), 4), round(EDGE * rate)
    first = np.arange(edge, len(q) - steps - edge, max(round(every * rate), 1))
    rows = first + np.arange(steps + 1)[:, np.newaxis]
    if len(first):
        first = first[np.ptp(log.angle[rows], axis=0).max(axis=1) > _STILL]
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(int)]
    taken = np.unique(np.linspace(0, steps, min(points, steps + 1)).round().astype(int))
    rows = first + np.arange(steps)[:, np.newaxis]
    torque, measured = (
        np.ascontiguousarray(part.transpose(0, 2, 1))
        for part in (log.torque[rows], log.angle[first + taken[:, np.newaxis]])
    )
    return Windows(number, log.period, first, q[first], dq[first], ddq[first], torque, taken, measured)


class Simulator(NamedTuple):
    """A model of the plant, with which windows of logs are simulated."""

    states: Callable[[Windows, np.ndarray, ArmParameters], np.ndarray]  # filtered initial states (n, S) for θ (17,)
    hold: Callable[[], Callable[..., None]]  # returns the function that advances lanes by one period
    substeps: Callable[[float, ArmParameters], int]  # number of sub-steps of a period [s]
    known: np.ndarray  # standard deviation of each filtered initial state [rad, rad/s], (n,)
    turn: np.ndarray  # steps of the states in finite differences, (n,)


_RigidState: Any = record_type("RigidState", angle=PerJoint, rate=PerJoint)


@functools.cache
def _rigid_hold() -> Callable[..., None]:
    physics = two_joints()

    def slope(state: Any, torque: Any, arm: Any) -> Any:
        rate = state.rate
        (m11, m12), (_, m22) = physics.mass_matrix(state.angle, arm)
        links = physics.inverse_dynamics(state.angle, rate, PerJoint(0.0, 0.0), arm)
        smooth = (v / root(v * v + _SMOOTH * _SMOOTH) for v in rate)
        dry = (stribeck_magnitude(v, own.dry_friction) for v, own in zip(rate, motors(arm, rate), strict=True))
        first, second = (
            given - load - viscous * v - size_ * sign
            for given, load, viscous, v, size_, sign in zip(
                torque, links, (arm.viscous1, arm.viscous2), rate, dry, smooth, strict=True
            )
        )
        m11, m22 = m11 + arm.motor_inertia1, m22 + arm.motor_inertia2
        inverse = 1.0 / (m11 * m22 - m12 * m12)
        rise = PerJoint((m22 * first - m12 * second) * inverse, (m11 * second - m12 * first) * inverse)
        return _RigidState(rate, rise)

    def along(state: Any, slope: Any, h: Any) -> Any:
        parts = zip(state, slope, strict=True)
        return _RigidState(*(PerJoint(a.joint1 + h * b.joint1, a.joint2 + h * b.joint2) for a, b in parts))

    def step(state: Any, torque: Any, arm: Any, given: Any) -> tuple[Any, ...]:
        h, substeps = given

        def sub_step(now: Any) -> Any:
            k1 = slope(now, torque, arm)
            k2 = slope(along(now, k1, 0.5 * h), torque, arm)
            k3 = slope(along(now, k2, 0.5 * h), torque, arm)
            k4 = slope(along(now, k3, h), torque, arm)
            for k, weight in ((k1, 1 / 6), (k2, 1 / 3), (k3, 1 / 3), (k4, 1 / 6)):
                now = along(now, k, weight * h)
            return now

        return repeat(substeps, sub_step, state), torque, arm

    kinds = _RigidState, PerJoint, Arm
    kernel = Kernel(Program(step, [zeros(places(kind)) for kind in kinds], (0.0, 0.0)), [PortLayout.COLUMNS] * 3)
    return lambda state, torque, arm, *given: kernel((state, torque, arm), np.array(given, dtype=np.float64))


def _rigid_substeps(period: float, arm: ArmParameters) -> int:
    """Return the number of equal sub-steps into which a period [s] is divided, so that each lasts at most 1 ms.

    There are more sub-steps, up to 100, if a simulation of the smooth friction at rest would otherwise be unstable.
    """
    M = np.array([two_joints().mass_matrix(PerJoint(0.0, q2), arm_constants(arm)) for q2 in (0.0, 0.5 * math.pi)])
    turning = np.linalg.inv(M + np.diag(arm.motor_inertia))
    slope = np.array(arm.static_friction) / _SMOOTH + np.array(arm.viscous_friction)
    rate = float(np.max(np.abs(np.linalg.eigvals(turning * slope))))
    return max(math.ceil(period / _LARGEST_STEP - 1e-9), min(math.ceil(period * rate), 100))


def _rigid_states(windows: Windows, theta: np.ndarray, arm: ArmParameters) -> np.ndarray:
    return np.concatenate([windows.q.T, windows.dq.T])


@functools.cache
def _elastic_hold() -> Callable[..., None]:
    hold, forces = hold_of(two_joints()), size(force_line(two_joints().axes))
    return lambda state, torque, arm, *given: hold(state, torque, np.zeros((forces, state.shape[1])), arm, *given)


def _elastic_states(windows: Windows, theta: np.ndarray, arm: ArmParameters) -> np.ndarray:
    """Return the initial states (8, S) of S windows for θ (17,); each spring is bent by the torque that moves its link.

    The rows are motor and link angles [rad], then their equal velocities [rad/s].
    """
    constants = filled(Arm, constants_of(theta[:, np.newaxis], arm)[:, 0])
    load = rigid_inverse_dynamics(windows.q, windows.dq, windows.ddq, constants)
    link = windows.q - load / np.array([constants.stiffness1, constants.stiffness2])
    return np.concatenate([windows.q.T, link.T, windows.dq.T, windows.dq.T])


RIGID = Simulator(
    _rigid_states, _rigid_hold, _rigid_substeps, np.array([2e-3, 2e-3, 0.1, 0.1]), np.array([1e-5, 1e-5, 1e-4, 1e-4])
)
ELASTIC = Simulator(
    _elastic_states,
    _elastic_hold,
    lambda period, arm: default_substeps(period, fastest_rate([arm])),
    np.array([1e-3] * 2 + [3e-3] * 2 + [0.1] * 4),
    np.array([1e-5] * 4 + [1e-4] * 4),
)


def simulated(
    simulator: Simulator, windows: Windows, theta: np.ndarray, states: np.ndarray, arm: ArmParameters
) -> np.ndarray:
    """Return the angles [rad] of the motors at the samples that are compared, (K, 2, lanes).

    Args:
        simulator: the plant that is simulated.
        windows: S windows; the number of lanes is a multiple of S, and lane k simulates window k modulo S.
        theta: θ of the lanes, (17, lanes), see `_rigid`.
        states: initial states, (n, lanes).
        arm: the arm with the parameters that θ does not contain.
    """
    hold, count = simulator.hold(), simulator.substeps(windows.period, arm)
    lanes, constants = np.array(states, order="C"), np.ascontiguousarray(constants_of(theta, arm))
    torque = np.ascontiguousarray(np.tile(windows.torque, (1, 1, states.shape[1] // len(windows))))
    found, place = np.empty((len(windows.taken), 2, states.shape[1])), 0
    for k in range(len(torque) + 1):
        if windows.taken[place] == k:
            found[place] = lanes[:2]
            place += 1
        if k < len(torque):
            hold(lanes, torque[k], constants, windows.period / count, count)
    return np.clip(np.nan_to_num(found, nan=_LOST, posinf=_LOST, neginf=-_LOST), -_LOST, _LOST)


def rms_errors(
    simulator: Simulator, windows: Sequence[Windows], theta: np.ndarray, arm: ArmParameters
) -> list[np.ndarray]:
    """Return the rms errors (S, 2) [rad] of angles simulated with θ (17,), for each `Windows` object of S windows."""
    found = []
    for one in windows:
        lanes = np.repeat(theta[:, np.newaxis], len(one), axis=1)
        angles = simulated(simulator, one, lanes, simulator.states(one, theta, arm), arm)
        found.append(rms(angles - one.measured))
    return found


def rms(angles: np.ndarray) -> np.ndarray:
    """Return the rms (S, 2) [rad] of differences of angles (K samples, 2 joints, S windows), limited to `_WORST`."""
    return np.asarray(np.minimum(np.sqrt(np.mean(angles**2, axis=0)), _WORST).T)
