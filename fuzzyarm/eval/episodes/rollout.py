"""One episode of one policy, recorded sample by sample.

Rollouts as one compressed file of plain arrays, ``rollouts.npz``, and the digest that ties it to its results.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.array_files import read_arrays
from fuzzyarm.common.checks import instance, path_of, sequence_of, shown
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.batch.layout import INFO
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.eval.episodes.beliefs import NO_BELIEFS, Believing
from fuzzyarm.eval.episodes.loop import Step, Timed, episodes
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.policy import Predictor
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController
from fuzzyarm.policies import load_policy, resolve

__all__ = [
    "NAME",
    "SIGNALS",
    "Rollout",
    "Signals",
    "digest",
    "read_rollouts",
    "record_rollout",
    "run_episode",
    "write_rollouts",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Rollout:
    """Signals of one episode; row k is the state after control step k + 1, at `time[k]`.

    Attributes:
        policy: name of the policy.
        case: name of the case.
        seed: seed of the episode.
        control_period: [s].
        completed: whether the reference was followed to its end.
        reason: why the episode terminated early, empty if it did not.
        step_time: median wall time of one `predict` call [s].
        time: (n,) [s].
        tip, tip_reference: (n, 2) [m]; of a robot other than the two-joint arm (n, 3).
        tip_error: (n,) distance of the two [m].
        circularity_error, circularity_error_motor: (n,), link side and motor side [m].
        q_motor, dq_motor, q_link, dq_link: (n, joints) [rad, rad/s].
        q_reference, dq_reference: (n, joints) [rad, rad/s].
        torque, friction_torque: (n, joints) [N m].
        external_force: (n, 2) or (n, 3) [N].
        reward: (n,).
        domain_use: (n,), largest share of the joint box (25) in use, 1 at its border.
        beliefs: (n, columns), what the policy believed when it acted, see `fuzzyarm.eval.episodes.beliefs`; nan where
            that is nothing, (0, 0) of a policy that says nothing.
        belief_names: of these columns: ``payload``, ``payload_deviation``, ``stiffness_1``, ...
        note: that the policy's filter diverged, which of its estimates stood at an end of their range and since when,
            and that its path was not that of the pass before, in words; empty as a rule.
    """

    policy: str
    case: str
    seed: int
    control_period: float
    completed: bool
    reason: str
    step_time: float
    time: np.ndarray
    tip: np.ndarray
    tip_reference: np.ndarray
    tip_error: np.ndarray
    circularity_error: np.ndarray
    circularity_error_motor: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    q_link: np.ndarray
    dq_link: np.ndarray
    q_reference: np.ndarray
    dq_reference: np.ndarray
    torque: np.ndarray
    friction_torque: np.ndarray
    external_force: np.ndarray
    reward: np.ndarray
    domain_use: np.ndarray
    beliefs: np.ndarray = dataclasses.field(default_factory=lambda: NO_BELIEFS)
    belief_names: tuple[str, ...] = ()
    note: str = ""

    @property
    def believed(self) -> dict[str, np.ndarray]:
        """The columns of `beliefs` (n,) by name."""
        return dict(zip(self.belief_names, self.beliefs.T, strict=True))


SIGNALS = tuple(field.name for field in dataclasses.fields(Rollout) if field.name in INFO)
"""The fields of a `Rollout` that the environment's info has by the same name."""


