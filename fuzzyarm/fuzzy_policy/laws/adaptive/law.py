"""One sample of the adaptive observer: correct, act, predict; the law is in `policy`."""

from __future__ import annotations

import functools
from typing import Any

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.fuzzy_policy.laws.adaptive.acting import act_of, mean_torque
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import arm_functions
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import ENOUGH, FLAG, KEPT, LONGEST_LATENESS, ORDERS, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import (
    Room,
    confine,
    correct,
    fill_lanes,
    numbers_at,
    read_noise,
    room_for,
    step,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.adaptive.trust import doubt_lateness, doubt_scale, note_moves, significant, spread_out
from fuzzyarm.numbers.functions import array, each, maximum, minimum, only, select

__all__ = ["MISTRUST", "NOISE_SHARE", "begin_of", "law_of", "note_swing", "predict_of", "steps_of", "take_in"]

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits
NOISE_SHARE = 0.03  # of a sample, in the estimated noise of the encoders, once there have been enough
MISTRUST = 8.0  # least variance of a measured angle that is expected, in variances of the noise that is read
SURPRISE_SHARE = 0.02  # of a sample, in the mean surprise
DIVERGED = 50.0  # mean surprise at which a filter counts as diverged
SWING_SHARE = 0.1  # of a sample, in the mean of the commands' jumps


@functools.cache
def law_of(physics: Physics) -> Any:
    """Return the law ``law(m, seen, s, known)`` for arms with these equations.

    It advances the memory in place and returns the torque (n,) [N m], not clipped; nan where the filter has diverged.
    `known` (`KEPT` + 1, axes) is a tip force [N] known beforehand, which the estimated one adds to: at this sample, at
    those before it, and at the next one.
    """
    correct, act, predict = steps_of(physics)

    def estimate_and_act(m: Memory, seen: Observation, s: Settings, known: Any) -> Any:
        room, torque = room_for(s), array(physics.joints)
        correct(seen, m, s, room)
        act(room.acted, m, s, room, known, torque)
        predict(m, s, room, torque)
        return torque

    return estimate_and_act


@functools.cache
def steps_of(physics: Physics) -> tuple[Any, Any, Any]:
    """Return the three steps of a sample; nothing moves in a filter that has diverged.

        ``correct(seen, m, s, room)`` corrects, and finds the z on which the law acts.
        ``act(room.acted, m, s, room, known, torque)`` fills `torque` (n,) [N m] with what the law asks for.
        ``predict(m, s, room, torque)`` predicts the next sample; the filter diverges where `torque` is no number.

    After `act`, ``m.commands[0]`` (n,) may be set to the torque [N m] that is commanded instead.
    """
    begin = begin_of(physics)

    def correct_sample(seen: Observation, m: Memory, s: Settings, room: Room) -> None:
        for i in each(len(room.acted)):  # of a diverged filter, too: in C both sides of a branch fill it
            room.acted[i] = m.z[i]
        for _ in only(m.flags[FLAG.lost] == 0.0):
            take_in(seen, m, room)
            begin(m, s, room)
            _note_noise(m, s, room)
            for i in each(len(room.moved)):
                room.moved[i] = m.z[4 * len(m.noise) + i]
            surprise = correct(m.z, m.P, room.measured, room.variances, room.silent, s.cautious, s.gate, room.column)
            m.flags[FLAG.surprise] += SURPRISE_SHARE * (surprise - m.flags[FLAG.surprise])
            doubt_lateness(m, s, surprise)
            doubt_scale(m, s, surprise)
            note_moves(m, s, room.moved)
            confine(m.z, m.P, s.low, s.high)
            note_swing(m, s)
            calm = (m.flags[FLAG.surprise] < DIVERGED) & (m.flags[FLAG.swing] < s.largest_swing)
            m.flags[FLAG.lost] = select(calm & _finite(m.z, m.P), m.flags[FLAG.lost], 1.0)
            significant(m, s, room)

    return correct_sample, act_of(physics), predict_of(physics)


def take_in(seen: Observation, m: Memory, room: Room) -> None:
    """Take in what is measured and asked for, and count the sample."""
    joints = len(m.noise)
    for j in range(joints):
        room.measured[j], room.measured[joints + j] = seen.q_motor[j], seen.dq_motor[j]
        for k in range(KEPT - 1, 0, -1):
            for order in range(ORDERS):
                m.references[k, order, j] = m.references[k - 1, order, j]
        m.references[0, 0, j], m.references[0, 1, j] = seen.q_reference[j], seen.dq_reference[j]
        m.references[0, 2, j] = seen.ddq_reference[j]
    m.flags[FLAG.samples] = minimum(m.flags[FLAG.samples] + 1.0, ENOUGH)


@functools.cache
def begin_of(physics: Physics) -> Any:
    """Return ``begin(m, s, room)`` that fills the first z and P, if what was taken in is the first sample.

    K_t (θ - q) = g(q) for the measured θ, links as fast as motors, p_0. What an earlier pass has taught is kept, but
    for the loads, which begin anew.
    """
    _, link_torque, _, drive, constants_in = arm_functions(physics)

    def begin(m: Memory, s: Settings, room: Room) -> None:
        joints = len(m.noise)
        bent, link, taught = room.joints[1], m.z[joints : 2 * joints], m.flags[FLAG.taught] != 0.0
        still, force = [0.0] * joints, [0.0] * physics.axes
        for _ in only(m.flags[FLAG.samples] == 1.0):
            arm = constants_in(s.base)
            for _ in only(taught):
                _forget(m, s, 4 * joints + len(s.reopening))
            for _ in only(~taught):
                _forget(m, s, len(m.z))
            for j in range(joints):
                m.z[j] = link[j] = room.measured[j]
                m.z[2 * joints + j] = m.z[3 * joints + j] = room.measured[joints + j]
                m.noise[j] = s.variances[j]
                for part in each(len(m.read)):
                    m.read[part, j] = room.measured[j]
                for k in range(1, KEPT):
                    for order in range(ORDERS):
                        m.references[k, order, j] = m.references[0, order, j]
            for _ in each(STATICS_STEPS):
                for j, number in enumerate(link_torque(link, still, still, force, arm)):
                    bent[j] = number
                for j in range(joints):
                    link[j] = room.measured[j] - bent[j] / drive(s.base, j).stiffness
            for k in each(len(m.commands)):
                for j in each(joints):
                    m.commands[k, j] = bent[j]

    return begin


def _forget(m: Memory, s: Settings, count: int) -> None:
    """Let the first `count` numbers of z be as uncertain as at the first sample, and those of p among them p_0."""
    states = len(m.z) - len(s.guess)
    for i in each(count):
        for j in each(len(m.z)):
            m.P[i, j] = m.P[j, i] = 0.0
    for i in each(count):
        m.P[i, i] = s.spread[i] * s.spread[i]
        for j in each(count):
            m.P[i, j] += s.shared[i] * s.shared[j]
    for i in each(count - states):
        m.z[states + i] = s.guess[i]


def note_swing(m: Memory, s: Settings) -> None:
    """Let the last jump of the commands count in the mean of jumps, which begins at zero with the episode.

    w ← w + `SWING_SHARE` (max_j |u_k - u_k-1| / u_max - w). A load makes few large jumps, and w stays small. Where
    motors are much stronger or later than believed, commands swing from limit to limit, and w comes near 2.
    """
    jump: Any = 0.0
    for j in range(len(m.noise)):
        jump = maximum(jump, abs(m.commands[0, j] - m.commands[1, j]) / s.limit[j])
    swing = select(m.flags[FLAG.samples] == 1.0, 0.0, m.flags[FLAG.swing])
    m.flags[FLAG.swing] = swing + SWING_SHARE * (jump - swing)


def _noise_share(samples: Any, first: Any) -> Any:
    """Return the share of a sample in the noise: a mean of all, until that is `NOISE_SHARE`.

    The first change of e is that of the third sample; no share is larger than `first`.
    """
    return select(samples > 2.0, minimum(maximum(NOISE_SHARE, 1.0 / maximum(samples - 2.0, 1.0)), first), 0.0)


def _note_noise(m: Memory, s: Settings, room: Room) -> None:
    """Read the noise of what is measured, and fill what variances it has and how much of it teaches nothing."""
    joints, share = len(m.noise), _noise_share(m.flags[FLAG.samples], s.first_share)
    read_noise(room.measured, m.read, m.noise, share, s.substep * s.substeps)
    for j in each(joints):
        ratio = s.variances[joints + j] / s.variances[j]
        room.silent[j] = s.dead_zone * m.noise[j]
        room.silent[joints + j] = room.silent[j] * ratio
        room.variances[j] = maximum(s.variances[j], MISTRUST * m.noise[j])
        room.variances[joints + j] = room.variances[j] * ratio


def _finite(z: Any, P: Any) -> Any:
    """Return whether the sum of all numbers is finite."""
    total = array(2)
    total[0], total[1] = 0.0, 0.0
    for i in each(len(z)):
        total[0] += z[i]
        for j in each(len(z)):
            total[1] += P[i, j]
    both = total[0] + total[1]
    return both - both == 0.0


@functools.cache
def predict_of(physics: Physics) -> Any:
    """Return the step of z and P to the next sample, see `steps_of`.

    The motors apply the commands that reach them until then.
    """
    hold = arm_functions(physics).hold

    def predict(m: Memory, s: Settings, room: Room, torque: Any) -> None:
        joints, size = len(m.noise), len(m.z)
        for _ in only(m.flags[FLAG.lost] == 0.0):
            numbers_at(m.z[4 * joints :], s.guess, s.base, s.slopes, room.numbers)
            lateness, wide = m.z[size - 1], root(maximum(m.P[size - 1, size - 1], 0.0))
            early, late = maximum(lateness - wide, 0.0), minimum(lateness + wide, float(LONGEST_LATENESS))
            applied, slope = room.joints[0], room.joints[1]
            total: Any = 0.0
            for j in range(joints):
                applied[j] = mean_torque(m.commands, lateness, j)
                change = mean_torque(m.commands, late, j) - mean_torque(m.commands, early, j)
                slope[j] = change / maximum(late - early, 1e-9)
                total = total + torque[j]
            fill_lanes(
                m.z, m.P, applied, slope, room.line, room.directions, room.numbers, s.slopes, s.steps, room.lanes
            )
            hold(room.lanes.state, room.lanes.torque, room.lanes.force, room.lanes.numbers, s.substep, s.substeps)
            step(m.z, m.P, s.steps, s.noise, room.lanes)
            spread_out(m, s)
            m.flags[FLAG.lost] = select(total - total == 0.0, m.flags[FLAG.lost], 1.0)

    return predict
