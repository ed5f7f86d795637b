"""The extended Kalman filter of arm, load and lateness: its measurement update and its step in time."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.integrator import hold

__all__ = ["constants_at", "correct", "predict"]


@register_jitable
def constants_at(p, first, base, slopes, constants):
    """Fill the constants a = a_0 + S (p - p_0)."""
    for i in range(len(base)):
        total = base[i]
        for j in range(len(p)):
            total += slopes[i, j] * (p[j] - first[j])
        constants[i] = total


@register_jitable
def correct(z, P, measured, places, variances, gate, thresholds, cautious, column):
    """Update by what is measured, one number after the other; return the mean squared standardised innovation."""
    surprise = 0.0
    N = len(z)
    for k in range(len(measured)):
        at = places[k]
        innovation = measured[k] - z[at]
        spread = P[at, at] + variances[k]
        square = innovation * innovation
        surprise += square / spread
        spread = max(spread, square / gate)
        for i in range(N):
            column[i] = P[at, i]
        share = innovation / spread
        # Constants learn only from what the sensor's noise does not explain: a partial update after Schmidt.
        learning = max(0.0, 1.0 - thresholds[k] / (square + 1e-300))
        kept = 1.0 - (1.0 - learning) * (1.0 - learning)
        for i in range(N):
            part = learning if cautious[i] else 1.0
            z[i] += column[i] * share * part
            factor = column[i] / spread
            for j in range(N):
                P[i, j] -= factor * column[j] * (kept if cautious[i] and cautious[j] else 1.0)
    return surprise / len(measured)


@register_jitable
def predict(z, P, states, torque, torque_slope, directions, constants, slopes, steps, noise, h, substeps, work):
    """Step the estimate over one control period.

    states: 4n; torque (n,) applied by the estimate, torque_slope (n,): its slope in the lateness
    directions (4, forces): force line per unit of each force
    """
    state, held, force, arm, F, G, spread = work
    joints = states // 4
    N, parameters = len(z), len(z) - states
    forces = directions.shape[1]
    lanes = state.shape[1]
    for lane in range(lanes):
        for i in range(states):
            state[i, lane] = z[i]
        for i in range(joints):
            held[i, lane] = torque[i]
        for i in range(len(constants)):
            arm[i, lane] = constants[i]
        for i in range(force.shape[0]):
            total = 0.0
            for j in range(forces):
                total += directions[i, j] * z[states + j]
            force[i, lane] = total
    # lane 0: estimate; 1..states: a state ahead; then parameters; then motor velocities behind; lateness exact
    for j in range(states):
        state[j, 1 + j] += steps[j]
    last = 1 + N - 1
    for j in range(joints):
        at = 2 * joints + j
        wide = max(np.sqrt(P[at, at]), steps[at])
        spread[j] = wide
        state[at, 1 + at] = z[at] + wide
        state[at, last + j] = z[at] - wide
    for j in range(parameters - 1):
        lane = 1 + states + j
        if j < forces:
            for i in range(force.shape[0]):
                force[i, lane] += directions[i, j] * steps[states + j]
        else:
            for i in range(len(constants)):
                arm[i, lane] += slopes[i, j] * steps[states + j]
    # the lateness acts through the torque: use lanes at the end
    late = last + joints
    for i in range(joints):
        held[i, late] += torque_slope[i]
    hold(state, held, force, arm, h, substeps)
    for i in range(states):
        for j in range(N - 1):
            F[i, j] = (state[i, 1 + j] - state[i, 0]) / steps[j]
        for j in range(joints):
            at = 2 * joints + j
            F[i, at] = (state[i, 1 + at] - state[i, last + j]) / (2.0 * spread[j])
        F[i, N - 1] = state[i, late] - state[i, 0]
    for i in range(states):
        z[i] = state[i, 0]
        for j in range(N):
            G[i, j] = 0.0
        for k in range(N):
            f = F[i, k]
            for j in range(N):
                G[i, j] += f * P[k, j]
    for i in range(states):
        for j in range(i + 1):
            total = 0.0
            for k in range(N):
                total += G[i, k] * F[j, k]
            P[i, j] = total
            P[j, i] = total
        for j in range(states, N):
            P[i, j] = G[i, j]
            P[j, i] = G[i, j]
    for i in range(N):
        P[i, i] += noise[i]