class Signals:
    """All signals of one arm, step by step, and the `Rollout` that they make."""

    def __init__(self, lane: int | None = None) -> None:
        """Begin with no steps; `lane` is that of a batch, None a single arm."""
        self._lane: Any = ... if lane is None else lane
        self._steps: list[Step] = []

    def add(self, step: Step) -> None:
        """Keep a step, unless the episode has ended before."""
        if step.running[self._lane]:
            self._steps.append(step)

    def rollout(
        self,
        *,
        policy: str,
        case: str,
        seed: int,
        control_period: float,
        parameters: AnyArm,
        step_time: float = math.nan,
        beliefs: np.ndarray = NO_BELIEFS,
        belief_names: tuple[str, ...] = (),
        note: str = "",
    ) -> Rollout:
        """Return the episode.

        Arguments are the fields of `Rollout`, with its shapes (`beliefs`: (n, columns)), times [s]; `parameters` is the
        arm, for its joints' limits.
        """
        lane, last = self._lane, self._steps[-1]
        signals = {name: np.array([step.info[name] for step in self._steps])[:, lane] for name in SIGNALS}
        reference = observed(np.array([step.observation for step in self._steps])[:, lane])
        completed = bool(last.completed[lane])
        return Rollout(
            policy=policy,
            case=case,
            seed=seed,
            control_period=control_period,
            completed=completed,
            reason="" if completed else str(np.asarray(last.info["reason"])[lane]),
            step_time=step_time,
            q_reference=reference.q_reference,
            dq_reference=reference.dq_reference,
            reward=np.array([step.reward for step in self._steps])[:, lane],
            domain_use=_domain_use(signals, parameters),
            beliefs=beliefs,
            belief_names=belief_names,
            note=note,
            **signals,
        )


def record_rollout(env: FuzzyArmEnv, policy: Predictor, *, policy_name: str, case: str, seed: int) -> Rollout:
    """Run one episode of `env` from ``reset(seed=seed)`` under `policy` and record it."""
    believing = Believing(policy)
    timed, signals = Timed(policy), Signals()
    for step in episodes(env, believing.around(timed), env.reset(seed=seed)):
        signals.add(step)
    return signals.rollout(
        policy=policy_name,
        case=case,
        seed=seed,
        control_period=env.control_period,
        parameters=env.parameters,
        step_time=timed.median,
        beliefs=believing.rows(),
        belief_names=believing.names,
        note=believing.note(env.control_period),
    )


def run_episode(
    policy: str | os.PathLike[str] | Controller | ScheduledController | Predictor,
    case: str = "nominal",
    *,
    seed: int = 0,
    robot: str | os.PathLike[str] | AnyArm | None = None,
    control_period: float = 1e-3,
    **environment: Any,
) -> Rollout:
    """Run one episode of a policy and record it.

    Args:
        policy: what `load_policy` takes, or an object with `predict`.
        case: name of the case.
        seed: of the episode.
        robot: the arm, of the environment and of the policy; None: Table 1.
        control_period: time between two actions [s].
        environment: further arguments of `FuzzyArmEnv`.

    Raises:
        ValueError: a name is unknown, or policy and robot do not go together.
        OSError: a file cannot be read.

    Examples:
        >>> run = run_episode("fuzzy-4-tip")
        >>> run.tip.shape, run.completed, bool(run.tip_error.max() < 3e-6)
        ((1500, 2), True, True)
    """
    env = FuzzyArmEnv(case, robot=robot, control_period=control_period, **environment)
    name = resolve(policy).label if isinstance(policy, str | os.PathLike) else type(policy).__name__
    if isinstance(policy, str | os.PathLike | Controller | ScheduledController):
        policy = load_policy(policy, control_period=control_period, robot=robot)
    if not hasattr(policy, "predict"):
        raise TypeError(f"policy = {shown(policy)} must be a name, a controller or an object with predict")
    return record_rollout(env, policy, policy_name=name, case=case, seed=seed)


def _domain_use(signals: Mapping[str, np.ndarray], arm: AnyArm) -> np.ndarray:
    """Return the largest share of the joint box (25) in use, (n,)."""
    low, high, velocity, _ = bounds_of(arm)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    shares = [
        np.abs(signals[f"{quantity}_{side}"] - center) / limit
        for side in ("motor", "link")
        for quantity, center, limit in (("q", middle, half), ("dq", 0.0, velocity))
    ]
    return np.asarray(np.concatenate(shares, axis=1).max(axis=1))


