"""Data of the replay: the signals that the page's script draws, thinned to limit its size."""

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.perspective import floor_of, in_space, looking_at, poses_of
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import reach
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.evaluation.run import Evaluation, EvaluationConfig

__all__ = ["replay_data"]

_LARGEST = 2_300_000  # bytes of base64 for all signals together, with which the page stays below 3 MB
_POSES = 200  # approximate number of poses that determine camera and floor
_FLOAT = np.dtype("<f4")  # of embedded numbers
_BASE64 = 4 / 3  # bytes of base64 for a byte of data


def replay_data(stored: Evaluation) -> dict[str, Any]:
    """Return policies, arm, cases and the runs of the first seed, as plain data for JSON.

    Arrays are base64 of little-endian float32. They contain every k-th sample and the last, k = ``stride``.
    """
    seeds: dict[str, dict[str, list[Rollout]]] = {case: {} for case in stored.config.cases}
    for run in stored.rollouts:
        seeds[run.case].setdefault(run.policy, []).append(run)
    policies = list(stored.bounds)
    groups = [runs for by_policy in seeds.values() for runs in by_policy.values()]
    numbers = sum(signal.size for runs in groups for signal in _signals(runs).values())
    stride = max(1, math.ceil(_BASE64 * _FLOAT.itemsize * numbers / _LARGEST))  # the smallest that fits
    shown = [_case(stored.config, name, [runs[p] for p in policies], stride) for name, runs in seeds.items()]
    arm: dict[str, Any] = {"length": stored.config.parameters.length}
    if stored.config.robot is not None:
        arm = {"robot": _robot(stored.config.robot, max(stored.rollouts, key=lambda run: len(run.time)))}
    return {"policies": policies, **arm, "stride": stride, "cases": shown}


def _robot(robot: Robot, run: Rollout) -> dict[str, Any]:
    """Return the kinematic chain of a robot, and the camera and floor of the replay, chosen for its motion in a run."""
    asked = poses_of(robot, run.q_reference[:: max(1, len(run.time) // _POSES)])
    camera, floor, chain = looking_at(robot, in_space(run.tip_reference)), floor_of(robot, asked.points), robot.arrays
    joints = zip(chain.position.tolist(), chain.rotation.tolist(), chain.axis.tolist(), strict=True)
    return {
        "joints": [{"position": p, "rotation": r, "axis": a} for p, r, a in joints],
        "tip": chain.tip.tolist(),
        "torque": robot.drive("torque_limit").tolist(),
        "reach": reach(robot),
        "eye": camera.eye.tolist(),
        "axes": camera.axes.tolist(),
        "distance": float(camera.depth(asked.points.reshape(-1, chain.tip.size).mean(axis=0))),
        "floor": {"up": floor.up.tolist(), "height": floor.height, "grid": floor.grid.tolist()},
    }


def _signals(runs: Sequence[Rollout]) -> dict[str, np.ndarray]:
    """Return the signals of the first of these runs, which differ in seed, and the range of the tip errors of all."""
    run = runs[0]
    signals = {  # deviation and bending, because differences of positions in float32 would not resolve micrometres
        "deviation": run.tip - run.tip_reference,
        "link": run.q_link,
        "bending": run.q_motor - run.q_link,
        "torque": run.torque,
        "circularity": run.circularity_error,
    }
    return signals | ({"range": _range(runs)} if len(runs) > 1 else {})


def _range(runs: Sequence[Rollout]) -> np.ndarray:
    """Return the smallest and largest tip error (n, 2) [m] at the n samples of the first run.

    Runs that have ended before a sample are left out there.
    """
    errors = np.full((len(runs), len(runs[0].time)), np.nan)
    for row, run in zip(errors, runs, strict=True):
        shared = min(len(row), len(run.time))
        row[:shared] = run.tip_error[:shared]
    return np.stack([np.nanmin(errors, axis=0), np.nanmax(errors, axis=0)], axis=1)


def _case(config: EvaluationConfig, name: str, groups: Sequence[Sequence[Rollout]], stride: int) -> dict[str, Any]:
    case, placed = config.case(name, None), np.asarray if config.robot is None else in_space
    longest = max((runs[0] for runs in groups), key=lambda run: len(run.time))
    last = len(longest.time) - 1
    shown = np.unique([*range(0, last + 1, stride), last])

    def of_seeds(runs: Sequence[Rollout]) -> dict[str, Any]:
        # The run's last sample takes the place of the next shown sample of the longest run.
        run, last = runs[0], len(runs[0].time) - 1
        within = np.minimum(shown[: np.searchsorted(shown, last) + 1], last)
        signals = {key: signal[within] for key, signal in _signals(runs).items()}
        ended = None if run.completed else {"time": float(run.time[-1]), "reason": run.reason}
        signals["deviation"] = placed(signals["deviation"])
        return {"ended": ended, **{key: _encoded(signal) for key, signal in signals.items()}}

    return {
        "title": case.title,
        "payload": case.disturbance.payload.mass,
        "time": _encoded(longest.time[shown]),
        "reference": _encoded(placed(longest.tip_reference[shown])),
        "force": _encoded(placed(longest.external_force[shown])) if longest.external_force.any() else None,
        "runs": list(map(of_seeds, groups)),
    }


def _encoded(values: np.ndarray) -> str:
    return base64.b64encode(values.astype(_FLOAT).tobytes()).decode("ascii")
