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
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import confine, correct, numbers_at, predict_of, read_noise
from fuzzyarm.fuzzy_policy.laws.adaptive.forces import doubt_lateness, doubt_scale, note_moves, spread_out
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import ENOUGH, FLAG, KEPT, LONGEST_LATENESS, ORDERS, Memory, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room, room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.adaptive.significance import significant

__all__ = ["MISTRUST", "NOISE_SHARE", "begin_of", "law_of", "predict_with", "steps_of"]

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits
NOISE_SHARE = 0.03  # of a sample, in the estimated noise of the encoders, once there have been enough
MISTRUST = 8.0  # least variance of a measured angle that is expected, in variances of the noise that is read
SURPRISE_SHARE = 0.02  # of a sample, in the mean surprise
DIVERGED = 50.0  # mean surprise at which a filter counts as diverged


@functools.cache
def law_of(physics: Physics) -> Any:
    """Return the kernel ``law(observation, memory, torque, known, settings)`` for arms with these equations.

    It fills `torque` (lanes, n) [N m], not clipped, and advances `memory`; nan for lanes whose filter has diverged.
    `known` (lanes, `KEPT` + 1, axes) is a tip force [N] known beforehand, which the estimated one adds to: at this
    sample, at those before it, and at the next one.
    """
    estimate, predict = steps_of(physics)

    @kernel_for(physics.digest)
    def estimate_and_act(
        observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, known: np.ndarray, settings: Settings
    ) -> None:
        """See `law_of`."""
        joints, s = torque.shape[1], settings
        room, o = room_for(s), observed(observation)
        for lane in range(len(observation)):
            m = remembered(memory[lane], joints, len(s.guess), len(s.reopening))
            estimate(lane, o, m, s, room, known[lane], torque[lane])
            predict(m, s, room, torque[lane])

    return estimate_and_act


@functools.cache
def steps_of(physics: Physics) -> tuple[Any, Any]:
    """Return the two compiled halves of a lane's sample, before and after its torque is known.

        ``estimate(lane, o, m, s, room, known, torque)`` corrects, and fills `torque` (n,) [N m] with what the law asks
        for; nan where the filter has diverged.
        ``predict(m, s, room, torque)`` predicts the next sample; the filter diverges where `torque` is no number.

    Between them ``m.commands[0]`` (n,) may be set to the torque [N m] that is commanded instead.
    """
    begin, act, advance = begin_of(physics), act_of(physics), predict_with(physics)

    @register_jitable
    def estimate(
        lane: int, o: Observation, m: Memory, s: Settings, room: Room, known: np.ndarray, torque: np.ndarray
    ) -> None:
        for j in range(len(torque)):
            torque[j] = np.nan
        if m.flags[FLAG.lost] == 0.0:
            begin(lane, o, m, s, room)
            _correct(m, s, room)
            if m.flags[FLAG.lost] == 0.0:
                act(significant(m, s, room), s, room, known, torque)

    @register_jitable
    def predict(m: Memory, s: Settings, room: Room, torque: np.ndarray) -> None:
        if m.flags[FLAG.lost] == 0.0:
            advance(m, s, room)
            total = 0.0
            for j in range(len(torque)):
                total += torque[j]
            if not np.isfinite(total):
                m.flags[FLAG.lost] = 1.0

    return estimate, predict


