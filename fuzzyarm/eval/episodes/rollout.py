"""Episodes of one policy, recorded sample by sample: a single episode, or several passes along one path."""

import dataclasses
import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.batch.layout import INFO
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.eval.episodes._beliefs import NO_BELIEFS, Believing
from fuzzyarm.eval.episodes.loop import Step, episodes
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.policy import Predictor
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController
from fuzzyarm.policies import load_policy, resolve

__all__ = ["Rollout", "record_passes", "record_rollout", "rollout_of", "run_episode"]


@dataclasses.dataclass(frozen=True)
class Rollout:
    """Signals of one episode; row k is the state after control step k + 1, at `time[k]`.

    There are n control steps; points have two coordinates, or three for robots other than the two-joint arm.
    """

    policy: str  # its name
    case: str  # its name
    seed: int  # of the episode
    control_period: float  # [s]
    completed: bool  # whether the reference was followed to its end
    reason: str  # why the episode terminated early, empty if it did not
    step_time: float  # median wall time of one `predict` call [s]
    time: np.ndarray  # (n,) [s]
    tip: np.ndarray  # (n, 2 or 3) [m]
    tip_reference: np.ndarray  # (n, 2 or 3) [m]
    tip_error: np.ndarray  # (n,) distance between tip and reference [m]
    circularity_error: np.ndarray  # (n,) of the links [m]
    circularity_error_motor: np.ndarray  # (n,) of the motors [m]
    q_motor: np.ndarray  # (n, joints) [rad]
    dq_motor: np.ndarray  # (n, joints) [rad/s]
    q_link: np.ndarray  # (n, joints) [rad]
    dq_link: np.ndarray  # (n, joints) [rad/s]
    q_reference: np.ndarray  # (n, joints) [rad]
    dq_reference: np.ndarray  # (n, joints) [rad/s]
    torque: np.ndarray  # (n, joints) [N m]
    friction_torque: np.ndarray  # (n, joints) [N m]
    external_force: np.ndarray  # (n, 2 or 3) [N]
    reward: np.ndarray  # (n,)
    domain_use: np.ndarray  # (n,) largest share of the joint box (25) in use, 1 at its border
    # (n, columns), what the policy believed when it acted, see `fuzzyarm.eval.episodes._beliefs`; nan where it had no
    # estimate, and (0, 0) for a policy without beliefs.
    beliefs: np.ndarray = dataclasses.field(default_factory=lambda: NO_BELIEFS)
    belief_names: tuple[str, ...] = ()  # of these columns: ``payload``, ``payload_deviation``, ``stiffness_1``, ...
    note: str = ""  # what happened to its estimates, in words, see `Believing.note`

    @property
    def believed(self) -> dict[str, np.ndarray]:
        """The columns of `beliefs` by name, each (n,) for n control steps."""
        return dict(zip(self.belief_names, self.beliefs.T, strict=True))


_SIGNALS = tuple(field.name for field in dataclasses.fields(Rollout) if field.name in INFO)
"""The fields of a `Rollout` that the environment's info has by the same name."""


def rollout_of(
    steps: Iterable[Step], lane: int | None = None, *, parameters: AnyArm, step_time: float = math.nan, **named: Any
) -> Rollout:
    """Return the episode that consists of these steps of a single arm or of one lane of a batch.

    `parameters` is the arm, whose joint limits are needed; `step_time` [s] and `named` are fields of `Rollout`.
    """
    at: Any = ... if lane is None else lane
    kept = [step for step in steps if step.running[at]]
    last = kept[-1]
    signals: dict[str, Any] = {name: np.array([step.info[name] for step in kept])[:, at] for name in _SIGNALS}
    reference = observed(np.array([step.observation for step in kept])[:, at])
    completed = bool(last.completed[at])
    return Rollout(
        completed=completed,
        reason="" if completed else str(np.asarray(last.info["reason"])[at]),
        step_time=step_time,
        q_reference=reference.q_reference,
        dq_reference=reference.dq_reference,
        reward=np.array([step.reward for step in kept])[:, at],
        domain_use=_domain_use(signals, parameters),
        **signals,
        **named,
    )


def record_rollout(env: FuzzyArmEnv, policy: Predictor, *, policy_name: str, case: str, seed: int) -> Rollout:
    """Run one episode of `env` from ``reset(seed=seed)`` under `policy` and record it."""
    return _recorded(env, policy, None, policy=policy_name, case=case, seed=seed)[0]


def record_passes(
    env: FuzzyArmEnv, policy: Predictor, passes: int, *, policy_name: str, case: str, seed: int
) -> list[Rollout]:
    """Run several passes of an episode of `env` and record each; pass j, from 0, begins at ``reset(seed=seed + j)``.

    A policy that learns from pass to pass has a method `repeated`, which returns the policy that runs all passes.
    Without this method, or if it returns None, every pass begins afresh.
    """
    repeated = getattr(policy, "repeated", lambda: None)()
    runs, memory = list[Rollout](), None
    for number in range(passes):
        begin = repeated.begin_pass(memory) if repeated and number else None
        run, memory = _recorded(env, repeated or policy, begin, policy=policy_name, case=case, seed=seed + number)
        runs.append(run)
    return runs


def _recorded(env: FuzzyArmEnv, acting: Predictor, memory: Any, *, seed: int, **named: Any) -> tuple[Rollout, Any]:
    """Run one episode from policy state `memory` (None: new); return it, with fields `named`, and the final state."""
    believing, steps = Believing(acting), list[Step]()
    for step in episodes(env, acting, env.reset(seed=seed), memory=memory):
        believing.add(step.memory)
        steps.append(step._replace(memory=None))  # 1500 states of a filter would take much memory
    rollout = rollout_of(
        steps,
        seed=seed,
        control_period=env.control_period,
        parameters=env.parameters,
        step_time=float(np.median([one.seconds for one in steps])),
        beliefs=believing.rows(),
        belief_names=believing.names,
        note=believing.note(env.control_period),
        **named,
    )
    return rollout, step.memory


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

    `policy` is an argument of `load_policy`, or an object with `predict`; `robot` is the arm of both environment and
    policy, None for the arm of Table 1. `control_period` is the time between two actions [s]; `environment` has
    further arguments of `FuzzyArmEnv`.

    Raises:
        ValueError: a name is unknown, or policy and robot do not fit together.
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
        raise TypeError(f"policy = {shown(policy)} must be a name, a controller or an object with a method predict")
    return record_rollout(env, policy, policy_name=name, case=case, seed=seed)


def _domain_use(signals: Mapping[str, np.ndarray], arm: AnyArm) -> np.ndarray:
    """Return, for n steps, the largest share (n,) of its limit in the box (25) that an angle or a velocity reaches."""
    low, high, velocity, _ = bounds_of(arm)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    shares = [
        np.abs(signals[f"{quantity}_{side}"] - center) / limit
        for side in ("motor", "link")
        for quantity, center, limit in (("q", middle, half), ("dq", 0.0, velocity))
    ]
    return np.asarray(np.concatenate(shares, axis=1).max(axis=1))
