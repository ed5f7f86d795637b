"""One sample of the adaptive observer in every lane, compiled: correct, act, predict; the law is in `policy`."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import Observation, observed
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.fuzzy_policy.laws.adaptive.acting import act_of, mean_torque
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import arm_functions
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import confine, correct, fill_lanes, numbers_at, read_noise, step
from fuzzyarm.fuzzy_policy.laws.adaptive.forces import doubt_lateness, doubt_scale, note_moves, spread_out
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import ENOUGH, FLAG, KEPT, LONGEST_LATENESS, ORDERS, Memory, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room, room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.adaptive.significance import significant

__all__ = ["MISTRUST", "NOISE_SHARE", "begin_of", "law_of", "note_swing", "predict_of", "steps_of", "take_in"]

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits
NOISE_SHARE = 0.03  # of a sample, in the estimated noise of the encoders, once there have been enough
MISTRUST = 8.0  # least variance of a measured angle that is expected, in variances of the noise that is read
SURPRISE_SHARE = 0.02  # of a sample, in the mean surprise
DIVERGED = 50.0  # mean surprise at which a filter counts as diverged
SWING_SHARE = 0.1  # of a sample, in the mean of the commands' jumps


@functools.cache
def law_of(physics: Physics) -> Any:
    """Return the kernel ``law(observation, memory, torque, known, settings)`` for arms with these equations.

    It fills `torque` (lanes, n) [N m], not clipped, and advances `memory`; nan for lanes whose filter has diverged.
    `known` (lanes, `KEPT` + 1, axes) is a tip force [N] known beforehand, which the estimated one adds to: at this
    sample, at those before it, and at the next one.
    """
    correct, act, predict = steps_of(physics)

    @kernel_for(physics.digest)
    def estimate_and_act(
        observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, known: np.ndarray, settings: Settings
    ) -> None:
        """See `law_of`."""
        joints, s = torque.shape[1], settings
        room, o = room_for(s), observed(observation)
        for lane in range(len(observation)):
            m = remembered(memory[lane], joints, len(s.guess), len(s.reopening))
            correct(lane, o, m, s, room)
            act(room.acted, m, s, room, known[lane], torque[lane])
            predict(m, s, room, torque[lane])

    return estimate_and_act


@functools.cache
def steps_of(physics: Physics) -> tuple[Any, Any, Any]:
    """Return the three compiled steps of a lane's sample; nothing moves in a filter that has diverged.

        ``correct(lane, o, m, s, room)`` corrects, and finds the z on which the law acts.
        ``act(room.acted, m, s, room, known, torque)`` fills `torque` (n,) [N m] with what the law asks for.
        ``predict(m, s, room, torque)`` predicts the next sample; the filter diverges where `torque` is no number.

    After `act`, ``m.commands[0]`` (n,) may be set to the torque [N m] that is commanded instead.
    """
    begin = begin_of(physics)

    @register_jitable
    def correct_lane(lane: int, o: Observation, m: Memory, s: Settings, room: Room) -> None:
        for i in range(len(room.acted)):  # of a diverged filter, too: in C both sides of a branch fill it
            room.acted[i] = m.z[i]
        if m.flags[FLAG.lost] == 0.0:
            take_in(lane, o, m, room)
            begin(m, s, room)
            _note_noise(m, s, room)
            for i in range(len(room.moved)):
                room.moved[i] = m.z[4 * len(m.noise) + i]
            surprise = correct(m.z, m.P, room.measured, room.variances, room.silent, s.cautious, s.gate, room.column)
            m.flags[FLAG.surprise] += SURPRISE_SHARE * (surprise - m.flags[FLAG.surprise])
            doubt_lateness(m, s, surprise)
            doubt_scale(m, s, surprise)
            note_moves(m, s, room.moved)
            confine(m.z, m.P, s.low, s.high)
            note_swing(m, s)
            calm = m.flags[FLAG.surprise] < DIVERGED and m.flags[FLAG.swing] < s.largest_swing
            if not (calm and _finite(m.z, m.P)):
                m.flags[FLAG.lost] = 1.0
            significant(m, s, room)

    return correct_lane, act_of(physics), predict_of(physics)


@register_jitable
def take_in(lane: int, o: Observation, m: Memory, room: Room) -> None:
    """Take in what is measured and asked for in a lane, and count the sample."""
    joints = len(m.noise)
    for j in range(joints):
        room.measured[j], room.measured[joints + j] = o.q_motor[lane, j], o.dq_motor[lane, j]
        for k in range(KEPT - 1, 0, -1):
            for order in range(ORDERS):
                m.references[k, order, j] = m.references[k - 1, order, j]
        m.references[0, 0, j], m.references[0, 1, j] = o.q_reference[lane, j], o.dq_reference[lane, j]
        m.references[0, 2, j] = o.ddq_reference[lane, j]
    m.flags[FLAG.samples] = min(m.flags[FLAG.samples] + 1.0, ENOUGH)


@functools.cache
def begin_of(physics: Physics) -> Any:
    """Return the compiled ``begin(m, s, room)`` that fills the first z and P, if what was taken in is the first sample.

    K_t (θ - q) = g(q) for the measured θ, links as fast as motors, p_0. What an earlier pass has taught is kept, but
    for the loads, which begin anew.
    """
    _, link_torque, _, drive = arm_functions(physics)

    @register_jitable
    def begin(m: Memory, s: Settings, room: Room) -> None:
        joints = len(m.noise)
        still, bent, link, force = room.joints[0], room.joints[1], m.z[joints : 2 * joints], room.travel[0]
        if m.flags[FLAG.samples] == 1.0:
            if m.flags[FLAG.taught] != 0.0:
                _forget(m, s, 4 * joints + len(s.reopening))
            else:
                _forget(m, s, len(m.z))
            for i in range(len(force)):
                force[i] = 0.0
            for j in range(joints):
                still[j] = 0.0
                m.z[j] = link[j] = room.measured[j]
                m.z[2 * joints + j] = m.z[3 * joints + j] = room.measured[joints + j]
                m.noise[j] = s.variances[j]
                for part in range(len(m.read)):
                    m.read[part, j] = room.measured[j]
                for k in range(1, KEPT):
                    for order in range(ORDERS):
                        m.references[k, order, j] = m.references[0, order, j]
            for _ in range(STATICS_STEPS):
                link_torque(link, still, still, force, s.base, bent)
                for j in range(joints):
                    link[j] = room.measured[j] - bent[j] / drive(s.base, j).stiffness
            for k in range(len(m.commands)):
                for j in range(joints):
                    m.commands[k, j] = bent[j]

    return begin


@register_jitable
def _forget(m: Memory, s: Settings, count: int) -> None:
    """Let the first `count` numbers of z be as uncertain as at the first sample, and those of p among them p_0."""
    states = len(m.z) - len(s.guess)
    for i in range(count):
        for j in range(len(m.z)):
            m.P[i, j] = m.P[j, i] = 0.0
    for i in range(count):
        m.P[i, i] = s.spread[i] * s.spread[i]
        for j in range(count):
            m.P[i, j] += s.shared[i] * s.shared[j]
    for i in range(count - states):
        m.z[states + i] = s.guess[i]


@register_jitable
def note_swing(m: Memory, s: Settings) -> None:
    """Let the last jump of the commands count in the mean of jumps, which begins at zero with the episode.

    w ← w + `SWING_SHARE` (max_j |u_k - u_k-1| / u_max - w). A load makes few large jumps, and w stays small. Where
    motors are much stronger or later than believed, commands swing from limit to limit, and w comes near 2.
    """
    jump = 0.0
    for j in range(len(m.noise)):
        jump = max(jump, abs(m.commands[0, j] - m.commands[1, j]) / s.limit[j])
    if m.flags[FLAG.samples] == 1.0:
        m.flags[FLAG.swing] = 0.0
    m.flags[FLAG.swing] += SWING_SHARE * (jump - m.flags[FLAG.swing])


@register_jitable
def _noise_share(samples: float, first: float) -> float:
    """Return the share of a sample in the noise: a mean of all, until that is `NOISE_SHARE`.

    The first change of e is that of the third sample; no share is larger than `first`.
    """
    return min(max(NOISE_SHARE, 1.0 / (samples - 2.0)), first) if samples > 2.0 else 0.0


@register_jitable
def _note_noise(m: Memory, s: Settings, room: Room) -> None:
    """Read the noise of what is measured, and fill what variances it has and how much of it teaches nothing."""
    joints, share = len(m.noise), _noise_share(m.flags[FLAG.samples], s.first_share)
    read_noise(room.measured, m.read, m.noise, share, s.substep * s.substeps)
    for j in range(joints):
        ratio = s.variances[joints + j] / s.variances[j]
        room.silent[j] = s.dead_zone * m.noise[j]
        room.silent[joints + j] = room.silent[j] * ratio
        room.variances[j] = max(s.variances[j], MISTRUST * m.noise[j])
        room.variances[joints + j] = room.variances[j] * ratio


@register_jitable
def _finite(z: np.ndarray, P: np.ndarray) -> bool:
    """Return whether the sum of all numbers is finite."""
    total_z = total_P = 0.0
    for i in range(len(z)):
        total_z += z[i]
        for j in range(len(z)):
            total_P += P[i, j]
    finite: bool = np.isfinite(total_z + total_P)
    return finite


@functools.cache
def predict_of(physics: Physics) -> Any:
    """Return the compiled step of z and P to the next sample, see `steps_of`.

    The motors apply the commands that reach them until then.
    """
    hold = arm_functions(physics).hold

    @register_jitable
    def predict(m: Memory, s: Settings, room: Room, torque: np.ndarray) -> None:
        joints, size = len(m.noise), len(m.z)
        if m.flags[FLAG.lost] == 0.0:
            numbers_at(m.z[4 * joints :], s.guess, s.base, s.slopes, room.numbers)
            lateness, wide = m.z[size - 1], np.sqrt(max(m.P[size - 1, size - 1], 0.0))
            early, late = max(lateness - wide, 0.0), min(lateness + wide, float(LONGEST_LATENESS))
            applied, slope = room.joints[0], room.joints[1]
            total = 0.0
            for j in range(joints):
                applied[j] = mean_torque(m.commands, lateness, j)
                change = mean_torque(m.commands, late, j) - mean_torque(m.commands, early, j)
                slope[j] = change / max(late - early, 1e-9)
                total += torque[j]
            fill_lanes(
                m.z, m.P, applied, slope, room.line, room.directions, room.numbers, s.slopes, s.steps, room.lanes
            )
            hold(room.lanes.state, room.lanes.torque, room.lanes.force, room.lanes.numbers, s.substep, s.substeps)
            step(m.z, m.P, s.steps, s.noise, room.lanes)
            spread_out(m, s)
            if not np.isfinite(total):
                m.flags[FLAG.lost] = 1.0

    return predict
