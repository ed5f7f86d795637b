"""The adaptive observer with its adaptation frozen: the loop whose margins `fuzzyarm margins` measures.

The constants of the arm, the payload and the lateness stay at p_0; state and tip force are corrected with the gains
that the filter has along the paper's path without load or noise, taken at the nearest posture:

    (x, F) ← (x, F) + L (y - (θ, θ̇)).

The force along the path is part of F, in the direction of travel there. This is a linear loop at a posture, which the
adapting one is not: with its adaptation on, the policy bears more, and for as long as it is excited.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, travel_of, without_dry_friction
from fuzzyarm.fuzzy_policy.laws.adaptive.acting import act_of
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import arm_functions
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import affine_numbers
from fuzzyarm.fuzzy_policy.laws.adaptive.law import begin_of, take_in
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, KEPT, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.room import room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.policy import Policy

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

__all__ = ["FrozenObserver"]

_EVERY = 50  # control periods between two instants whose gains are kept
_TENTH = 0.1  # of the path, left out at either end, where the motors stick


class FrozenObserver(Policy):
    """The frozen loop; see the module's docstring."""

    def __init__(self, policy: AdaptiveObserverPolicy, *, dry_friction: bool = True) -> None:
        """Take the gains that `policy` has along the paper's path.

        Args:
            policy: whose adaptation is frozen.
            dry_friction: whether the arm that it predicts has dry friction.
        """
        super().__init__(policy.parameters, policy.control_period)
        self._postures, self._gains = _gains_along_path(policy)
        self.memory_size = policy.memory.noise.stop
        base, slopes = affine_numbers(policy.arm if dry_friction else without_dry_friction(policy.arm))
        self._settings = policy.settings._replace(base=base, slopes=slopes, first_gain=1.0)

    @functools.cached_property
    def _law(self) -> Any:
        return _law_of(equations_of(self.parameters))

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        self._law(observation, memory, torque, self._settings, self._postures, self._gains)


def _gains_along_path(policy: AdaptiveObserverPolicy) -> tuple[np.ndarray, np.ndarray]:
    """Return postures (k, n) and the gains there (k, 4 n + components of a force, 2 n)."""
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
            gain = P @ np.linalg.inv(P[seen] + variances)
            travel = travel_of(arm, motion.q[k], motion.dq[k])
            force = gain[states:][policy.belief.force] + np.outer(travel, gain[states])
            postures.append(motion.q[k])
            gains.append(np.concatenate([gain[:states], force]))
    return np.array(postures), np.array(gains)


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the kernel that corrects with fixed gains, acts and predicts in every lane."""
    begin, act, hold = begin_of(physics), act_of(physics), arm_functions(physics).hold

    @kernel_for(physics.digest)
    def follow(
        observation: np.ndarray,
        memory: np.ndarray,
        torque: np.ndarray,
        settings: Settings,
        postures: np.ndarray,
        gains: np.ndarray,
    ) -> None:
        """See `_law_of`."""
        joints, forces = torque.shape[1], len(settings.reopening)
        states, room, o = 4 * joints, room_for(settings), observed(observation)
        nothing = np.zeros((KEPT + 1, forces - 1))
        for lane in range(len(observation)):
            m = remembered(memory[lane], joints, len(settings.guess), forces)
            take_in(lane, o, m, room)
            begin(m, settings, room)
            m.flags[FLAG.lost] = 0.0  # it has no filter that could diverge, whatever is remembered
            m.z[states] = 0.0
            for i in range(forces, len(settings.guess)):
                m.z[states + i] = settings.guess[i]
            nearest = 0
            for k in range(len(postures)):
                if np.sum((postures[k] - o.q_reference[lane]) ** 2) < np.sum(
                    (postures[nearest] - o.q_reference[lane]) ** 2
                ):
                    nearest = k
            gain = gains[nearest]
            for j in range(joints):
                room.measured[j] -= m.z[j]
                room.measured[joints + j] -= m.z[2 * joints + j]
            for i in range(len(gain)):
                at = i if i < states else i + 1  # the force along the path is part of the free one
                for k in range(2 * joints):
                    m.z[at] += gain[i, k] * room.measured[k]
            act(m.z, m, settings, room, nothing, torque[lane])
            state, held, line, numbers = room.one
            for i in range(states):
                state[i, 0] = m.z[i]
            for i in range(len(numbers)):
                numbers[i, 0] = room.numbers[i]
            for j in range(joints):
                held[j, 0] = m.commands[0, j]
            for i in range(len(line)):
                line[i, 0] = m.z[states + 1 + i] if i < forces - 1 else 0.0
            hold(state, held, line, numbers, settings.substep, settings.substeps)
            for i in range(states):
                m.z[i] = state[i, 0]

    return follow
