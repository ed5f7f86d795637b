"""The torque of the adaptive observer for an estimate z: target, feedforward and regulator; the law is in `policy`.

The regulator K is tabulated over posture and payload. `AdaptiveWeights` were tuned for the two-joint arm,
for which the table follows the mass matrix. If a robot's mass matrix depends on more angles than K, K is designed
for its mean over the others, and the loop may be unstable in part of the range, even with a known state. The
substitutions

    link_angle → s link_angle,    link_velocity → √s link_velocity,    first_gain → min(1, s first_gain)

with a factor s ≥ 1 weaken the feedback and the need for a soft start. s is the smallest of `SOFTENINGS` for which the
loop with a known state is stable at random postures, for 80 %, 100 % and 120 % of the modelled joint stiffness.

An episode begins with a fraction of K: with all of it, motors stronger or more delayed than modelled would oscillate
until the filter adapts.
"""

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.elementwise import sign
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.laws._elastic_target import motor_target
from fuzzyarm.fuzzy_policy.laws._gain_schedule import corners_of, loaded_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, KEPT, LONGEST_DELAY, AdaptiveWeights, Memory, mass_of
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Scratch, Settings, command, fill, numbers_at, sent
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    SOFTENINGS,
    Condition,
    LinearLaw,
    designed_for,
    feedback_gain,
    found_at,
    places_of,
    softened,
    worst_radius,
)
from fuzzyarm.numbers.functions import array, each, entry, floor, maximum, minimum, number, only, select

__all__ = ["act", "adaptive_weights_for", "feedback_table"]

_STIFFNESS = tuple(Condition(stiffness=factor) for factor in (0.8, 1.0, 1.2))  # for which a regulator must be stable
_HEAVIEST = 0.5  # largest payload of the table, as a share of the mass of all links
_PAYLOADS = 6


@functools.lru_cache(maxsize=32)
def adaptive_weights_for(arm: AnyArm, control_period: float) -> AdaptiveWeights:
    """Return the default weights for an arm and T [s]; for a robot they are softened as in the module's docstring."""
    weights = AdaptiveWeights()
    if not isinstance(arm, Robot):
        return weights
    trials: list[AdaptiveWeights] = [
        dataclasses.replace(softened(weights, s), first_gain=min(1.0, s * weights.first_gain)) for s in SOFTENINGS
    ]
    return next((trial for trial in trials if _largest_radius(arm, control_period, trial) < 1.0), trials[-1])


def _largest_radius(robot: Robot, control_period: float, weights: AdaptiveWeights) -> float:
    """Return the sampled loop's largest |eigenvalue| at random postures; inf if a Riccati equation has no solution."""
    places, joints = places_of(robot, control_period), len(robot)
    gains = feedback_gain(robot, control_period, designed_for(robot, places), weights)
    laws = (LinearLaw(-K, np.empty((joints, 0)), np.empty((0, 4 * joints)), np.empty((0, 0))) for K in gains)
    return max(worst_radius(place, law, _STIFFNESS) for place, law in zip(places, laws, strict=True))


@functools.lru_cache(maxsize=8)
def feedback_table(arm: AnyArm, control_period: float, weights: AdaptiveWeights) -> np.ndarray:
    """Return a table (payloads · postures, n · 4 n) of the regulator K [N m/rad, N m s/rad].

    Each row is a K (n, 4 n), flattened; all postures of a payload have consecutive rows.
    """
    schedule, gains = schedule_of(arm), []
    for mass in np.linspace(0.0, _HEAVIEST * mass_of(arm), _PAYLOADS):
        found = feedback_gain(arm, control_period, loaded_inertia(arm, schedule, float(mass)), weights)
        gains.append(found_at(schedule, found, control_period, weights).reshape(len(found), -1))
    table = np.concatenate(gains)
    table.flags.writeable = False
    return table


def _feedback_at(s: Settings, q: Any, payload: Any, gain: Any) -> None:
    """Fill `gain` with K (n, 4 n), interpolated at angles q (n,) [rad] and a payload relative to the links' mass."""
    place = minimum(maximum(payload / _HEAVIEST, 0.0), 1.0) * (_PAYLOADS - 1.0)
    lower = minimum(_PAYLOADS - 2.0, maximum(0.0, floor(place)))  # nan gives a row of the table, too
    low, corners, points = place - lower, corners_of(q, *s.schedule), s.feedback.shape[0] / _PAYLOADS
    for i in each(len(gain)):
        for k in each(gain.shape[1]):
            near: Any = 0.0
            far: Any = 0.0
            for corner, weight in corners:
                column = i * gain.shape[1] + k
                near = near + weight * entry(s.feedback, lower * points + corner, column)
                far = far + weight * entry(s.feedback, (lower + 1.0) * points + corner, column)
            gain[i, k] = (1.0 - low) * near + low * far


def _gain_share(m: Memory, s: Settings) -> Any:
    """Return the factor on K at this sample: `first_gain` in the soft start, then rising to 1 over an equal time.

    If an earlier pass has learned the motors' strength and delay, the factor is always 1.
    """
    past = (m.flags[FLAG.samples] - 1.0) / s.soft_samples - 1.0
    share = s.weights.first_gain + (1.0 - s.weights.first_gain) * minimum(maximum(past, 0.0), 1.0)
    return select(m.flags[FLAG.taught] != 0.0, 1.0, share)


