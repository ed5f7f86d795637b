"""Repeated passes over a path: the adaptive observer predicts the load of the next pass from the last.

A pass is an episode along one reference; its state stores measurements and commands. `begin_pass` finds the tip
force that explains all measurements, given the final estimates of the arm's constants, the payload and the delay. The
force of pass j is the expected force plus f_t along the direction of travel t and a free F_s, found by `_Smoother`,

    F_j(k) = F_expected(k) + t(k) f_t(k) + F_s(k),    low-passed by a zero-phase Butterworth filter.

The next pass begins with these constants and expects the mean of F_1, ..., F_j. Forces estimated while the constants
still changed would count a load twice if it moved from a force to the payload.

The payload's share of F_1 follows from the variation of F_1, which is linear in the assumed payload m,
F_1(m) = F_1(m_0) + (m - m_0) G, and the next passes use the payload for which the force has the least total variation,

    min_{m ≥ 0} Σ_k |ΔF_1(k; m)|,    ΔF_1(k) = F_1(k+1) - F_1(k).

A force that represents a payload varies with the tip's acceleration, as does a force estimated with a wrong payload. In
later passes the force varies too little to determine the payload. A law that assumes a negative payload, which the
filter allows, loses control of a heavier arm.

A pass that leaves the previous pass's path stops using the expected force, since forces are known by sample, not by
position; payload, constants and delay keep their learned values until its end.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.fuzzy_policy.known_arm import travel_of
from fuzzyarm.fuzzy_policy.laws._iterative_learning import low_passed
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, KEPT, Memory, places, unit_force
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import MISTRUST, Scratch, command, predict, update
from fuzzyarm.fuzzy_policy.policy import NOTHING_LEARNED, PassLearner
from fuzzyarm.numbers.functions import Cells, array, each, select
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy, Beliefs

__all__ = ["AdaptivePasses", "PassState"]

_CUT_OFF = 70.0  # Hz, of the Butterworth filter of the expected force
_FIRST_FORCE = 0.3  # standard deviation of the forces at the smoother's first sample, in unit forces
_SAME_PATH = 1e-6  # rad; a reference that differs more from the previous pass's reference is another path
_REWEIGHTED = 50  # iterations towards the least total variation
_SMALLEST = 1e-2  # N; smaller changes of the force count as this one
_TOGETHER = 16  # lanes that are smoothed at a time, which limits the memory for notes


@dataclasses.dataclass
class PassState:
    """The state of `AdaptivePasses` between two samples, for one arm or several lanes."""

    memory: np.ndarray  # memory of the policy, (lanes, memory_size)
    # tip force [N] expected at the samples of this pass, (samples, lanes, axes); empty in the first pass
    expected: np.ndarray
    path: np.ndarray  # q_d of the previous pass, (samples, lanes, n)
    references: list[np.ndarray]  # q_d of each sample so far, (lanes, n) each
    measured: list[np.ndarray]  # θ [rad] and θ̇ [rad/s] of each sample so far, (lanes, 2 n) each
    commands: list[np.ndarray]  # torques commanded [N m], (lanes, n) each
    travels: list[np.ndarray]  # directions of travel, (lanes, axes) each
    early: np.ndarray  # memory of the policy after the first sample, (lanes, memory_size)
    passes: np.ndarray  # number of passes over this path that a lane has learned from, (lanes,)
    other_path: np.ndarray  # whether a lane has left the previous pass's path and no longer uses the expected force


class AdaptivePasses(PassLearner):
    """The adaptive observer on repeated passes over one path."""

    policy: AdaptiveObserverPolicy
    kind = PassState

    def __init__(self, policy: AdaptiveObserverPolicy) -> None:
        self.policy = policy
        self._axes = equations_of(policy.arm).axes
        self._constants = slice(policy.memory.z.start + 4 * policy.joints, policy.memory.z.stop)  # slice of p
        self._payload = self._constants.start + policy.belief.payload.start

    def _go_on(self, seen: np.ndarray, state: PassState) -> np.ndarray:
        parts = observed(seen)
        q, sample, other_path = parts.q_reference.copy(), len(state.references), state.other_path
        if sample < len(state.path):
            other_path = other_path | (np.abs(q - state.path[sample]).max(axis=1) > _SAME_PATH)
        torque, memory = np.empty((len(seen), self.policy.joints)), state.memory.copy()
        self.policy.act_with(seen, memory, torque, _window(state, sample, other_path))
        torque = self._clipped(seen, torque)
        state.memory, state.other_path = memory, other_path
        state.references.append(q)
        state.measured.append(np.concatenate([parts.q_motor, parts.dq_motor], axis=1))
        state.commands.append(torque.copy())
        state.travels.append(travel_of(self.policy.arm, q, parts.dq_reference))
        if sample == 0:
            state.early = memory
        return torque

    def begin_pass(self, state: PassState) -> PassState:
        """Return the state with which the next pass begins, see `PassLearner`.

        It keeps the filter's estimates of the arm's constants, delay and payload, and the expected force at each
        sample. Everything else is reset. Lanes with a diverged filter or off the previous pass's path keep nothing.
        """
        state = self._checked(state)
        if not state.references:
            raise ValueError(NOTHING_LEARNED)
        usable = (state.memory[:, FLAG.lost] == 0.0) & ~state.other_path
        memory, kept = np.zeros_like(state.memory), self.policy.memory
        memory[:, kept.z], memory[:, kept.P] = state.memory[:, kept.z], self._bounded(state.memory[:, kept.P])
        expected = np.zeros((len(state.references), len(memory), self._axes))
        if usable.any():
            expected[:, usable], memory[usable, self._payload] = self._explained(state, usable)
        usable &= np.isfinite(expected).all(axis=(0, 2)) & np.isfinite(memory[:, self._payload])
        memory[usable, FLAG.taught] = 1.0
        memory[~usable], expected[:, ~usable] = 0.0, 0.0
        passes, path = np.where(usable, state.passes + 1, 0), np.array(state.references)
        return dataclasses.replace(self._first(memory), expected=expected, path=path, passes=passes)

    def beliefs(self, state: PassState) -> Beliefs:
        """Return each lane's `Beliefs` after the last sample; their force is the expected plus the estimated force."""
        state = self._checked(state)
        found, expected = self.policy.beliefs(state.memory), _window(state, len(state.references) - 1, state.other_path)
        return dataclasses.replace(found, force=found.force + expected[:, 0], other_path=state.other_path.copy())

    def _first(self, memory: np.ndarray) -> PassState:
        lanes = len(memory)
        expected, path = np.empty((0, lanes, self._axes)), np.empty((0, lanes, self.policy.joints))
        none = np.zeros(lanes, dtype=int)
        return PassState(memory, expected, path, [], [], [], [], early=memory, passes=none, other_path=none != 0)

    def _bounded(self, covariance: np.ndarray) -> np.ndarray:
        """Return covariances (lanes, N²), scaled so that no standard deviation exceeds its initial value."""
        first = self.policy.settings.spread
        P = covariance.reshape(len(covariance), len(first), len(first))
        deviation = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 1e-300))
        factor = np.minimum(1.0, first / deviation)
        return np.asarray(P * factor[:, :, np.newaxis] * factor[:, np.newaxis, :]).reshape(len(P), -1)

    def _explained(self, state: PassState, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the expected force (samples, lanes, axes) [N] and payload (lanes,) [kg] for these lanes' next pass."""
        memory, before = state.memory[lanes], state.passes[lanes]
        smoother, payload = _Smoother(self.policy), memory[:, self._payload].copy()
        force = smoother.force(state, lanes, memory)
        new = before == 0
        if new.any():
            heavier, where = memory[new], lanes.copy()
            heavier[:, self._payload] += 1.0
            where[lanes] = new
            slope = smoother.force(state, where, heavier) - force[:, new]
            most = self.policy.settings.high[self.policy.belief.payload.start]
            payload[new] = np.clip(payload[new] + _steadiest(force[:, new], slope), 0.0, most)
            force[:, new] += (payload - memory[:, self._payload])[new, np.newaxis] * slope
        expected = _of_length(len(force), state.expected[:, lanes])
        return expected + (force - expected) / (1 + before[:, np.newaxis]), payload


def _steadiest(force: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return x (lanes,) minimising the total variation of ``force + x slope`` (samples, lanes, axes) (Weiszfeld)."""
    a, b, x = np.diff(force, axis=0), np.diff(slope, axis=0), np.zeros(force.shape[1])
    for _ in range(_REWEIGHTED):
        weight = 1.0 / np.maximum(np.linalg.norm(a + x[:, np.newaxis] * b, axis=2), _SMALLEST)
        x = -np.sum(weight * np.sum(a * b, axis=2), axis=0) / (np.sum(weight * np.sum(b * b, axis=2), axis=0) + 1e-12)
    return x


def _of_length(samples: int, force: np.ndarray) -> np.ndarray:
    """Return `force` (any length, lanes, axes), cut or padded with zeros to the length `samples`."""
    whole = np.zeros((samples, *force.shape[1:]))
    whole[: len(force)] = force[:samples]
    return whole


def _lines(force: np.ndarray) -> np.ndarray:
    later = np.concatenate([force[1:], force[-1:]])
    return np.concatenate([0.5 * (force + later), later - force], axis=2)


def _window(state: PassState, sample: int, other_path: np.ndarray) -> np.ndarray:
    """Return the expected force [N] (lanes, `KEPT` + 1, axes): at `sample` and the samples before it, then at the next.

    It is 0 in lanes of `other_path` (lanes,).
    """
    window = np.zeros((len(state.memory), KEPT + 1, state.expected.shape[2]))
    last = len(state.expected) - 1
    if last >= 0:
        for place, k in enumerate((*range(sample, sample - KEPT, -1), sample + 1)):
            window[:, place] = state.expected[min(max(k, 0), last)] * ~other_path[:, np.newaxis]
    return window


class _Notes(NamedTuple):
    """Data that the smoother's forward pass stores per sample; n joints, N entries of z, which begins with (x, f)."""

    innovations: Any  # ν (2 n,)
    spreads: Any  # s (2 n,)
    columns: Any  # P_y (2 n, N)
    slopes: Any  # F, only the rows of x, to the next sample (4 n, N)
    forces: Any  # f⁻ (forces,)
    rows: Any  # P⁻_f (forces, size of (x, f))


class _Seen(NamedTuple):
    """A sample for the smoother: measurements, their variances, lines of two forces, and commands [N m].

    A line is the mean of a force until the next sample, then the change of this force.
    """

    measured: Any  # θ and θ̇ (2 n,)
    variances: Any  # (2 n,)
    expected: Any  # line of the expected force (2 axes,)
    travel: Any  # line of a unit force along the direction of travel (2 axes,)
    commands: Any  # (n,)


class _Smoother:
    """The force that explains a whole pass: a fixed-interval smoother of the arm's state and the tip force.

    Its state is (x, f), with the elastic arm's x and the forces f = (f_t, F) added to the expected force; the arm's
    constants, the payload and the delay are given and fixed. The forward pass is the filter of `filter` without gate
    and dead zone, with f as a random walk; at the first sample the links have the motors' velocities and the filter's
    angles. The backward pass (Bryson and Frazier) begins with λ = 0 after the last sample. At each sample, for the
    measured quantities in reverse order, it sets

        λ ← λ - h (ν + P_yᵀ λ)/s,    f_s = f⁻ - P⁻_f λ,    λ ← Φᵀ λ for the sample before,

    where h selects the quantity in (x, f), ν is its innovation with variance s, P_y its column of P, f⁻ and P⁻ are the
    filter's values before the sample, and Φ is F of `filter` for (x, f).
    """

    def __init__(self, policy: AdaptiveObserverPolicy) -> None:
        """Prepare a filter with known constants of the policy's arm, in which torque jumps increase no variance."""
        self._policy, self._physics, settings = policy, equations_of(policy.arm), policy.settings
        n, N, self._forces = self._physics.joints, len(settings.spread), len(settings.reopening)
        self._used, spread = 4 * n + self._forces, np.zeros(N)
        spread[: 4 * n], spread[4 * n : self._used] = settings.spread[: 4 * n], _FIRST_FORCE * unit_force(policy.arm)
        sure, bold = np.zeros(n), np.zeros(N)
        self._settings = settings.replaced(spread=spread, doubt=sure, cautious=bold, gate=math.inf)
        two, line, notes = (2 * n,), (2 * self._physics.axes,), ((2 * n, N), (4 * n, N), (self._forces,))
        self._notes = _Notes(*map(Cells, (two, two, *notes, (self._forces, self._used))))
        self._seen = _Seen(*map(Cells, (two, two, line, line, (n,))))
        self._forward, self._backward = self._forward_kernel(), self._backward_kernel()

    def force(self, state: PassState, lanes: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Return the low-passed tip force [N] (samples, lanes, axes) that explains the measurements of some lanes.

        Constants, payload and delay come from a memory (lanes, memory_size); `lanes` selects the lanes of the state.
        """
        chosen = np.flatnonzero(lanes)
        groups = [slice(first, first + _TOGETHER) for first in range(0, len(chosen), _TOGETHER)]
        force = np.concatenate([self._of_some(state, chosen[some], memory[some]) for some in groups], axis=1)
        return low_passed(force, _CUT_OFF, self._policy.control_period)

    def _of_some(self, state: PassState, lanes: np.ndarray, known: np.ndarray) -> np.ndarray:
        samples, parts = len(state.measured), (state.measured, state.commands, state.travels)
        measured, commands, travels = (np.array([sample[lanes] for sample in part]) for part in parts)
        expected, (least, ratio) = _of_length(samples, state.expected[:, lanes]), np.split(self._settings.variances, 2)
        angles = np.maximum(least, MISTRUST * known[:, self._policy.memory.noise])
        variances = np.broadcast_to(np.concatenate([angles, angles * (ratio / least)], axis=1), measured.shape)
        seen = np.concatenate([measured, variances, _lines(expected), _lines(travels), commands], axis=2)
        memory, tables = self._begun(measured[0], state.early[lanes], known), self._settings.tables
        notes = np.empty((samples, len(lanes), sum(part.size for part in self._notes)))
        for k in range(samples):
            self._forward((memory, np.ascontiguousarray(seen[k]), notes[k]), np.empty(0), tables)
        adjoint, found = np.zeros((len(lanes), self._used)), np.empty((samples, len(lanes), self._forces))
        for k in range(samples - 1, -1, -1):
            self._backward((adjoint, notes[k], found[k]), np.array([float(k < samples - 1)]))
        return np.asarray(expected + travels * found[..., :1] + found[..., 1:])

    def _begun(self, measured: np.ndarray, early: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return the filter's memories (lanes, size) before the first sample, with forces of 0.

        `measured` (lanes, 2 n) is the first sample, `early` the policy's memories just after it. Constants, payload and
        delay are copied from the policy's memories `known`.
        """
        at, n, spread = self._policy.memory, self._physics.joints, self._settings.spread
        memory = early[:, : at.noise.stop].copy()
        memory[:, FLAG.calm], z = 0.0, memory[:, at.z]
        z[:, self._used :], z[:, 4 * n : self._used] = known[:, at.z][:, self._used :], 0.0
        z[:, :n], z[:, 2 * n : 3 * n], z[:, 3 * n : 4 * n] = measured[:, :n], measured[:, n:], measured[:, n:]
        memory[:, at.P] = np.diag(spread * spread).ravel()
        first, before = (slice(at.commands.start + k * n, at.commands.start + (1 + k) * n) for k in range(2))
        memory[:, first] = memory[:, before]  # the command of the first sample is still to come
        return memory

    def _forward_kernel(self) -> Kernel:
        physics, settings, used = self._physics, self._settings, self._used

        def forward(m: Memory, seen: _Seen, notes: _Notes, _: Any, *tables: Any) -> tuple[Any, ...]:
            s = settings.with_tables(tables)
            room, states = Scratch(physics, s), 4 * physics.joints
            room.measured, room.variances, room.line = seen.measured, seen.variances, seen.expected
            room.innovation, room.expected, room.columns, room.F = notes[:4]
            for i in each(2 * physics.axes):
                room.directions[i, 0] = seen.travel[i]
            for i in each(self._forces):
                notes.forces[i] = m.z[states + i]
                for other in each(used):
                    notes.rows[i, other] = m.P[states + i, other]
            update(m, s, room)
            command(m, s, seen.commands)
            predict(m, s, room, seen.commands)
            return m, seen, notes

        shapes = [table.shape for table in settings.tables]
        return Kernel(Program(forward, (places(physics), self._seen, self._notes), (), shapes))

    def _backward_kernel(self) -> Kernel:
        joints, forces, used = self._physics.joints, self._forces, self._used
        states = 4 * joints

        def backward(adjoint: Any, notes: _Notes, found: Any, given: Any) -> tuple[Any, ...]:
            before = array(used)
            for i in each(used):
                before[i] = adjoint[i]
            for i in each(states):
                before[i] = 0.0
            for i in each(used):
                for other in each(states):
                    before[i] += notes.slopes[other, i] * adjoint[other]
            for i in each(used):
                adjoint[i] = select(given[0] > 0.0, before[i], adjoint[i])
            for half in (1, 0):
                for joint in range(joints - 1, -1, -1):
                    j, at = half * joints + joint, 2 * half * joints + joint  # θ and θ̇ in x
                    before[0] = notes.innovations[j]
                    for i in each(used):
                        before[0] += notes.columns[j, i] * adjoint[i]
                    adjoint[at] -= before[0] / notes.spreads[j]
            for i in each(forces):
                before[0] = notes.forces[i]
                for other in each(used):
                    before[0] -= notes.rows[i, other] * adjoint[other]
                found[i] = before[0]
            return adjoint, notes, found

        return Kernel(Program(backward, (Cells((used,)), self._notes, Cells((forces,))), (0.0,)))
