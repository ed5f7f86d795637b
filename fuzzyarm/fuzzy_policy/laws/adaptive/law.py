"""One sample of the adaptive observer in every lane, compiled: correct, act, predict; the law is in `policy`."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import Observation, observed
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.elementwise import select
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import (
    FORCE_ROWS,
    drive_constants,
    dry_friction,
    hold,
    link_torque,
    schedule,
    tip_direction,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import BELIEF, FORCES, SPACE
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import confine, constants_at, correct, predict, read_noise
from fuzzyarm.fuzzy_policy.laws.adaptive.forces import note_moves, spread_out
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, KEPT, LONGEST_LATENESS, Memory, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import feedback_at
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room, room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings

__all__ = ["act_on_estimate", "begin_or_follow", "estimate_and_act"]

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits
NOISE_SHARE = 0.03  # of a sample, in the estimated noise of the encoders
SURPRISE_SHARE = 0.02  # of a sample, in the mean surprise
DIVERGED = 50.0  # mean surprise at which a filter counts as diverged
_PAYLOAD = BELIEF.payload.start


@kernel
def estimate_and_act(
    observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, known: np.ndarray, settings: Settings
) -> None:
    """Fill `torque` (lanes, n) [N m], not clipped, and advance `memory`; nan for lanes whose filter has diverged.

    `known` (lanes, `KEPT` + 1, space) is a tip force [N] known beforehand, which the estimated one adds to: at this
    sample, at those before it, and at the next one.
    """
    joints, s = torque.shape[1], settings
    room = room_for(joints, len(s.spread), len(s.base))
    o = observed(observation)
    for lane in range(len(observation)):
        m = remembered(memory[lane], joints, len(s.guess))
        torque[lane] = np.nan
        if m.flags[FLAG.lost] == 0.0:
            _correct(lane, o, m, s, room)
            if m.flags[FLAG.lost] == 0.0:
                act_on_estimate(m, s, room, known[lane], torque[lane])
                _predict(m, s, room)
                if not np.isfinite(np.sum(torque[lane])):
                    m.flags[FLAG.lost] = 1.0


@register_jitable
def begin_or_follow(lane: int, o: Observation, m: Memory, s: Settings, room: Room) -> None:
    """Take in what is measured and asked for, and begin if this is the first sample."""
    joints = len(m.noise)
    room.measured[:joints], room.measured[joints:] = o.q_motor[lane], o.dq_motor[lane]
    for k in range(KEPT - 1, 0, -1):
        m.references[k] = m.references[k - 1]
    m.references[0, 0], m.references[0, 1] = o.q_reference[lane], o.dq_reference[lane]
    m.references[0, 2] = o.ddq_reference[lane]
    if m.flags[FLAG.started] == 0.0:
        m.flags[FLAG.started] = 1.0
        _begin(m, s, room)


@register_jitable
def act_on_estimate(m: Memory, s: Settings, room: Room, known: np.ndarray, torque: np.ndarray) -> None:
    """Fill the torque (n,) [N m] for z, and what of it the next step needs; `known` as `estimate_and_act` has it."""
    _desire(m, s, room, known)
    _command(m, s, room, torque)


@register_jitable
def _correct(lane: int, o: Observation, m: Memory, s: Settings, room: Room) -> None:
    """Correct z by what is measured, and note how well that fitted."""
    joints, measured = len(m.noise), room.measured
    begin_or_follow(lane, o, m, s, room)
    read_noise(measured[:joints], m.read, m.noise, NOISE_SHARE)
    for j in range(joints):
        room.silent[j] = s.dead_zone * m.noise[j]
        room.silent[joints + j] = room.silent[j] * s.variances[joints + j] / s.variances[j]
    states = 4 * joints
    before = room.moved
    before[:] = m.z[states : states + FORCES]
    surprise = correct(m.z, m.P, measured, s.variances, room.silent, s.cautious, s.gate, room.column)
    m.flags[FLAG.surprise] += SURPRISE_SHARE * (surprise - m.flags[FLAG.surprise])
    note_moves(m, s, before)
    confine(m.z, m.P, s.low, s.high)
    total = np.sum(m.z) + np.sum(m.P)
    if not (m.flags[FLAG.surprise] < DIVERGED and np.isfinite(total)):
        m.flags[FLAG.lost] = 1.0


@register_jitable
def _begin(m: Memory, s: Settings, room: Room) -> None:
    """Fill the first z and P: K_t (θ - q) = g(q) for the measured θ, links as fast as motors, p_0."""
    joints = len(m.noise)
    states = 4 * joints
    for k in range(1, KEPT):
        m.references[k] = m.references[0]
    # What an earlier pass has taught is kept, but for the loads, which begin anew.
    if m.flags[FLAG.taught] != 0.0:
        _forget(m, s, states + FORCES)
    else:
        _forget(m, s, len(m.z))
    still, bent, link, force = room.joints[0], room.joints[1], m.z[joints : 2 * joints], room.travel[0]
    still[:], force[:] = 0.0, 0.0
    for j in range(joints):
        m.z[j] = link[j] = room.measured[j]
        m.z[2 * joints + j] = m.z[3 * joints + j] = room.measured[joints + j]
        m.noise[j] = s.variances[j]
        m.read[:, j] = room.measured[j]
    for _ in range(STATICS_STEPS):
        link_torque(link, still, still, force, s.base, bent)
        for j in range(joints):
            link[j] = room.measured[j] - bent[j] / drive_constants(s.base, j)[2]
    for k in range(len(m.commands)):
        m.commands[k] = bent


@register_jitable
def _forget(m: Memory, s: Settings, count: int) -> None:
    """Let the first `count` numbers of z be as uncertain as at the first sample, and those of p among them p_0."""
    states = len(m.z) - len(s.guess)
    m.P[:count], m.P[:, :count] = 0.0, 0.0
    for i in range(count):
        m.P[i, i] = s.spread[i] * s.spread[i]
        for j in range(count):
            m.P[i, j] += s.shared[i] * s.shared[j]
    m.z[states:count] = s.guess[: count - states]


@register_jitable
def _desire(m: Memory, s: Settings, room: Room, known: np.ndarray) -> None:
    """Fill the constants of p, the directions of travel, their force lines, and τ_d of the kept references."""
    joints, period = len(m.noise), s.substep * s.substeps
    p = m.z[4 * joints :]
    constants_at(p, s.guess, s.base, s.slopes, room.constants)
    force, next_q, next_dq = room.column[:SPACE], room.joints[0], room.joints[1]
    for k in range(KEPT):
        q, dq, ddq = m.references[k, 0], m.references[k, 1], m.references[k, 2]
        tip_direction(q, dq, room.constants, room.travel[k])
        for i in range(SPACE):
            force[i] = known[k, i] + p[0] * room.travel[k, i] + p[1 + i]
        link_torque(q, dq, ddq, force, room.constants, room.link_torque[k])
    for j in range(joints):
        dq, ddq = m.references[0, 1, j], m.references[0, 2, j]
        next_q[j] = m.references[0, 0, j] + period * (dq + 0.5 * period * ddq)
        next_dq[j] = dq + period * ddq
    tip_direction(next_q, next_dq, room.constants, room.travel[KEPT])
    for i in range(SPACE):
        now, then = room.travel[0, i], room.travel[KEPT, i]
        room.directions[i, 0], room.directions[SPACE + i, 0] = 0.5 * (now + then), then - now
        room.line[i], room.line[SPACE + i] = 0.5 * (known[0, i] + known[KEPT, i]), known[KEPT, i] - known[0, i]


@register_jitable
def _command(m: Memory, s: Settings, room: Room, torque: np.ndarray) -> None:
    """Fill the torque that the motors shall apply when it reaches them."""
    joints, period = len(m.noise), s.substep * s.substeps
    p = m.z[4 * joints :]
    lateness = p[len(p) - 1]
    later, error = lateness * period, room.error
    _advance(m, s, room, lateness)
    state = room.one[0]
    for j in range(joints):
        q, dq, ddq = m.references[0, 0, j], m.references[0, 1, j], m.references[0, 2, j]
        theta, dtheta, ddtheta, smooth = _target(m, room, period, 0, j)
        before = _target(m, room, period, 1, j)[3]
        middle = dtheta + (0.5 * period + later) * ddtheta
        torque[j] = smooth + (0.5 + lateness) * (smooth - before) + dry_friction(middle, room.constants, j)
        torque[j] -= p[len(p) - 1 - joints + j]
        error[j] = state[j, 0] - (theta + later * (dtheta + 0.5 * later * ddtheta))
        error[joints + j] = state[joints + j, 0] - (q + later * (dq + 0.5 * later * ddq))
        error[2 * joints + j] = state[2 * joints + j, 0] - (dtheta + later * ddtheta)
        error[3 * joints + j] = state[3 * joints + j, 0] - (dq + later * ddq)
    feedback_at(s.feedback, schedule(m.references[0, 0]), p[_PAYLOAD] / s.mass, room.gain)
    for k in range(LONGEST_LATENESS + 1, 0, -1):
        m.commands[k] = m.commands[k - 1]
    for j in range(joints):
        for i in range(len(error)):
            torque[j] -= room.gain[j, i] * error[i]
        m.commands[0, j] = min(max(torque[j], -s.limit[j]), s.limit[j])


@register_jitable
def _target(m: Memory, room: Room, period: float, back: int, joint: int) -> tuple[float, float, float, float]:
    """Return θ_d, θ̇_d, θ̈_d and u_ff without dry friction, `back` samples ago with today's p; see `elastic_target`."""
    inertia, viscous, stiffness, damping = drive_constants(room.constants, joint)
    now, last = room.link_torque[back, joint], room.link_torque[back + 1, joint]
    second, third = room.link_torque[back + 2, joint], room.link_torque[back + 3, joint]
    rate = (11.0 * now - 18.0 * last + 9.0 * second - 2.0 * third) / (6.0 * period)
    curvature = (2.0 * now - 5.0 * last + 4.0 * second - third) / (period * period)
    b = damping / stiffness
    q, dq, ddq = m.references[back, 0, joint], m.references[back, 1, joint], m.references[back, 2, joint]
    velocity, acceleration = dq + (rate - b * curvature) / stiffness, ddq + curvature / stiffness
    angle = q + (now - b * (rate - b * curvature)) / stiffness
    return angle, velocity, acceleration, inertia * acceleration + viscous * velocity + now


