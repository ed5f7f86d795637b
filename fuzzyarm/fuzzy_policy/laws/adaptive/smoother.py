"""The force that explains a whole pass: a fixed-interval smoother of the arm's state and the tip force, compiled.

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
from numba.extending import register_jitable

from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.fuzzy_policy.laws.adaptive.law import predict_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room, room_for

__all__ = ["smoother_of"]


class Notes(NamedTuple):
    """What the way forward leaves for the way back, of K samples; N numbers of s, n joints.

    Attributes:
        innovations: ν (K, 2 n).
        spreads: s (K, 2 n).
        columns: P_y (K, 2 n, N).
        slopes: F, the rows of x, from each sample to the next (K, 4 n, numbers of z).
        forces: f⁻ (K, forces).
        rows: P⁻_f (K, forces, N).
    """

    innovations: Any
    spreads: Any
    columns: Any
    slopes: Any
    forces: Any
    rows: Any


@functools.cache
def smoother_of(physics: Physics) -> Any:
    """Return the kernel ``smooth(measured, commands, expected, travels, memory, variances, settings, forces)``.

    It fills `forces` (K, lanes, forces) with f_s [N] of K samples of arms with these equations. Its arguments:
        measured: θ [rad] and θ̇ [rad/s], (K, lanes, 2 n).
        commands: torques commanded at each sample [N m], (K, lanes, n).
        expected: tip force [N] that f adds to, (K, lanes, axes).
        travels: directions of travel, (K, lanes, axes).
        memory: of the policy after the first sample, with the constants to keep, (lanes, memory_size); it is changed.
        variances: of the measured numbers, (lanes, 2 n).
        settings: with the spread of s at the first sample, zero for the constants, and the walks of f.
    """
    predict = predict_of(physics)

    @kernel_for(physics.digest)
    def smooth(
        measured: np.ndarray,
        commands: np.ndarray,
        expected: np.ndarray,
        travels: np.ndarray,
        memory: np.ndarray,
        variances: np.ndarray,
        settings: Any,
        forces: np.ndarray,
    ) -> None:
        """See `smoother_of`."""
        s, samples, joints, count = settings, len(measured), commands.shape[2], forces.shape[2]
        room, notes = room_for(s), _notes_for(samples, joints, count, len(s.spread))
        for lane in range(measured.shape[1]):
            m = remembered(memory[lane], joints, len(s.guess), count)
            m.flags[FLAG.calm] = 0.0
            for i in range(count):
                m.z[4 * joints + i] = 0.0
            for i in range(len(s.spread)):
                for k in range(len(s.spread)):
                    m.P[i, k] = 0.0
                m.P[i, i] = s.spread[i] * s.spread[i]
            for j in range(joints):
                m.z[j] = measured[0, lane, j]
                m.z[2 * joints + j] = m.z[3 * joints + j] = measured[0, lane, joints + j]
            for k in range(samples):
                _correct(m, measured[k, lane], variances[lane], notes, k)
                for j in range(joints):
                    for back in range(len(m.commands) - 1, 0, -1):
                        if k > 0:  # the memory has that of the first sample
                            m.commands[back, j] = m.commands[back - 1, j]
                    m.commands[0, j] = commands[k, lane, j]
                later = min(k + 1, samples - 1)
                _push(room, expected[k, lane], expected[later, lane], travels[k, lane], travels[later, lane])
                predict(m, s, room, commands[k, lane])
                for i in range(4 * joints):
                    for j in range(len(s.spread)):
                        notes.slopes[k, i, j] = room.lanes.jacobian[i, j]
            _look_back(notes, forces[:, lane])

    return smooth


@register_jitable
def _notes_for(samples: int, joints: int, forces: int, size: int) -> Notes:
    used = 4 * joints + forces
    return Notes(
        np.empty((samples, 2 * joints)),
        np.empty((samples, 2 * joints)),
        np.empty((samples, 2 * joints, used)),
        np.empty((samples, 4 * joints, size)),
        np.empty((samples, forces)),
        np.empty((samples, forces, used)),
    )


@register_jitable
def _correct(m: Memory, measured: np.ndarray, variances: np.ndarray, notes: Notes, k: int) -> None:
    """Note f⁻ and P⁻_f of sample k, correct s by what is measured, and note how."""
    used, forces, numbers = notes.columns.shape[2], notes.forces.shape[1], len(measured)
    states, joints = used - forces, numbers // 2
    for i in range(forces):
        notes.forces[k, i] = m.z[states + i]
        for other in range(used):
            notes.rows[k, i, other] = m.P[states + i, other]
    for j in range(numbers):
        at = j if j < joints else joints + j  # θ and θ̇ in x
        column, innovation, spread = notes.columns[k, j], measured[j] - m.z[at], m.P[at, at] + variances[j]
        for i in range(used):
            column[i] = m.P[at, i]
        notes.innovations[k, j], notes.spreads[k, j] = innovation, spread
        for i in range(used):
            factor = column[i] / spread
            m.z[i] += factor * innovation
            for other in range(used):
                m.P[i, other] -= factor * column[other]


@register_jitable
def _push(room: Room, now: np.ndarray, later: np.ndarray, travel: np.ndarray, next_travel: np.ndarray) -> None:
    """Fill the force lines of the expected force, from now to later, and of a force along the direction of travel."""
    axes = len(now)
    for i in range(axes):
        room.line[i], room.line[axes + i] = 0.5 * (now[i] + later[i]), later[i] - now[i]
        room.directions[i, 0] = 0.5 * (travel[i] + next_travel[i])
        room.directions[axes + i, 0] = next_travel[i] - travel[i]


@register_jitable
def _look_back(notes: Notes, forces: np.ndarray) -> None:
    """Fill f_s (K, forces) of one lane."""
    samples, states, used = len(forces), notes.slopes.shape[1], notes.columns.shape[2]
    numbers = notes.innovations.shape[1]
    joints = numbers // 2
    adjoint, before = np.zeros(used), np.empty(used)
    for k in range(samples - 1, -1, -1):
        if k < samples - 1:
            for i in range(used):
                before[i] = adjoint[i] if i >= states else 0.0
                for other in range(states):
                    before[i] += notes.slopes[k, other, i] * adjoint[other]
            for i in range(used):
                adjoint[i] = before[i]
        for j in range(numbers - 1, -1, -1):
            at = j if j < joints else joints + j
            total = notes.innovations[k, j]
            for i in range(used):
                total += notes.columns[k, j, i] * adjoint[i]
            adjoint[at] -= total / notes.spreads[k, j]
        for i in range(forces.shape[1]):
            total = notes.forces[k, i]
            for other in range(used):
                total -= notes.rows[k, i, other] * adjoint[other]
            forces[k, i] = total
