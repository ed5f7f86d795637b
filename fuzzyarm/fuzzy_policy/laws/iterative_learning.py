"""Classical iterative learning control around a `-tip` policy: the feedforward of a pass takes over the last feedback.

    u_j(k) = u_ff(k) + v_j(k) + w_j(k),     w_(j+1) = Q (w_j + v_j),     w_1 = 0.

v_j is what the law adds to its feedforward in pass j, w_j what has been learned, Q a Butterworth filter of no phase.
With T the closed loop from a torque at the motors to minus the law's answer, w_(j+1) = Q ((1 - T) w_j + T d) for a
repeating torque d, which converges where |Q (1 - T)| < 1. It measures the motors alone, as every policy: it brings the
motors to where they belong without load, and leaves the bending that a load adds.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from fuzzyarm.common.checks import shown
from fuzzyarm.fuzzy_policy.policy import checked_observation, no_torque

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

__all__ = ["LearnedTorque", "TorqueLearning"]

CUT_OFF = 5.0  # Hz, of Q; with 10 Hz and more the payload case diverges
ORDER = 2
PADDING = 60  # samples


@dataclasses.dataclass
class LearnedTorque:
    """A state between two samples.

    Attributes:
        memory: of the policy, (lanes, memory_size).
        learned: w of this pass [N m], (samples, lanes, n); empty: none.
        added: w + v of each sample so far, (lanes, n).
    """

    memory: np.ndarray
    learned: np.ndarray
    added: list[np.ndarray]


class TorqueLearning:
    """A `-tip` policy over one path again and again; the law is in the module's docstring.

    Attributes:
        policy: the `-tip` policy.
    """

    def __init__(self, policy: TipPolicy) -> None:
        """Keep the policy."""
        self.policy = policy

    def predict(
        self,
        observation: np.ndarray,
        state: LearnedTorque | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, LearnedTorque]:
        """Return the torques [N m] and the next state; None begins a first pass, `begin_pass` a further one.

        Args:
            observation: (numbers,) or (lanes, numbers), as the policy takes it.
            state: None, or what the last call or `begin_pass` returned; it goes on in place, unless an error is raised.
            episode_start: ignored; a pass begins with its state.
            deterministic: ignored.

        Raises:
            TypeError: the observation holds something else than real numbers, or the state is none of these.
            ValueError: an argument has a wrong shape; a number of the observation is not finite, or so large that no
                torque follows.
        """
        seen = checked_observation(observation, self.policy.joints)
        lanes, own = len(seen), self.policy.memory_size
        state = _first(np.zeros((lanes, own)), np.empty((0, lanes, self.policy.joints))) if state is None else state
        memory = _checked(state).memory.copy()
        if memory.shape != (lanes, own):
            raise ValueError(f"state has a memory of shape {memory.shape}; needed: {(lanes, own)}")
        feedback, feedforward = self.policy.feedback_and_feedforward(seen, memory)
        sample = min(len(state.added), len(state.learned) - 1)
        added = feedback if sample < 0 else feedback + state.learned[sample]
        torque = self.policy.clipped(feedforward + added)
        if np.isnan(torque).any():
            raise no_torque(seen)
        state.memory = memory
        state.added.append(added)
        return (torque[0] if np.ndim(observation) == 1 else torque), state

    def begin_pass(self, state: LearnedTorque) -> LearnedTorque:
        """Return the state with which the next pass over the same path begins.

        It keeps the learned torques alone.

        Raises:
            TypeError: the state is not what `predict` returned.
            ValueError: it has seen no sample.
        """
        if not _checked(state).added:
            raise ValueError("there is no pass to learn from: call predict along the path before begin_pass")
        from scipy.signal import butter, sosfiltfilt  # slow to import, and looks for torch

        sections = butter(ORDER, min(2.0 * CUT_OFF * self.policy.control_period, 0.99), output="sos")
        added = np.array(state.added)
        learned = sosfiltfilt(sections, added, axis=0, padlen=min(len(added) - 1, PADDING))
        return _first(np.zeros_like(state.memory), learned)


def _checked(state: LearnedTorque) -> LearnedTorque:
    """Return a state, once it is one."""
    if not isinstance(state, LearnedTorque):
        raise TypeError(f"state = {shown(state)} must be the LearnedTorque that predict or begin_pass returned")
    return state


def _first(memory: np.ndarray, learned: np.ndarray) -> LearnedTorque:
    return LearnedTorque(memory, learned, [])
