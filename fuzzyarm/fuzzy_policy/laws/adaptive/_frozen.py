"""The adaptive observer with its adaptation frozen: the loop whose margins `fuzzyarm margins` measures.

The constants of the arm, the payload and the delay stay at p_0. State and tip force are corrected with the filter's
gains, recorded along the paper's path without load or noise, at the nearest posture:

    (x, F) ← (x, F) + L (y - (θ, θ̇)).

F is the whole tip force: the filter's free force, plus its force along the path in the direction of travel at that
posture. Unlike the adapting loop, this loop is linear at a posture.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, travel_of, without_dry_friction
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, Memory, affine_numbers, places
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Scratch, Settings, begin, fill, take_in
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import act
from fuzzyarm.numbers.functions import array, each, only, row
from fuzzyarm.numbers.linear import solved

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

__all__ = ["FrozenObserver"]

_EVERY = 50  # control periods between two recorded gains
_TENTH = 0.1  # share of the path left out at each end, where the motors stick


class FrozenObserver(LawPolicy):
    """The adaptive observer without adaptation; see the module's docstring."""

    def __init__(self, policy: AdaptiveObserverPolicy) -> None:
        """Use the gains of `policy` along the paper's path, and predict with an arm without dry friction."""
        super().__init__(policy.parameters, policy.control_period)
        self._postures, self._gains = _gains_along_path(policy)
        self.memory_size = policy.memory.noise.stop
        base, slopes = affine_numbers(without_dry_friction(policy.arm))
        whole = dataclasses.replace(policy.weights, first_gain=1.0)
        self._settings = policy.settings.replaced(base=base, slopes=slopes, weights=whole)

    @functools.cached_property
    def control_law(self) -> Law:
        """The law with recorded gains; its memory is a `Memory`."""
        physics, settings = equations_of(self.parameters), self._settings

        def frozen(m: Memory, seen: Observation, _: Any, *tables: Any) -> tuple[Memory, Any]:
            return m, _follow(physics, m, seen, settings.with_tables(tables[:-2]), *tables[-2:])

        gains = self._gains.reshape(len(self._gains), -1)
        return Law(frozen, places(physics), (), (*settings.tables, self._postures, np.ascontiguousarray(gains)))


def _gains_along_path(policy: AdaptiveObserverPolicy) -> tuple[np.ndarray, np.ndarray]:
    """Return postures (k, n) [rad] and the gains at these postures (k, 4 n + components of a force, 2 n)."""
    arm, period, joints, states = policy.arm, policy.control_period, policy.joints, 4 * policy.joints
    reference = default_reference(arm)
    steps = int(reference.duration / period)
    motion = reference.sample(period * np.arange(steps))
    first = motion.q[0], motion.dq[0], motion.ddq[0]
    if isinstance(arm, Robot):
        held = inverse_dynamics(arm, *first)
    else:
        held = rigid_inverse_dynamics(*first, arm_constants(arm))
    seen = np.r_[0:joints, 2 * joints : 3 * joints]
    measured, state = np.concatenate([first[0] + held / per_joint_of(arm, "stiffness"), np.zeros(joints)]), None
    variances, postures, gains = np.diag(policy.settings.variances), [], []
    for k in range(steps):
        _, state = policy.predict(np.concatenate([measured, motion.q[k], motion.dq[k], motion.ddq[k]]), state)
        measured = state[policy.memory.z][seen]
        if k % _EVERY == 0 and _TENTH * steps < k < (1.0 - _TENTH) * steps:
            P = state[policy.memory.P].reshape(len(policy.settings.spread), -1)[:, seen]
            gain = solved(P[seen] + variances, P.T).T
            travel = travel_of(arm, motion.q[k], motion.dq[k])
            force = gain[states:][policy.belief.force] + np.outer(travel, gain[states])
            postures.append(motion.q[k])
            gains.append(np.concatenate([gain[:states], force]))
    return np.array(postures), np.array(gains)


def _follow(physics: Physics, m: Memory, seen: Observation, s: Settings, postures: Any, gains: Any) -> Any:
    """Correct m with the gains at the nearest posture, act and predict; return the torque (n,) [N m]."""
    joints, states, forces, room = physics.joints, 4 * physics.joints, len(s.reopening), Scratch(physics, s)
    torque, nearest, one = array(joints), array(2), room.one
    take_in(m, room, seen)
    begin(m, s, room)
    m.flags[FLAG.lost] = 0.0  # no filter can diverge here, whatever the memory says
    m.z[states] = 0.0
    for i in each(len(s.guess) - forces):
        m.z[states + forces + i] = s.guess[forces + i]
    nearest[0], nearest[1] = 0.0, math.inf  # index of the nearest posture, and the square of its distance
    for k in range(len(postures)):
        square: Any = 0.0
        for j in range(joints):
            away = postures[k, j] - seen.q_reference[j]
            square = square + away * away
        for _ in only(square < nearest[1]):
            nearest[0], nearest[1] = float(k), square
    gain = row(gains, nearest[0])
    for j in range(joints):
        room.measured[j] -= m.z[j]
        room.measured[joints + j] -= m.z[2 * joints + j]
    for i in range(len(gain) // (2 * joints)):
        at = i if i < states else i + 1  # the force along the path is part of the free force
        for k in range(2 * joints):
            m.z[at] += gain[i * 2 * joints + k] * room.measured[k]
    act(m.z, m, s, room, torque)
    fill(one, m.z, room)
    for j in range(joints):
        one.torque[j, 0] = m.commands[0, j]
    room.arm.hold(*one, s.substep, s.substeps)
    for i in each(states):
        m.z[i] = one.state[i, 0]
    return tuple(torque[j] for j in range(joints))
