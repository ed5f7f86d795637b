"""One episode of one policy, recorded sample by sample."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.fuzzy_policy.policy import Predictor


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
        tip, tip_reference: (n, 2) [m].
        tip_error: (n,) distance of the two [m].
        circularity_error, circularity_error_motor: (n,), link side and motor side [m].
        q_motor, dq_motor, q_link, dq_link: (n, 2) [rad, rad/s].
        q_reference, dq_reference: (n, 2) [rad, rad/s].
        torque, friction_torque: (n, 2) [N m].
        external_force: (n, 2) [N].
        reward: (n,).
        domain_use: (n,), largest share of the joint box (25) in use, 1 at its border.
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


_FROM_INFO = (
    "time",
    "tip",
    "tip_reference",
    "tip_error",
    "circularity_error",
    "circularity_error_motor",
    "q_motor",
    "dq_motor",
    "q_link",
    "dq_link",
    "torque",
    "friction_torque",
    "external_force",
)


def rollout(env: FuzzyArmEnv, policy: Predictor, *, policy_name: str, case: str, seed: int) -> Rollout:
    """Run one episode of `env` from `reset(seed=seed)` under `policy` and record it."""
    observation, _ = env.reset(seed=seed)
    state, start = None, np.ones(1, dtype=bool)
    infos, references, rewards, timings = [], [], [], []
    terminated = truncated = False
    while not (terminated or truncated):
        begin = time.perf_counter()
        action, state = policy.predict(observation, state=state, episode_start=start, deterministic=True)
        timings.append(time.perf_counter() - begin)
        start = np.zeros(1, dtype=bool)
        observation, reward, terminated, truncated, info = env.step(action)
        infos.append(info)
        references.append(observation[4:8])
        rewards.append(reward)
    signals = {name: np.array([info[name] for info in infos]) for name in _FROM_INFO}
    reference = np.array(references)
    limits = env.parameters
    shares = [
        np.abs(signals[name]) / limit
        for side in ("motor", "link")
        for name, limit in ((f"q_{side}", limits.joint_limit), (f"dq_{side}", limits.velocity_limit))
    ]
    return Rollout(
        policy=policy_name,
        case=case,
        seed=seed,
        control_period=env.control_period,
        completed=truncated,
        reason=infos[-1].get("reason", ""),
        step_time=float(np.median(timings)),
        q_reference=reference[:, :2],
        dq_reference=reference[:, 2:],
        reward=np.array(rewards),
        domain_use=np.concatenate(shares, axis=1).max(axis=1),
        **signals,
    )
