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

from fuzzyarm.envs.observation import PARTS

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
            state: None, or what the last call or `begin_pass` returned; it goes on in place.
            episode_start: ignored; a pass begins with its state.
            deterministic: ignored.
        """
        seen = np.array(observation, dtype=np.float64, ndmin=2)
        if state is None:
            state = _first(
                np.zeros((len(seen), self.policy.memory_size)), np.empty((0, len(seen), seen.shape[1] // PARTS))
            )
        feedback, feedforward = self.policy.feedback_and_feedforward(seen, state.memory)
        sample = min(len(state.added), len(state.learned) - 1)
        added = feedback if sample < 0 else feedback + state.learned[sample]
        state.added.append(added)
        torque = self.policy.clipped(feedforward + added)
        return (torque[0] if np.ndim(observation) == 1 else torque), state

    def begin_pass(self, state: LearnedTorque) -> LearnedTorque:
        """Return the state with which the next pass over the same path begins.

        Raises:
            ValueError: the state has seen no sample.
        """
        if not state.added:
            raise ValueError("there is no pass to learn from: call predict along the path before begin_pass")
        from scipy.signal import butter, sosfiltfilt  # slow to import, and looks for torch

        sections = butter(ORDER, min(2.0 * CUT_OFF * self.policy.control_period, 0.99), output="sos")
        added = np.array(state.added)
        learned = sosfiltfilt(sections, added, axis=0, padlen=min(len(added) - 1, PADDING))
        return _first(np.zeros_like(state.memory), learned)


def _first(memory: np.ndarray, learned: np.ndarray) -> LearnedTorque:
    return LearnedTorque(memory, learned, [])
