"""What the page's script draws: the signals of the first seed, small enough to embed."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.report.stored import StoredEvaluation

LARGEST = 2_300_000  # bytes of base64 for all signals together; the page stays below 3 MB


def payload(stored: StoredEvaluation) -> dict[str, Any]:
    """Return policies, arm, cases and their runs, ready for JSON.

    Arrays are base64 of little-endian float32. Every `stride`-th sample is embedded, and the last one of each episode.
    """
    first: dict[str, dict[str, Rollout]] = {case: {} for case in stored.config.cases}
    for run in stored.rollouts:
        first[run.case].setdefault(run.policy, run)
    policies = list(stored.bounds)
    stride = _stride([run for runs in first.values() for run in runs.values()])
    return {
        "policies": policies,
        "length": stored.config.parameters.length,
        "stride": stride,
        "cases": [_case(name, [runs[policy] for policy in policies], stride) for name, runs in first.items()],
    }


def _stride(runs: Sequence[Rollout]) -> int:
    """Return the smallest stride with which the signals fit into `LARGEST`."""
    numbers = sum(signal.size for run in runs for signal in _signals(run).values())
    return max(1, -(-4 * 4 * numbers // (3 * LARGEST)))


def _signals(run: Rollout) -> dict[str, np.ndarray]:
    """Return what is embedded of a run.

    The deviation of the tip and the bending of the joints are embedded themselves: differences of float32 positions
    would lose the micrometres.
    """
    return {
        "deviation": run.tip - run.tip_reference,
        "link": run.q_link,
        "bending": run.q_motor - run.q_link,
        "torque": run.torque,
        "circularity": run.circularity_error,
    }


def _case(name: str, runs: Sequence[Rollout], stride: int) -> dict[str, Any]:
    longest = max(runs, key=lambda run: len(run.time))
    shown = _shown(len(longest.time), stride)
    return {
        "title": CASES[name].title,
        "payload": CASES[name].disturbance.payload.mass,
        "time": _encoded(longest.time[shown]),
        "reference": _encoded(longest.tip_reference[shown]),
        "force": _encoded(longest.external_force[shown]) if longest.external_force.any() else None,
        "runs": [
            {"ended": None if run.completed else {"time": float(run.time[-1]), "reason": run.reason}}
            | {key: _encoded(signal[_within(shown, len(signal))]) for key, signal in _signals(run).items()}
            for run in runs
        ],
    }


def _shown(samples: int, stride: int) -> np.ndarray:
    """Return the indices 0, stride, ... and the last one."""
    return np.unique([*range(0, samples, stride), samples - 1])


def _within(shown: np.ndarray, samples: int) -> np.ndarray:
    """Return the indices of a run that may be shorter; its last sample stands at the next instant that is shown."""
    return np.asarray(np.minimum(shown[: np.searchsorted(shown, samples - 1) + 1], samples - 1))


def _encoded(values: np.ndarray) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")
