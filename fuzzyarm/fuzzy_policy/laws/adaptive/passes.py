"""Again over the same path: what the adaptive observer learns of the load in one pass, it expects in the next.

A pass is an episode along one reference. Beside its filter, a state keeps of every sample the estimated force at the
tip and its variances. `begin_pass` makes of them the force that is expected at every sample of the next pass: the force
that was expected plus the estimated ones, smoothed backward in time (Rauch, Tung and Striebel, each force alone),

    x_s(k) = x(k) + P(k)/(P(k) + Q) (x_s(k+1) - x(k)),

and then by a Butterworth filter of no phase. The constants of the arm, the payload and the lateness go on where they
were, with `FORGETTING` times their standard deviation, at most the first one.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from fuzzyarm.envs.observation import PARTS, observed
from fuzzyarm.fuzzy_policy.known_arm import travel_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import forces_in
from fuzzyarm.fuzzy_policy.laws.adaptive.forces import walk_share
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, KEPT

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy, Beliefs

__all__ = ["AdaptivePasses", "PassState"]

FORGETTING = 0.5
CUT_OFF = 50.0  # Hz, of the Butterworth filter of the expected force
ORDER = 2
SAME_PATH = 1e-6  # rad; a reference that differs more from that of the pass before is another path


@dataclasses.dataclass
class PassState:
    """A state between two samples, of one arm or of lanes.

    Attributes:
        memory: of the policy, (lanes, memory_size).
        expected: tip force [N] that is expected at the samples of this pass, (samples, lanes, axes); empty: none.
        path: q_d of the pass before, (samples, lanes, n).
        references: q_d of the samples so far.
        forces: estimated f_t and F after each sample so far [N], (lanes, 1 + axes) each.
        variances: theirs.
        calm: how calm the forces were, see `forces`, (lanes,) each.
        travels: directions of travel, (lanes, axes) each.
        other_path: whether a lane has left the path of the pass before: it expects nothing any more.
    """

    memory: np.ndarray
    expected: np.ndarray
    path: np.ndarray
    references: list[np.ndarray]
    forces: list[np.ndarray]
    variances: list[np.ndarray]
    calm: list[np.ndarray]
    travels: list[np.ndarray]
    other_path: np.ndarray


class AdaptivePasses:
    """The adaptive observer over one path again and again; `predict` as every policy's, its state a `PassState`.

    Attributes:
        policy: the adaptive observer.
    """

    def __init__(self, policy: AdaptiveObserverPolicy) -> None:
        """Keep the policy."""
        self.policy = policy
        self._states, self._forces = 4 * policy.joints, forces_in(policy.belief)
        self._load = slice(self._states, self._states + self._forces)  # in z
        size = len(policy.settings.spread)
        self._diagonal = policy.memory.P.start + (self._states + np.arange(self._forces)) * (size + 1)

    def predict(
        self,
        observation: np.ndarray,
        state: PassState | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, PassState]:
        """Return the torques [N m] and the next state; None begins a first pass, `begin_pass` a further one.

        Args:
            observation: (5 n,) or (lanes, 5 n).
            state: None, or what the last call or `begin_pass` returned; it goes on in place.
            episode_start: ignored; a pass begins with its state.
            deterministic: ignored.

        Raises:
            ValueError: an argument has a wrong shape.
        """
        seen = np.array(observation, dtype=np.float64, ndmin=2)
        lanes, size = len(seen), PARTS * self.policy.joints
        if seen.ndim > 2 or seen.shape[1] != size:
            raise ValueError(f"observation has shape {np.shape(observation)}; allowed: ({size},) or (lanes, {size})")
        if state is None:
            state = self._first(np.zeros((lanes, self.policy.memory_size)))
        if len(state.memory) != lanes:
            raise ValueError(f"the state is that of {len(state.memory)} lanes, the observation has {lanes}")
        q = observed(seen).q_reference.copy()
        sample = len(state.references)
        if sample < len(state.path):
            state.other_path |= np.abs(q - state.path[sample]).max(axis=1) > SAME_PATH
        torque = np.empty((lanes, self.policy.joints))
        self.policy.act_with(seen, state.memory, torque, _window(state, sample))
        state.references.append(q)
        state.forces.append(state.memory[:, self.policy.memory.z][:, self._load].copy())
        state.variances.append(state.memory[:, self._diagonal].copy())
        state.calm.append(state.memory[:, FLAG.calm].copy())
        state.travels.append(travel_of(self.policy.arm, q, observed(seen).dq_reference))
        torque = self.policy.clipped(torque)
        return (torque[0] if np.ndim(observation) == 1 else torque), state

    def begin_pass(self, state: PassState) -> PassState:
        """Return the state with which the next pass over the same path begins.

        Raises:
            ValueError: the state has seen no sample.
        """
        if not state.references:
            raise ValueError("there is no pass to learn from: call predict along the path before begin_pass")
        memory = np.zeros_like(state.memory)
        usable = (state.memory[:, FLAG.lost] == 0.0) & ~state.other_path
        memory[usable, FLAG.taught] = 1.0
        memory[:, self.policy.memory.z] = state.memory[:, self.policy.memory.z]
        memory[:, self.policy.memory.P] = self._loosened(state.memory[:, self.policy.memory.P])
        memory[~usable] = 0.0
        expected = self._smoothed(state) * usable[:, np.newaxis]
        return dataclasses.replace(self._first(memory), expected=expected, path=np.array(state.references))

    def beliefs(self, state: PassState) -> Beliefs:
        """Return what is believed after the last sample, the expected force included; of lanes, also of one."""
        found = self.policy.beliefs(state.memory)
        return dataclasses.replace(found, force=found.force + _window(state, len(state.references) - 1)[:, 0])

    def _first(self, memory: np.ndarray) -> PassState:
        lanes = len(memory)
        expected, path = np.empty((0, lanes, self._forces - 1)), np.empty((0, lanes, self.policy.joints))
        return PassState(memory, expected, path, [], [], [], [], [], np.zeros(lanes, dtype=bool))

    def _loosened(self, covariance: np.ndarray) -> np.ndarray:
        """Return covariances (lanes, N²) with `FORGETTING` times their standard deviations, at most the first ones."""
        first = self.policy.settings.spread
        P = covariance.reshape(len(covariance), len(first), len(first))
        deviation = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 1e-300))
        factor = np.minimum(FORGETTING, first / deviation)
        return np.asarray(P * factor[:, :, np.newaxis] * factor[:, np.newaxis, :]).reshape(len(P), -1)

    def _smoothed(self, state: PassState) -> np.ndarray:
        """Return the force (samples, lanes, axes) that the next pass may expect."""
        settings = self.policy.settings
        # What P gained at each sample: the walk to the next one, and where calm went, what it was opened by.
        calm = np.array(state.calm)[..., np.newaxis]
        walk = walk_share(calm, settings.calm_walk) ** 2 * settings.noise[self._load]
        walk[1:] += np.maximum(calm[:-1] - calm[1:], 0.0) * settings.reopening
        smooth, variances = np.array(state.forces), np.array(state.variances)
        for k in range(len(smooth) - 2, -1, -1):
            # The variance after the prediction holds the walk of one period already.
            share = np.clip(1.0 - walk[k] / variances[k], 0.0, 1.0)
            smooth[k] += share * (smooth[k + 1] - smooth[k])
        force = np.array(state.travels) * smooth[..., :1] + smooth[..., 1:]
        count = min(len(force), len(state.expected))
        force[:count] += state.expected[:count] * ~state.other_path[:, np.newaxis]
        nyquist = 0.5 / self.policy.control_period
        from scipy.signal import butter, sosfiltfilt  # slow to import, and looks for torch

        sections = butter(ORDER, min(CUT_OFF / nyquist, 0.99), output="sos")
        return np.asarray(sosfiltfilt(sections, force, axis=0, padlen=min(len(force) - 1, 60)))


def _window(state: PassState, sample: int) -> np.ndarray:
    """Return the expected force at this sample, at those before it and at the next one, (lanes, `KEPT` + 1, axes)."""
    window = np.zeros((len(state.memory), KEPT + 1, state.expected.shape[2]))
    last = len(state.expected) - 1
    if last >= 0:
        for place, k in enumerate((*range(sample, sample - KEPT, -1), sample + 1)):
            window[:, place] = state.expected[min(max(k, 0), last)] * ~state.other_path[:, np.newaxis]
    return window