NAME = "rollouts.npz"
"""Name of the file in an evaluation's folder."""
_FIELDS = tuple(field.name for field in dataclasses.fields(Rollout))
_SINGLE = {
    "policy": "U",
    "case": "U",
    "seed": "i",
    "control_period": "f",
    "completed": "b",
    "reason": "U",
    "step_time": "f",
    "note": "U",
}
_POINTS = ("tip", "tip_reference", "external_force")
_LARGEST = 1e60  # whose powers are numbers
_ONE_NUMBER = ("time", "tip_error", "circularity_error", "circularity_error_motor", "reward", "domain_use")


def digest(rollouts: Sequence[Rollout]) -> str:
    """Return the SHA-256 of all rollouts: names, types, shapes and bytes of every field, in order."""
    total = hashlib.sha256()
    for run in rollouts:
        for name in _FIELDS:
            array = _array(run, name)
            total.update(f"{name} {array.dtype} {array.shape} ".encode())
            total.update(array.tobytes())
    return total.hexdigest()


def write_rollouts(rollouts: Sequence[Rollout], folder: Path) -> Path:
    """Write every field of every rollout to ``rollouts.npz``, atomically; return its path.

    The array of field ``torque`` of the third rollout is called ``2.torque``; names and flags are arrays as well.
    """
    content, folder = io.BytesIO(), path_of("folder", folder)
    runs = [instance("rollouts", run, Rollout) for run in sequence_of("rollouts", rollouts)]
    arrays = {f"{k}.{name}": _array(run, name) for k, run in enumerate(runs) for name in _FIELDS}
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_atomically(folder / NAME, content.getvalue())
    return folder / NAME


def read_rollouts(path: Path) -> list[Rollout]:
    """Return the rollouts of a file written by `write_rollouts`; nothing is unpickled.

    Raises:
        ValueError: the file is damaged or holds something else.
        OSError: it cannot be read.
    """
    arrays = read_arrays(path)
    missing = [name for name in _FIELDS if f"0.{name}" not in arrays]
    if arrays and missing:
        raise ValueError(f"{path} is damaged, or of another version of fuzzyarm (its rollouts have no {missing[0]})")
    count = len(arrays) // len(_FIELDS)
    if set(arrays) != {f"{k}.{name}" for k in range(count) for name in _FIELDS}:
        raise ValueError(f"{path} is damaged (it does not hold the fields of {count} rollouts)")
    try:
        return [_rollout({name: arrays[f"{k}.{name}"] for name in _FIELDS}) for k in range(count)]
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error})") from None


def _array(run: Rollout, name: str) -> np.ndarray:
    """Return a field as an array; names are texts, also where there are none."""
    return np.asarray(getattr(run, name), dtype=np.str_ if name == "belief_names" else None)


def _rollout(arrays: dict[str, np.ndarray]) -> Rollout:
    """Return a rollout whose fields are of the types and shapes that `Rollout` says; ValueError otherwise."""
    steps, joints = len(np.atleast_1d(arrays["time"])), arrays["torque"].shape[-1] if arrays["torque"].ndim else 0
    axes = arrays["tip"].shape[-1] if arrays["tip"].shape[-1:] in ((2,), (3,)) else 2
    believed = len(set(arrays["belief_names"].ravel().tolist()))  # columns, whose names differ
    values: dict[str, Any] = {}
    for name, array in arrays.items():
        kind, row = _SINGLE.get(name, "f"), axes if name in _POINTS else joints
        shape: tuple[int, ...] = () if name in _SINGLE else (steps,) if name in _ONE_NUMBER else (steps, row)
        if name == "beliefs":
            shape = (steps, believed) if believed else NO_BELIEFS.shape
        elif name == "belief_names":
            kind, shape = "U", (believed,)
        if array.dtype.kind != kind or array.shape != shape or steps == 0:
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}; needed: {kind} of shape {shape}")
        unknown = np.isnan(array) if name == "beliefs" else False
        if kind == "f" and name != "step_time" and not (unknown | (np.abs(array) <= _LARGEST)).all():
            raise ValueError(f"{name} is not finite, or beyond {_LARGEST:g}")
        values[name] = array.item() if name in _SINGLE else tuple(array.tolist()) if kind == "U" else array
    return Rollout(**values)
