"""The adaptive observer."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.integrator import hold
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import FORCE_ROWS, joint_parts, link_torque, tip_direction
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import (
    BELIEF, BELIEFS, SPACE, affine_constants, allowed, first_guess, first_spread,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import constants_at, correct, predict
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import PAYLOADS, feedback_table
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights, unit_force
from fuzzyarm.fuzzy_policy.policy import Policy

STATES = 4 * JOINTS
N = STATES + BELIEFS
LONGEST = 4
PAST = 5
_STARTED, _SURPRISE, _Z, _P, _COMMANDS, _REFERENCES, _READ, _ROUGH = consecutive(1, 1, N, N * N, (LONGEST + 1) * JOINTS, PAST * 3 * JOINTS, 3 * JOINTS, JOINTS)
STATICS_STEPS = 20


class AdaptiveObserverPolicy(Policy):
    memory_size = _ROUGH.stop

    def __init__(self, parameters=None, control_period=1e-3, weights=None):
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        w = self.weights = weights or AdaptiveWeights()
        self.feedback = feedback_table(self.parameters, control_period, w)
        self._substeps = whole_substeps(control_period, None)
        self._know(self.parameters)

    def _know(self, parameters):
        w, T = self.weights, self.control_period
        base, slopes = affine_constants(parameters)
        limit = self._torque_limit
        inertia = np.array(parameters.motor_inertia)
        noise = np.zeros(N)
        noise[2 * JOINTS: 3 * JOINTS] = (w.motor_torque * limit / inertia) ** 2 * T
        noise[STATES + BELIEF.travel_force.start] = (w.travel_walk * unit_force(parameters)) ** 2 * T
        for k in range(BELIEF.force.start, BELIEF.force.stop):
            noise[STATES + k] = (w.force_walk * unit_force(parameters)) ** 2 * T
        steps = np.empty(N)
        steps[:2 * JOINTS] = 1e-7
        steps[2 * JOINTS:STATES] = 1e-6
        steps[STATES:] = 1e-4
        steps[STATES:STATES + BELIEF.payload.stop] = 1e-2
        variances = np.repeat([w.encoder_angle**2, w.encoder_velocity**2], JOINTS)
        places = np.r_[0:JOINTS, 2 * JOINTS:3 * JOINTS]
        spread = np.concatenate([
            np.full(JOINTS, w.encoder_angle), np.full(JOINTS, w.first_link_angle),
            np.full(JOINTS, w.encoder_velocity), np.full(JOINTS, w.encoder_velocity), first_spread(parameters, w)])
        cautious = np.zeros(N, dtype=np.bool_)
        cautious[STATES + BELIEF.stiffness.start:] = True
        low, high = allowed(parameters, LONGEST - 1)
        self._arguments = (self.feedback, base, slopes, noise, steps, variances, places, spread, first_guess(), low, high,
                           w.gate, w.floor, cautious, limit, self.control_period / self._substeps, self._substeps, sum(parameters.mass))

    def act(self, observation, memory, torque):
        _act(observation, memory, torque, *self._arguments)


@kernel
def _act(observation, memory, torque, feedback, base, slopes, noise, steps, variances, places, spread, first, low, high,
         gate, floor, cautious, limit, h, substeps, mass):
    o = observed(observation)
    T = h * substeps
    lanes = N + JOINTS + 1
    work = (np.empty((STATES, lanes)), np.empty((JOINTS, lanes)), np.empty((FORCE_ROWS, lanes)), np.empty((len(base), lanes)),
            np.empty((STATES, N)), np.empty((STATES, N)), np.empty(JOINTS))
    thresholds = np.empty(2 * JOINTS)
    memory_rate = 0.03
    column, constants, measured = np.empty(N), np.empty(len(base)), np.empty(2 * JOINTS)
    directions = np.zeros((FORCE_ROWS, 1 + SPACE))
    for i in range(SPACE):
        directions[i, 1 + i] = 1.0
    one = (np.empty((STATES, 1)), np.empty((JOINTS, 1)), np.empty((FORCE_ROWS, 1)), np.empty((len(base), 1)))
    tau = np.empty((PAST, JOINTS))
    dirs = np.empty((PAST, SPACE))
    force = np.empty(SPACE)
    ahead_q, ahead_dq, ahead_dir = np.empty(JOINTS), np.empty(JOINTS), np.empty(SPACE)
    applied, slope = np.empty(JOINTS), np.empty(JOINTS)
    error = np.empty(STATES)
    for lane in range(len(observation)):
        m = memory[lane]
        z, P = m[_Z], m[_P].reshape(N, N)
        commands = m[_COMMANDS].reshape(LONGEST + 1, JOINTS)
        past = m[_REFERENCES].reshape(PAST, 3, JOINTS)
        p = z[STATES:]
        begins = m[0] == 0.0
        if begins:
            _begin(o.q_motor[lane], o.dq_motor[lane], z, P, spread, first, base)
        for j in range(JOINTS):
            measured[j], measured[JOINTS + j] = o.q_motor[lane, j], o.dq_motor[lane, j]
        read, rough = m[_READ].reshape(3, JOINTS), m[_ROUGH]
        for j in range(JOINTS):
            if begins:
                rough[j] = 4.0 * variances[j]
                for k in range(3):
                    read[k, j] = measured[j]
            change = measured[j] - 3.0 * read[0, j] + 3.0 * read[1, j] - read[2, j]
            rough[j] += memory_rate * (change * change / 20.0 - rough[j])
            read[2, j], read[1, j], read[0, j] = read[1, j], read[0, j], measured[j]
            thresholds[j] = floor * rough[j]
            thresholds[JOINTS + j] = floor * rough[j] * variances[JOINTS + j] / variances[j]
        m[1] = correct(z, P, measured, places, variances, gate, thresholds, cautious, column)
        for j in range(len(p)):
            at = STATES + j
            move = min(max(p[j], low[j]), high[j]) - p[j]
            if move != 0.0:
                if P[at, at] > 0.0:
                    share = move / P[at, at]
                    for i in range(N):
                        z[i] += P[i, at] * share
                p[j] = min(max(p[j], low[j]), high[j])
        constants_at(p, first, base, slopes, constants)
        # references
        for k in range(PAST - 1, 0, -1):
            past[k] = past[k - 1]
        past[0, 0], past[0, 1], past[0, 2] = o.q_reference[lane], o.dq_reference[lane], o.ddq_reference[lane]
        if begins:
            for k in range(1, PAST):
                past[k] = past[0]
        for k in range(PAST):
            tip_direction(past[k, 0], past[k, 1], constants, dirs[k])
            for i in range(SPACE):
                force[i] = p[0] * dirs[k, i] + p[1 + i]
            link_torque(past[k, 0], past[k, 1], past[k, 2], force, constants, tau[k])
        for j in range(JOINTS):
            ahead_q[j] = past[0, 0, j] + T * past[0, 1, j] + 0.5 * T * T * past[0, 2, j]
            ahead_dq[j] = past[0, 1, j] + T * past[0, 2, j]
        tip_direction(ahead_q, ahead_dq, constants, ahead_dir)
        for i in range(SPACE):
            directions[i, 0] = 0.5 * (dirs[0, i] + ahead_dir[i])
            directions[SPACE + i, 0] = ahead_dir[i] - dirs[0, i]
        # state when the command acts
        d = p[len(p) - 1]
        whole = int(d)
        rest = d - whole
        state, held, line, arm = one
        for i in range(STATES):
            state[i, 0] = z[i]
        for i in range(len(constants)):
            arm[i, 0] = constants[i]
        for i in range(FORCE_ROWS):
            line[i, 0] = 0.0
            for j in range(1 + SPACE):
                line[i, 0] += directions[i, j] * p[j]
        # commands[k] is u_{k+1 ago}: commands[0] = u_{k-1}
        for step in range(whole):
            for j in range(JOINTS):
                held[j, 0] = (1.0 - rest) * commands[whole - step - 1, j] + rest * commands[whole - step, j]
            hold(state, held, line, arm, h, substeps)
        if rest > 0.0:
            for j in range(JOINTS):
                held[j, 0] = commands[0, j]
            hold(state, held, line, arm, rest * h, substeps)
        # target
        inertia, viscous, stiffness, damping, static, coulomb, stribeck = joint_parts(constants)
        t = d * T
        for j in range(JOINTS):
            smooth_before = 0.0
            for k in range(1, -1, -1):
                rate = (11.0 * tau[k, j] - 18.0 * tau[k + 1, j] + 9.0 * tau[k + 2, j] - 2.0 * tau[k + 3, j]) / (6.0 * T)
                curvature = (2.0 * tau[k, j] - 5.0 * tau[k + 1, j] + 4.0 * tau[k + 2, j] - tau[k + 3, j]) / (T * T)
                b = damping[j] / stiffness[j]
                velocity = past[k, 1, j] + (rate - b * curvature) / stiffness[j]
                acceleration = past[k, 2, j] + curvature / stiffness[j]
                smooth = inertia[j] * acceleration + viscous[j] * velocity + tau[k, j]
                if k == 1:
                    smooth_before = smooth
            theta = past[0, 0, j] + (tau[0, j] - b * (rate - b * curvature)) / stiffness[j]
            middle = velocity + (0.5 * T + t) * acceleration
            slip = stribeck_magnitude(middle, coulomb[j], static[j], stribeck) * np.sign(middle)
            torque[lane, j] = smooth + (0.5 + d) * (smooth - smooth_before) + slip
            error[j] = state[j, 0] - (theta + t * velocity + 0.5 * t * t * acceleration)
            error[JOINTS + j] = state[JOINTS + j, 0] - (past[0, 0, j] + t * past[0, 1, j] + 0.5 * t * t * past[0, 2, j])
            error[2 * JOINTS + j] = state[2 * JOINTS + j, 0] - (velocity + t * acceleration)
            error[3 * JOINTS + j] = state[3 * JOINTS + j, 0] - (past[0, 1, j] + t * past[0, 2, j])
        place = 0.5 * (np.cos(o.q_motor[lane, 1]) + 1.0) * (feedback.shape[1] - 1)
        left = min(max(int(place), 0), feedback.shape[1] - 2)
        share = place - left
        load = min(max(p[1 + SPACE] / mass / 0.5, 0.0), 1.0) * (len(feedback) - 1)
        low_load = min(int(load), len(feedback) - 2)
        load_share = load - low_load
        for j in range(JOINTS):
            for i in range(STATES):
                near = (1.0 - share) * feedback[low_load, left, j, i] + share * feedback[low_load, left + 1, j, i]
                far = (1.0 - share) * feedback[low_load + 1, left, j, i] + share * feedback[low_load + 1, left + 1, j, i]
                torque[lane, j] -= ((1.0 - load_share) * near + load_share * far) * error[i]
        for k in range(LONGEST, 0, -1):
            commands[k] = commands[k - 1]
        for j in range(JOINTS):
            if not np.isfinite(torque[lane, j]):
                torque[lane, j] = 0.0
            commands[0, j] = min(max(torque[lane, j], -limit[j]), limit[j])
        if begins:
            m[0] = 1.0
            for k in range(1, LONGEST + 1):
                commands[k] = commands[0]
        # applied torque over the coming period, and slope
        wide = np.sqrt(max(P[N - 1, N - 1], 0.0))
        early, late = max(d - wide, 0.0), min(d + wide, float(LONGEST - 1))
        for j in range(JOINTS):
            applied[j] = _at(commands, d, j)
            slope[j] = (_at(commands, late, j) - _at(commands, early, j)) / max(late - early, 1e-9)
        predict(z, P, STATES, applied, slope, directions, constants, slopes, steps, noise, h, substeps, work)


@register_jitable
def _at(commands, d, j):
    whole = min(int(d), LONGEST - 1)
    rest = d - whole
    return (1.0 - rest) * commands[whole, j] + rest * commands[whole + 1, j]


@register_jitable
def _begin(q, dq, z, P, spread, first, base):
    force, still, link, tau = np.zeros(SPACE), np.zeros(JOINTS), np.empty(JOINTS), np.empty(JOINTS)
    stiffness = joint_parts(base)[2]
    P[:] = 0.0
    for i in range(N):
        P[i, i] = spread[i] * spread[i]
    for j in range(len(first)):
        z[STATES + j] = first[j]
    for j in range(JOINTS):
        link[j] = q[j]
    for _ in range(STATICS_STEPS):
        link_torque(link, still, still, force, base, tau)
        for j in range(JOINTS):
            link[j] = q[j] - tau[j] / stiffness[j]
    for j in range(JOINTS):
        z[j], z[JOINTS + j] = q[j], link[j]
        z[2 * JOINTS + j] = z[3 * JOINTS + j] = dq[j]