@register_jitable
def _advance(m: Memory, s: Settings, room: Room, lateness: float) -> None:
    """Fill the first of `one` of the room with x when the next command acts: x under the commands on their way."""
    state, torque, line, constants = room.one
    joints = len(torque)
    state[:, 0], constants[:, 0] = m.z[: len(state)], room.constants
    for i in range(FORCE_ROWS):
        line[i, 0] = room.line[i]
        for j in range(FORCES):
            line[i, 0] += room.directions[i, j] * m.z[len(state) + j]
    whole = int(lateness)
    rest = lateness - whole
    for step in range(LONGEST_LATENESS):
        if step < whole:
            for j in range(joints):
                sent = (1.0 - rest) * _sent(m.commands, whole - step - 1, j) + rest * _sent(m.commands, whole - step, j)
                torque[j, 0] = sent + m.z[len(m.z) - 1 - joints + j]
            hold(state, torque, line, constants, s.substep, s.substeps)
    if rest > 0.0:
        torque[:, 0] = m.commands[0] + m.z[len(m.z) - 1 - joints : len(m.z) - 1]
        hold(state, torque, line, constants, rest * s.substep, s.substeps)


@register_jitable
def _predict(m: Memory, s: Settings, room: Room) -> None:
    """Step z and P to the next sample, under the commands that reach the motors until then."""
    joints, size = len(m.noise), len(m.z)
    lateness, wide = m.z[size - 1], np.sqrt(max(m.P[size - 1, size - 1], 0.0))
    early, late = max(lateness - wide, 0.0), min(lateness + wide, float(LONGEST_LATENESS))
    applied, slope = room.joints[0], room.joints[1]
    for j in range(joints):
        applied[j] = _applied(m.commands, lateness, j)
        slope[j] = (_applied(m.commands, late, j) - _applied(m.commands, early, j)) / max(late - early, 1e-9)
    predict(
        m.z,
        m.P,
        applied,
        slope,
        room.line,
        room.directions,
        room.constants,
        s.slopes,
        s.steps,
        s.noise,
        s.substep,
        s.substeps,
        room.lanes,
    )
    spread_out(m, s)


@register_jitable
def _applied(commands: np.ndarray, lateness: float, joint: int) -> float:
    """Return the mean torque over the coming control period if commands act `lateness` periods late."""
    whole = int(lateness)
    rest = lateness - whole
    torque: float = (1.0 - rest) * _sent(commands, whole, joint) + rest * _sent(commands, whole + 1, joint)
    return torque


@register_jitable
def _sent(commands: np.ndarray, place: int, joint: int) -> float:
    """Return the torque [N m] at a place of the commands, without an index that depends on data."""
    torque: float = commands[0, joint]
    for k in range(1, len(commands)):
        torque = select(place == k, commands[k, joint], torque)
    return torque
