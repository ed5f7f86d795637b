"""One sample of the adaptive observer: correct, act, predict; the law is in `policy`.

The torque of the adaptive observer for its estimate z: target, feedforward and regulator; see `policy`.

The scheduled regulator K of the adaptive observer, tabulated over the posture and over the payload.

An episode begins with a share of it: K is so sharp that motors stronger or later than known swing against it until the
filter knows them better, and their first tens of milliseconds are where an arm is lost.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import (
    ENOUGH,
    FLAG,
    KEPT,
    LONGEST_LATENESS,
    ORDERS,
    AdaptiveWeights,
    Memory,
    arm_functions,
    dry_friction,
    mass_of,
)
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import (
    Room,
    Settings,
    confine,
    correct,
    doubt_lateness,
    doubt_scale,
    fill_lanes,
    note_moves,
    numbers_at,
    read_noise,
    room_for,
    significant,
    spread_out,
    step,
)
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, corners_of, loaded_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, feedback_gain, sampled_arm
from fuzzyarm.numbers.functions import array, each, entry, floor, maximum, minimum, number, only, select

__all__ = [
    "MISTRUST",
    "NOISE_SHARE",
    "FeedbackTable",
    "act_of",
    "begin_of",
    "feedback_at",
    "feedback_table",
    "gain_share",
    "law_of",
    "mean_torque",
    "note_swing",
    "predict_of",
    "steps_of",
    "take_in",
]  # fmt: skip


HEAVIEST = 0.5  # payload of the table's end, share of the mass of all links
PAYLOADS = 6


class FeedbackTable(NamedTuple):
    """The regulator at the points of a schedule.

    Attributes:
        schedule: over which angles, and at which points.
        gains: K (payloads, points, n, 4 n) [N m/rad, N m s/rad] at payloads up to half the links' mass.
    """

    schedule: GainSchedule
    gains: np.ndarray


@functools.lru_cache(maxsize=8)
def feedback_table(arm: AnyArm, control_period: float, weights: AdaptiveWeights) -> FeedbackTable:
    """Return the table for an arm and a control period [s].

    Raises:
        ValueError: a Riccati equation has no solution in double precision.
    """
    costs = ObserverWeights(link_angle=weights.link_angle, link_velocity=weights.link_velocity)
    limit, schedule = per_joint_of(arm, "torque_limit"), schedule_of(arm)
    gains = np.empty((PAYLOADS, len(schedule.places), len(limit), 4 * len(limit)))
    for place, mass in enumerate(np.linspace(0.0, HEAVIEST * mass_of(arm), PAYLOADS)):
        for column, inertia in enumerate(loaded_inertia(arm, schedule, float(mass))):
            A, B = sampled_arm(arm, control_period, inertia)
            try:
                gains[place, column] = feedback_gain(A, B, limit, costs)
            except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
                raise ValueError(
                    f"no gains at {schedule.places[column]} for control_period = {control_period!r} s, {weights} and "
                    f"this arm ({error}): take a shorter period, or other weights"
                ) from None
    gains.flags.writeable = False
    return FeedbackTable(schedule, gains)


def feedback_at(s: Settings, q: Any, payload: Any, gain: Any) -> None:
    """Fill K (n, 4 n) at angles q (n,) [rad] and a payload in masses of the links, between the table's entries."""
    payloads, entries = s.feedback.shape[0], s.feedback_rows.shape[0]
    place = minimum(maximum(payload / HEAVIEST, 0.0), 1.0) * (payloads - 1.0)
    lower = minimum(payloads - 2.0, maximum(0.0, floor(place)))  # a share that is nan is mapped into the table, too
    low, corners, points = place - lower, corners_of(q, s.kept, s.cosine, s.points), entries / payloads
    for i in each(len(gain)):
        for k in each(gain.shape[1]):
            near: Any = 0.0
            far: Any = 0.0
            for corner, weight in corners:
                column = i * gain.shape[1] + k
                near = near + weight * entry(s.feedback_rows, lower * points + corner, column)
                far = far + weight * entry(s.feedback_rows, (lower + 1.0) * points + corner, column)
            gain[i, k] = (1.0 - low) * near + low * far


