"""The force that explains a whole pass: a fixed-interval smoother of the arm's state and the tip force.

s = (x, f) with x of the elastic arm and the forces f = (f_t, F) beside the expected one; the constants of the arm, the
payload and the lateness are given and stay. Forward it is the filter of `filter` without gate and dead zone, in which f
walks; at the first sample the links are as fast as the motors, and stand where the filter took them to stand. Backward
(Bryson and Frazier), with λ = 0 after the last sample, at each sample for the measured numbers in reverse order

    λ ← λ - h (ν + P_yᵀ λ)/s,    f_s = f⁻ - P⁻_f λ,    λ ← Fᵀ λ for the sample before,

where h picks the measured number of s, ν is its innovation, s the variance of that, P_y the column of P by which it
corrected, and f⁻, P⁻ are what the filter had before the sample. Unlike the recursion of Rauch, Tung and Striebel this
inverts no covariance.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, Belief, Memory, layout, places
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Room, room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.law import predict_of
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings, tables_of, with_tables
from fuzzyarm.numbers.functions import Cells, array, each, select
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["Smoother"]

_TOGETHER = 16  # lanes whose notes are kept at once


class Notes(NamedTuple):
    """What the way forward leaves of a sample for the way back; N numbers of s, n joints.

    Attributes:
        innovations: ν (2 n,).
        spreads: s (2 n,).
        columns: P_y (2 n, N).
        slopes: F, the rows of x, to the next sample (4 n, numbers of z).
        forces: f⁻ (forces,).
        rows: P⁻_f (forces, N).
    """

    innovations: Any
    spreads: Any
    columns: Any
    slopes: Any
    forces: Any
    rows: Any


class Seen(NamedTuple):
    """A sample: what is measured, with its variances; expected force and travel, now and at the next one; torques."""

    measured: Any
    variances: Any
    expected: Any
    expected_next: Any
    travel: Any
    travel_next: Any
    commands: Any


class Smoother:
    """The smoother of arms with the same equations.

    Args:
        arm: the known one.
        belief: where the parts of p lie.
        settings: with the spread of s at the first sample, zero for the constants, and the walks of f.
    """

    def __init__(self, arm: AnyArm, belief: Belief, settings: Settings) -> None:
        """Keep them."""
        self._physics, self._belief, self._settings = equations_of(arm), belief, settings

    def smooth(
        self,
        measured: np.ndarray,
        commands: np.ndarray,
        expected: np.ndarray,
        travels: np.ndarray,
        memory: np.ndarray,
        variances: np.ndarray,
    ) -> np.ndarray:
        """Return f_s [N] (K, lanes, forces) of K samples.

        Args:
            measured: θ [rad] and θ̇ [rad/s], (K, lanes, 2 n).
            commands: torques commanded at each sample [N m], (K, lanes, n).
            expected: tip force [N] that f adds to, (K, lanes, axes).
            travels: directions of travel, (K, lanes, axes).
            memory: of the policy after the first sample, with the constants to keep, (lanes, memory_size).
            variances: of the measured numbers, (lanes, 2 n).
        """
        lanes = range(0, measured.shape[1], _TOGETHER)
        arrays = measured, commands, expected, travels, memory[np.newaxis], variances[np.newaxis]
        parts = [self._some(*(array[:, first : first + _TOGETHER] for array in arrays)) for first in lanes]
        return np.concatenate(parts, axis=1)

    def _some(self, *given: np.ndarray) -> np.ndarray:
        measured, commands, expected, travels, (whole,), (variances,) = given
        samples, lanes, joints = len(measured), measured.shape[1], self._physics.joints
        memory = self._begun(measured[0], whole)
        later = np.minimum(np.arange(samples) + 1, samples - 1)
        seen = np.concatenate(
            [
                measured,
                np.broadcast_to(variances, measured.shape),
                *(expected, expected[later], travels, travels[later], commands),
            ],
            axis=2,
        )
        notes = np.empty((samples, lanes, self._noted))
        tables = tables_of(self._settings)
        for k in range(samples):
            if k > 0:  # the memory has the command of the first sample
                held = memory[:, self._at.commands].reshape(lanes, -1, joints)
                held[:, 1:] = held[:, :-1].copy()
                memory[:, self._at.commands] = held.reshape(lanes, -1)
            memory[:, self._at.commands.start : self._at.commands.start + joints] = commands[k]
            self._forward((memory, np.ascontiguousarray(seen[k]), notes[k]), np.empty(0), tables)
        adjoint, forces = np.zeros((lanes, self._used)), np.empty((samples, lanes, self._forces))
        for k in range(samples - 1, -1, -1):
            self._backward((adjoint, notes[k], forces[k]), np.array([float(k < samples - 1)]))
        return forces

    @property
    def _forces(self) -> int:
        return len(self._settings.reopening)

    @property
    def _used(self) -> int:
        return 4 * self._physics.joints + self._forces

    @functools.cached_property
    def _at(self) -> Memory:
        return layout(self._physics.joints, self._belief)

    @property
    def _notes(self) -> Notes:
        joints, size = self._physics.joints, len(self._settings.spread)
        shapes = (2 * joints,), (2 * joints,), (2 * joints, self._used), (4 * joints, size)
        return Notes(*map(Cells, (*shapes, (self._forces,), (self._forces, self._used))))

    @property
    def _noted(self) -> int:
        return sum(part.size for part in self._notes)

    def _begun(self, measured: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """Return memories (lanes, numbers) before the first sample, of which `measured` (lanes, 2 n) is known."""
        at, joints, size = self._at, self._physics.joints, len(self._settings.spread)
        memory = whole[:, : at.noise.stop].copy()
        memory[:, FLAG.calm] = 0.0
        z = memory[:, at.z]
        z[:, 4 * joints : 4 * joints + self._forces] = 0.0
        z[:, :joints] = measured[:, :joints]
        z[:, 2 * joints : 3 * joints] = z[:, 3 * joints : 4 * joints] = measured[:, joints:]
        memory[:, at.P] = np.diag(self._settings.spread * self._settings.spread).reshape(size * size)
        return memory

    @functools.cached_property
    def _forward(self) -> Kernel:
        predict, settings, joints = predict_of(self._physics), self._settings, self._physics.joints

        def forward(m: Memory, seen: Seen, notes: Notes, _: Any, *tables: Any) -> tuple[Any, ...]:
            s = with_tables(settings, tables)
            room = room_for(s)
            _correct(m, seen, notes)
            _push(room, seen)
            predict(m, s, room, seen.commands)
            for i in each(4 * joints):
                for j in each(len(s.spread)):
                    notes.slopes[i, j] = room.lanes.jacobian[i, j]
            return m, seen, notes

        axes, two = (0.0,) * self._physics.axes, (0.0,) * (2 * joints)
        sample = Seen(two, two, axes, axes, axes, axes, (0.0,) * joints)
        shapes = [table.shape for table in tables_of(settings)]
        return Kernel(Program(forward, (places(joints, self._belief), sample, self._notes), (), shapes))

    @functools.cached_property
    def _backward(self) -> Kernel:
        joints, forces, used = self._physics.joints, self._forces, self._used
        states = 4 * joints

        def backward(adjoint: Any, notes: Notes, found: Any, given: Any) -> tuple[Any, ...]:
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


def _correct(m: Memory, seen: Seen, notes: Notes) -> None:
    """Note f⁻ and P⁻_f of a sample, correct s by what is measured, and note how."""
    forces, used = notes.rows.shape
    numbers = len(seen.measured)
    states, joints = used - forces, numbers // 2
    for i in each(forces):
        notes.forces[i] = m.z[states + i]
        for other in each(used):
            notes.rows[i, other] = m.P[states + i, other]
    for j in range(numbers):
        at = j if j < joints else joints + j  # θ and θ̇ in x
        innovation, spread = seen.measured[j] - m.z[at], m.P[at, at] + seen.variances[j]
        for i in each(used):
            notes.columns[j, i] = m.P[at, i]
        notes.innovations[j], notes.spreads[j] = innovation, spread
        for i in each(used):
            factor = notes.columns[j, i] / spread
            m.z[i] += factor * innovation
            for other in each(used):
                m.P[i, other] -= factor * notes.columns[j, other]


def _push(room: Room, seen: Seen) -> None:
    """Fill the force lines of the expected force, from now to later, and of a force along the direction of travel."""
    axes = len(seen.expected)
    for i in range(axes):
        now, later = seen.expected[i], seen.expected_next[i]
        room.line[i], room.line[axes + i] = 0.5 * (now + later), later - now
        room.directions[i, 0] = 0.5 * (seen.travel[i] + seen.travel_next[i])
        room.directions[axes + i, 0] = seen.travel_next[i] - seen.travel[i]