def act(z: Any, m: Memory, s: Settings, room: Scratch, torque: Any) -> None:
    """Fill `torque` (n,) [N m] with the unclipped torque for the estimate z, or with nan if the filter has diverged.

    Before `predict`, the caller may replace the clipped torque ``m.commands[0]`` (n,) [N m] by the one commanded.
    """
    for j in each(len(torque)):
        torque[j] = math.nan
    for _ in only(m.flags[FLAG.lost] == 0.0):
        _desire(z, m, s, room)
        _advance(z, m, s, room)
        _command(z, m, s, room, torque)


def _desire(z: Any, m: Memory, s: Settings, room: Scratch) -> None:
    """Fill `room` for z with the arm's constants, and with τ_d and the direction of travel at each stored reference.

    `room.line` and `room.directions` are filled with force lines, see `Scratch`.
    """
    joints, (_, axes), known = len(m.noise), room.known.shape, room.known
    p = z[4 * joints :]
    numbers_at(p, s, room.numbers)
    next_q, next_dq, arm = array(joints), array(joints), room.arm.constants_in(room.numbers)
    for k in each(KEPT):
        q, dq, ddq = m.references[k, 0], m.references[k, 1], m.references[k, 2]
        travel = room.arm.tip_direction(q, dq, arm)
        force = [known[k, i] + p[0] * travel[i] + p[1 + i] for i in range(axes)]
        for i, along in enumerate(travel):
            room.travel[k, i] = along
        for j, tau in enumerate(room.arm.link_torque(q, dq, ddq, force, arm)):
            room.link_torque[k, j] = tau
    for j in each(joints):
        dq, ddq = m.references[0, 1, j], m.references[0, 2, j]
        next_q[j] = m.references[0, 0, j] + s.period * (dq + 0.5 * s.period * ddq)
        next_dq[j] = dq + s.period * ddq
    for i, along in enumerate(room.arm.tip_direction(next_q, next_dq, arm)):
        room.travel[KEPT, i] = along
    for i in range(axes):
        now, then = room.travel[0, i], room.travel[KEPT, i]
        room.directions[i, 0], room.directions[axes + i, 0] = 0.5 * (now + then), then - now
        room.line[i], room.line[axes + i] = 0.5 * (known[0, i] + known[KEPT, i]), known[KEPT, i] - known[0, i]


def _advance(z: Any, m: Memory, s: Settings, room: Scratch) -> None:
    """Fill `room.one.state` with x of the estimate z, advanced by earlier commands until this sample's command acts."""
    torque = room.one.torque
    joints, lateness = len(torque), z[len(z) - 1]
    offset, whole = len(z) - 1 - joints, floor(lateness)
    rest = lateness - whole
    fill(room.one, z, room)
    for period in each(LONGEST_DELAY + 1):  # whole periods, then the remaining fraction of a period
        k = number(period)
        last = k == float(LONGEST_DELAY)
        for _ in only((whole > k) & ~last | (last & (rest > 0.0))):
            for j in each(joints):
                mean: Any = (1.0 - rest) * sent(m.commands, whole - (k + 1.0), j)
                mean = select(last, m.commands[0, j], mean + rest * sent(m.commands, whole - k, j))
                torque[j, 0] = mean + z[offset + j]
            room.arm.hold(*room.one, select(last, rest * s.substep, s.substep), s.substeps)


def _command(z: Any, m: Memory, s: Settings, room: Scratch, torque: Any) -> None:
    """Fill `torque` (n,) [N m] for the time at which it will reach the motors; store it, clipped, in `m.commands`."""
    joints, period = len(m.noise), s.period
    p, state, error, gain = z[4 * joints :], room.one.state, array(4 * joints), array(joints, 4 * joints)
    lateness = p[len(p) - 1]
    later = lateness * period
    for j in range(joints):
        q, dq, ddq = m.references[0, 0, j], m.references[0, 1, j], m.references[0, 2, j]
        motor = room.arm.drive(room.numbers, j)
        theta, dtheta, ddtheta, smooth = _target(m, room, period, 0, j, motor)
        before = _target(m, room, period, 1, j, motor)[3]
        middle = dtheta + (0.5 * period + later) * ddtheta
        friction = stribeck_magnitude(middle, motor.dry_friction) * sign(middle)
        torque[j] = smooth + (0.5 + lateness) * (smooth - before) + friction
        torque[j] -= p[len(p) - 1 - joints + j]
        error[j] = state[j, 0] - (theta + later * (dtheta + 0.5 * later * ddtheta))
        error[joints + j] = state[joints + j, 0] - (q + later * (dq + 0.5 * later * ddq))
        error[2 * joints + j] = state[2 * joints + j, 0] - (dtheta + later * ddtheta)
        error[3 * joints + j] = state[3 * joints + j, 0] - (dq + later * ddq)
    _feedback_at(s, m.references[0, 0], p[len(s.reopening)] / s.mass, gain)
    share = _gain_share(m, s)
    for j in each(joints):
        for i in each(len(error)):
            torque[j] -= share * gain[j, i] * error[i]
    command(m, s, torque)


def _target(m: Memory, room: Scratch, period: float, back: int, joint: int, drive: Any) -> tuple[Any, Any, Any, Any]:
    q, dq, ddq = (m.references[back, order, joint] for order in range(3))
    torques = [room.link_torque[back + k, joint] for k in range(4)]
    return motor_target(torques, q, dq, ddq, drive, period)