def gain_share(m: Memory, s: Settings) -> Any:
    """Return the share of K at this sample: `first_gain` at the soft start, from there in as long again up to 1.

    It is 1 at once where an earlier pass has taught how strong and how late the motors are.
    """
    past = (m.flags[FLAG.samples] - 1.0) / s.soft_samples - 1.0
    share = s.first_gain + (1.0 - s.first_gain) * minimum(maximum(past, 0.0), 1.0)
    return select(m.flags[FLAG.taught] != 0.0, 1.0, share)


@functools.cache
def act_of(physics: Physics) -> Any:
    """Return the compiled ``act(z, m, s, room, known, torque)``; `known` (`KEPT` + 1, axes) as `law_of` has it.

    It fills the torque (n,) [N m] for z, not clipped, and what of it the next step needs; nan for a filter that has
    diverged.
    """
    desire, advance, command = _desire_of(physics), _advance_of(physics), _command_of(physics)

    def act(z: Any, m: Memory, s: Settings, room: Room, known: Any, torque: Any) -> None:
        for j in each(len(torque)):
            torque[j] = math.nan
        for _ in only(m.flags[FLAG.lost] == 0.0):
            desire(z, m, s, room, known)
            advance(z, m, s, room)
            command(z, m, s, room, torque)

    return act


@functools.cache
def _desire_of(physics: Physics) -> Any:
    """Return what fills the numbers of p, the directions of travel, their force lines, and τ_d of the references."""
    _, link_torque, tip_direction, _, constants_in = arm_functions(physics)

    def desire(z: Any, m: Memory, s: Settings, room: Room, known: Any) -> None:
        joints, axes, period = len(m.noise), known.shape[1], s.substep * s.substeps
        p = z[4 * joints :]
        numbers_at(p, s.guess, s.base, s.slopes, room.numbers)
        next_q, next_dq, arm = room.joints[0], room.joints[1], constants_in(room.numbers)
        for k in each(KEPT):
            q, dq, ddq = m.references[k, 0], m.references[k, 1], m.references[k, 2]
            travel = tip_direction(q, dq, arm)
            force = [known[k, i] + p[0] * travel[i] + p[1 + i] for i in range(axes)]
            for i, along in enumerate(travel):
                room.travel[k, i] = along
            for j, tau in enumerate(link_torque(q, dq, ddq, force, arm)):
                room.link_torque[k, j] = tau
        for j in each(joints):
            dq, ddq = m.references[0, 1, j], m.references[0, 2, j]
            next_q[j] = m.references[0, 0, j] + period * (dq + 0.5 * period * ddq)
            next_dq[j] = dq + period * ddq
        for i, along in enumerate(tip_direction(next_q, next_dq, arm)):
            room.travel[KEPT, i] = along
        for i in range(axes):
            now, then = room.travel[0, i], room.travel[KEPT, i]
            room.directions[i, 0], room.directions[axes + i, 0] = 0.5 * (now + then), then - now
            room.line[i], room.line[axes + i] = 0.5 * (known[0, i] + known[KEPT, i]), known[KEPT, i] - known[0, i]

    return desire


@functools.cache
def _command_of(physics: Physics) -> Any:
    """Return what fills the torque that the motors shall apply when it reaches them."""
    drive = arm_functions(physics).drive

    def command(z: Any, m: Memory, s: Settings, room: Room, torque: Any) -> None:
        joints, period = len(m.noise), s.substep * s.substeps
        p, state = z[4 * joints :], room.one[0]
        lateness = p[len(p) - 1]
        later, error = lateness * period, room.error
        for j in range(joints):
            q, dq, ddq = m.references[0, 0, j], m.references[0, 1, j], m.references[0, 2, j]
            motor = drive(room.numbers, j)
            theta, dtheta, ddtheta, smooth = _target(m, room, period, 0, j, motor)
            before = _target(m, room, period, 1, j, motor)[3]
            middle = dtheta + (0.5 * period + later) * ddtheta
            torque[j] = smooth + (0.5 + lateness) * (smooth - before) + dry_friction(middle, motor)
            torque[j] -= p[len(p) - 1 - joints + j]
            error[j] = state[j, 0] - (theta + later * (dtheta + 0.5 * later * ddtheta))
            error[joints + j] = state[joints + j, 0] - (q + later * (dq + 0.5 * later * ddq))
            error[2 * joints + j] = state[2 * joints + j, 0] - (dtheta + later * ddtheta)
            error[3 * joints + j] = state[3 * joints + j, 0] - (dq + later * ddq)
        feedback_at(s, m.references[0, 0], p[len(s.reopening)] / s.mass, room.gain)
        share = gain_share(m, s)
        for j in each(joints):
            for i in each(len(error)):
                torque[j] -= share * room.gain[j, i] * error[i]
            for k in range(LONGEST_LATENESS + 1, 0, -1):
                m.commands[k, j] = m.commands[k - 1, j]
            m.commands[0, j] = minimum(maximum(torque[j], -s.limit[j]), s.limit[j])

    return command


