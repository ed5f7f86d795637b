"""A policy from an ONNX file with a model that acts in ``FuzzyArmLearn-v0``.

The model's only input must be observations (lanes, size) in float32, its first output actions (lanes, n), which are
clipped to [-1, 1]; a model for a single lane runs once per lane. onnxruntime runs the graph, which contains no code.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.documents import read_bytes
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, learning_features
from fuzzyarm.fuzzy_policy.laws.learned.features import FeatureLanes, Features, guided, learning_action
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["OnnxPolicy", "past_seen"]

_LARGEST = 64 * 2**20  # bytes


def past_seen(path: Path, inputs: int, joints: int) -> int:
    """Return the task's `history` for which an observation has `inputs` entries; ValueError if there is none."""
    past, rest = divmod(inputs - 6 * joints, 2 * joints)
    if inputs == 5 * joints:
        return 0
    if rest or past < 1:
        raise ValueError(
            f"{path}: its input has {inputs} numbers; an observation of FuzzyArmLearn-v0 has {5 * joints}, or, with "
            f"history=k, {6 * joints} + {2 * joints} k"
        )
    return past


class OnnxPolicy(Policy):
    """A model as a policy; its memory: number of periods since the last action, that action, the features' memory."""

    def __init__(
        self, path: Path, robot: AnyArm, control_period: float, action: ActionDefinition | None = None
    ) -> None:
        """Load a model from its file; its actions are those of ``FuzzyArmLearn-v0``, unless `action` defines others.

        ValueError if the file is not such a model or onnxruntime is missing; OSError if the file cannot be read.
        """
        super().__init__(robot, control_period)
        try:
            import onnxruntime
        except ImportError:
            raise ValueError(
                "onnxruntime, which runs policies named onnx:FILE, is not installed; run in the repository: "
                'pip install -c constraints.txt -e ".[onnx]"'
            ) from None
        try:
            content = read_bytes(path, largest=_LARGEST)
            self._session: Any = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
        except OSError:
            raise
        except Exception as error:  # onnxruntime's errors have no common class
            reason = re.sub(r"\s+", " ", str(error))[:200]
            raise ValueError(f"{path} is not an ONNX model that onnxruntime can run: {reason}") from None
        given, *others = self._session.get_inputs()
        lanes, *sizes = given.shape
        sized = [isinstance(size, int) for size in sizes] == [True] and (lanes == 1 or not isinstance(lanes, int))
        if others or given.type != "tensor(float)" or not sized:
            found = ", ".join(f"{one.name} {one.type} {one.shape}" for one in (given, *others))
            raise ValueError(
                f"{path}: its inputs are {found}; needed: one input of type tensor(float) and shape (n, size), "
                "for n observations, or (1, size)"
            )
        self._input, self._one_by_one, joints = given.name, lanes == 1, joints_of(robot)
        definition, action = (
            learning_features(joints, past_seen(path, given.shape[1], joints)),
            action or learning_action(robot),
        )
        self._features = FeatureLanes(features := Features(definition, action.period, robot), guided(None))
        self._scale, self._calls = np.array(action.scale), action.calls(control_period)
        self.action_period, self._remembered = action.period, features.memory_size
        if (shape := self._run(np.zeros((1, given.shape[1]), np.float32)).shape) != (1, joints):
            raise ValueError(f"{path}: its output for one observation has shape {shape}; needed: (1, {joints})")

    @property
    def memory_size(self) -> int:
        """Number of entries in the memory of one lane."""
        return 1 + self.joints + self._remembered

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Fill `torque` (lanes, n) [N m]; a new action is computed when the last one has been held for its period."""
        due = np.flatnonzero(memory[:, 0] == 0.0)
        if len(due):
            seen, past = np.ascontiguousarray(observation[due]), np.ascontiguousarray(memory[due, 1 + self.joints :])
            features = self._features.see(seen, past).astype(np.float32)
            action = np.clip(self._run(features).astype(np.float64), -1.0, 1.0)
            self._features.act(seen, action, self._scale * action, past, np.empty((len(due), 0)))
            memory[due, 1 : 1 + self.joints], memory[due, 1 + self.joints :] = action, past
        memory[:, 0] = (memory[:, 0] + 1.0) % self._calls
        torque[:] = self._scale * memory[:, 1 : 1 + self.joints]

    def _run(self, features: np.ndarray) -> np.ndarray:
        parts = np.split(features, len(features)) if self._one_by_one else [features]
        return np.concatenate([self._session.run(None, {self._input: part})[0] for part in parts])

    def __reduce__(self) -> Any:
        raise TypeError("a policy from an ONNX file cannot be pickled; load the file in each process")
