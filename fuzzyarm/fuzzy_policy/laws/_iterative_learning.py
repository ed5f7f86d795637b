"""Classical iterative learning control around a `-tip` policy: a pass adds the last pass's feedback as feedforward.

    u_j(k) = u_ff(k) + v_j(k) + w_j(k),     w_(j+1) = Q (w_j + v_j),     w_1 = 0.

At sample k of pass j, u_ff is the feedforward, v_j the law's feedback, w_j the learned torque, and Q a zero-phase
Butterworth filter. Let T be the closed loop from a torque at the motors to -v_j. Then w_(j+1) = Q ((1 - T) w_j + T d)
for a torque d that repeats in every pass, which converges where |Q (1 - T)| < 1. The policy measures only the motors:
it moves them to their target for the unloaded arm, and does not correct the bending caused by a load.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from fuzzyarm.fuzzy_policy.policy import NOTHING_LEARNED, PassLearner

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

__all__ = ["LearnedTorque", "TorqueLearning", "low_passed"]

_CUT_OFF = 5.0  # Hz, cut-off frequency of Q; with 10 Hz and more the payload case diverges
_ORDER = 2
_PADDING = 60  # samples


@dataclasses.dataclass
class LearnedTorque:
    """The state of `TorqueLearning` between two samples."""

    memory: np.ndarray  # memory of the policy, (lanes, memory_size)
    learned: np.ndarray  # w of this pass [N m], (samples, lanes, n); empty in the first pass
    added: list[np.ndarray]  # w + v of each sample so far, (lanes, n)


class TorqueLearning(PassLearner):
    """A `-tip` policy that learns from repeated passes; the law is in the module's docstring."""

    policy: TipPolicy
    kind = LearnedTorque

    def __init__(self, policy: TipPolicy) -> None:
        self.policy = policy

    def begin_pass(self, state: LearnedTorque) -> LearnedTorque:
        """Return the state with which the next pass begins, see `PassLearner`; it keeps only the learned torques."""
        if not self._checked(state).added:
            raise ValueError(NOTHING_LEARNED)
        learned = low_passed(np.array(state.added), _CUT_OFF, self.policy.control_period)
        return dataclasses.replace(self._first(np.zeros_like(state.memory)), learned=learned)

    def _first(self, memory: np.ndarray) -> LearnedTorque:
        return LearnedTorque(memory, np.empty((0, len(memory), self.policy.joints)), [])

    def _go_on(self, seen: np.ndarray, state: LearnedTorque) -> np.ndarray:
        memory = state.memory.copy()
        feedback, feedforward = self.policy.feedback_and_feedforward(seen, memory)
        sample = min(len(state.added), len(state.learned) - 1)
        added = feedback if sample < 0 else feedback + state.learned[sample]
        torque = self._clipped(seen, feedforward + added)
        state.memory = memory
        state.added.append(added)
        return torque


def low_passed(signal: np.ndarray, cut_off: float, control_period: float) -> np.ndarray:
    """Return a signal (samples, ...) after a zero-phase Butterworth filter with a cut-off frequency [Hz]."""
    from scipy.signal import butter, sosfiltfilt  # slow to import, and looks for torch

    sections = butter(_ORDER, min(cut_off / (0.5 / control_period), 0.99), output="sos")
    return np.asarray(sosfiltfilt(sections, signal, axis=0, padlen=min(len(signal) - 1, _PADDING)))