def _target(m: Memory, room: Room, period: float, back: int, joint: int, drive: Any) -> tuple[Any, Any, Any, Any]:
    """Return θ_d, θ̇_d, θ̈_d and u_ff without dry friction, `back` samples ago with today's p; see `elastic_target`."""
    now, last = room.link_torque[back, joint], room.link_torque[back + 1, joint]
    second, third = room.link_torque[back + 2, joint], room.link_torque[back + 3, joint]
    rate = (11.0 * now - 18.0 * last + 9.0 * second - 2.0 * third) / (6.0 * period)
    curvature = (2.0 * now - 5.0 * last + 4.0 * second - third) / (period * period)
    b = drive.damping / drive.stiffness
    q, dq, ddq = m.references[back, 0, joint], m.references[back, 1, joint], m.references[back, 2, joint]
    velocity, acceleration = dq + (rate - b * curvature) / drive.stiffness, ddq + curvature / drive.stiffness
    angle = q + (now - b * (rate - b * curvature)) / drive.stiffness
    smooth = drive.motor_inertia * acceleration + drive.viscous_friction * velocity + now
    return angle, velocity, acceleration, smooth


@functools.cache
def _advance_of(physics: Physics) -> Any:
    """Return what fills the first of `one` of the room with x when the next command acts.

    That is x under the commands on their way.
    """
    hold = arm_functions(physics).hold

    def advance(z: Any, m: Memory, s: Settings, room: Room) -> None:
        state, torque, line, numbers = room.one
        joints, offset, lateness = len(torque), len(z) - 1 - len(torque), z[len(z) - 1]
        for i in each(len(state)):
            state[i, 0] = z[i]
        for i in each(len(numbers)):
            numbers[i, 0] = room.numbers[i]
        for i in each(len(line)):
            line[i, 0] = room.line[i]
            for j in each(len(s.reopening)):
                line[i, 0] += room.directions[i, j] * z[len(state) + j]
        whole = floor(lateness)
        rest = lateness - whole
        for period in each(LONGEST_LATENESS + 1):  # whole periods, then the rest of one
            k = number(period)
            last = k == float(LONGEST_LATENESS)
            for _ in only((whole > k) & ~last | (last & (rest > 0.0))):
                for j in each(joints):
                    sent: Any = (1.0 - rest) * _sent(m.commands, whole - (k + 1.0), j)
                    sent = select(last, m.commands[0, j], sent + rest * _sent(m.commands, whole - k, j))
                    torque[j, 0] = sent + z[offset + j]
                hold(state, torque, line, numbers, select(last, rest * s.substep, s.substep), s.substeps)

    return advance


def mean_torque(commands: Any, lateness: Any, joint: Any) -> Any:
    """Return the mean torque [N m] of a joint over the coming period if commands act `lateness` periods late.

    `commands` (`LONGEST_LATENESS` + 2, n) [N m], newest first.
    """
    whole = floor(lateness)
    rest = lateness - whole
    return (1.0 - rest) * _sent(commands, whole, joint) + rest * _sent(commands, whole + 1.0, joint)


def _sent(commands: Any, place: Any, joint: Any) -> Any:
    """Return the torque [N m] at a place of the commands, without an index that depends on data."""
    torque = commands[0, joint]
    for k in range(1, len(commands)):
        torque = select(place == float(k), commands[k, joint], torque)
    return torque


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
                for j, tau in enumerate(link_torque(link, still, still, force, arm)):
                    bent[j] = tau
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