@functools.cache
def begin_of(physics: Physics) -> Any:
    """Return the compiled function that takes in what is measured and asked for, and begins with the first sample.

    The first z and P: K_t (θ - q) = g(q) for the measured θ, links as fast as motors, p_0.
    """
    _, link_torque, _, drive = arm_functions(physics)

    @register_jitable
    def begin(m: Memory, s: Settings, room: Room) -> None:
        joints = len(m.noise)
        states, forces = 4 * joints, len(s.reopening)
        # What an earlier pass has taught is kept, but for the loads, which begin anew.
        if m.flags[FLAG.taught] != 0.0:
            _forget(m, s, states + forces)
        else:
            _forget(m, s, len(m.z))
        still, bent, link, force = room.joints[0], room.joints[1], m.z[joints : 2 * joints], room.travel[0]
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

    @register_jitable
    def begin_or_follow(lane: int, o: Observation, m: Memory, s: Settings, room: Room) -> None:
        joints = len(m.noise)
        for j in range(joints):
            room.measured[j], room.measured[joints + j] = o.q_motor[lane, j], o.dq_motor[lane, j]
            for k in range(KEPT - 1, 0, -1):
                for order in range(ORDERS):
                    m.references[k, order, j] = m.references[k - 1, order, j]
            m.references[0, 0, j], m.references[0, 1, j] = o.q_reference[lane, j], o.dq_reference[lane, j]
            m.references[0, 2, j] = o.ddq_reference[lane, j]
        if m.flags[FLAG.samples] == 0.0:
            begin(m, s, room)
        m.flags[FLAG.samples] = min(m.flags[FLAG.samples] + 1.0, ENOUGH)

    return begin_or_follow


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
def _noise_share(samples: float, first: float) -> float:
    """Return the share of a sample in the noise: a mean of all, until that is `NOISE_SHARE`.

    The first change of e is that of the third sample; no share is larger than `first`.
    """
    return min(max(NOISE_SHARE, 1.0 / (samples - 2.0)), first) if samples > 2.0 else 0.0


@register_jitable
def _correct(m: Memory, s: Settings, room: Room) -> None:
    """Correct z by what is measured, and note how well that fitted."""
    joints, measured, forces = len(m.noise), room.measured, len(s.reopening)
    share = _noise_share(m.flags[FLAG.samples], s.first_share)
    read_noise(measured, m.read, m.noise, share, s.substep * s.substeps)
    for j in range(joints):
        ratio = s.variances[joints + j] / s.variances[j]
        room.silent[j] = s.dead_zone * m.noise[j]
        room.silent[joints + j] = room.silent[j] * ratio
        room.variances[j] = max(s.variances[j], MISTRUST * m.noise[j])
        room.variances[joints + j] = room.variances[j] * ratio
    states, before = 4 * joints, room.moved
    for i in range(forces):
        before[i] = m.z[states + i]
    surprise = correct(m.z, m.P, measured, room.variances, room.silent, s.cautious, s.gate, room.column)
    m.flags[FLAG.surprise] += SURPRISE_SHARE * (surprise - m.flags[FLAG.surprise])
    doubt_lateness(m, s, surprise)
    doubt_scale(m, s, surprise)
    note_moves(m, s, before)
    confine(m.z, m.P, s.low, s.high)
    total_z = total_P = 0.0
    for i in range(len(m.z)):
        total_z += m.z[i]
        for j in range(len(m.z)):
            total_P += m.P[i, j]
    if not (m.flags[FLAG.surprise] < DIVERGED and np.isfinite(total_z + total_P)):
        m.flags[FLAG.lost] = 1.0


@functools.cache
def predict_with(physics: Physics) -> Any:
    """Return the compiled step of z and P to the next sample, under the commands that reach the motors until then."""
    step = predict_of(physics)

    @register_jitable
    def predict(m: Memory, s: Settings, room: Room) -> None:
        joints, size = len(m.noise), len(m.z)
        numbers_at(m.z[4 * joints :], s.guess, s.base, s.slopes, room.numbers)
        lateness, wide = m.z[size - 1], np.sqrt(max(m.P[size - 1, size - 1], 0.0))
        early, late = max(lateness - wide, 0.0), min(lateness + wide, float(LONGEST_LATENESS))
        applied, slope = room.joints[0], room.joints[1]
        for j in range(joints):
            applied[j] = mean_torque(m.commands, lateness, j)
            change = mean_torque(m.commands, late, j) - mean_torque(m.commands, early, j)
            slope[j] = change / max(late - early, 1e-9)
        step(
            m.z,
            m.P,
            applied,
            slope,
            room.line,
            room.directions,
            room.numbers,
            s.slopes,
            s.steps,
            s.noise,
            s.substep,
            s.substeps,
            room.lanes,
        )
        spread_out(m, s)

    return predict
