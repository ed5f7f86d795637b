"""The adaptive observer with its adaptation frozen: the loop whose margins `fuzzyarm margins` measures.

The constants of the arm, the payload and the lateness stay at p_0; state and tip force are corrected with the gains
that the filter has along the paper's path without load or noise, taken at the nearest posture:

    (x, F) ← (x, F) + L (y - (θ, θ̇)).

The force along the path is part of F, in the direction of travel there. This is a linear loop at a posture, which the
adapting one is not: with its adaptation on, the policy bears more, and for as long as it is excited.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics, tip_jacobian
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import hold
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import BELIEF, BELIEFS, FORCES, SPACE, affine_constants
from fuzzyarm.fuzzy_policy.laws.adaptive.law import act_on_estimate, begin_or_follow
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import KEPT, layout, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.room import room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.policy import Policy

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

__all__ = ["FrozenObserver"]

_STATES = 4 * JOINTS
_MEMORY = layout(JOINTS, BELIEFS)
_MEASURED = np.r_[0:JOINTS, 2 * JOINTS : 3 * JOINTS]
_EVERY = 50  # control periods between two instants whose gains are kept
_TENTH = 0.1  # of the path, left out at either end, where the motors stick


class FrozenObserver(Policy):
    """The frozen loop; see the module's docstring."""

    memory_size = _MEMORY.noise.stop

    def __init__(self, policy: AdaptiveObserverPolicy, *, dry_friction: bool = True) -> None:
        """Take the gains that `policy` has along the paper's path.

        Args:
            policy: whose adaptation is frozen.
            dry_friction: whether the arm that it predicts has dry friction.
        """
        super().__init__(policy.parameters, policy.control_period)
        self._postures, self._gains = _gains_along_path(policy)
        arm = policy.arm
        if not dry_friction:
            arm = dataclasses.replace(arm, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
        base, slopes = affine_constants(arm)
        self._settings = policy.settings._replace(base=base, slopes=slopes)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        _follow(observation, memory, torque, self._settings, self._postures, self._gains)


def _gains_along_path(policy: AdaptiveObserverPolicy) -> tuple[np.ndarray, np.ndarray]:
    """Return postures (k, n) and the gains there (k, 4 n + components of a force, 2 n)."""
    arm, period = policy.arm, policy.control_period
    reference = default_reference(arm)
    steps = int(reference.duration / period)
    motion = reference.sample(period * np.arange(steps))
    bent = rigid_inverse_dynamics(motion.q[0], motion.dq[0], motion.ddq[0], arm_constants(arm)) / arm.stiffness
    measured, state = np.concatenate([motion.q[0] + bent, np.zeros(JOINTS)]), None
    variances, postures, gains = np.diag(policy.settings.variances), [], []
    for k in range(steps):
        _, state = policy.predict(np.concatenate([measured, motion.q[k], motion.dq[k], motion.ddq[k]]), state)
        measured = state[_MEMORY.z][_MEASURED]
        if k % _EVERY == 0 and _TENTH * steps < k < (1.0 - _TENTH) * steps:
            P = state[_MEMORY.P].reshape(_STATES + BELIEFS, -1)[:, _MEASURED]
            gain = P @ np.linalg.inv(P[_MEASURED] + variances)
            velocity = tip_jacobian(motion.q[k], arm.length) @ motion.dq[k]
            travel = velocity / np.linalg.norm(velocity)
            force = gain[_STATES:][BELIEF.force] + np.outer(travel, gain[_STATES])
            postures.append(motion.q[k])
            gains.append(np.concatenate([gain[:_STATES], force]))
    return np.array(postures), np.array(gains)


@kernel
def _follow(
    observation: np.ndarray,
    memory: np.ndarray,
    torque: np.ndarray,
    settings: Settings,
    postures: np.ndarray,
    gains: np.ndarray,
) -> None:
    """Correct with fixed gains, act and predict in every lane."""
    joints = torque.shape[1]
    states, room, o = 4 * joints, room_for(joints, len(settings.spread), len(settings.base)), observed(observation)
    nothing = np.zeros((KEPT + 1, SPACE))
    for lane in range(len(observation)):
        m = remembered(memory[lane], joints, len(settings.guess))
        begin_or_follow(lane, o, m, settings, room)
        m.z[states] = 0.0
        m.z[states + FORCES :] = settings.guess[FORCES:]
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
        act_on_estimate(m, settings, room, nothing, torque[lane])
        state, held, line, constants = room.one
        state[:, 0], constants[:, 0], held[:, 0], line[:, 0] = m.z[:states], room.constants, m.commands[0], 0.0
        for i in range(FORCES - 1):
            line[i, 0] = m.z[states + 1 + i]
        hold(state, held, line, constants, settings.substep, settings.substeps)
        m.z[:states] = state[:, 0]
