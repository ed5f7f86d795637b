"""How `learned_comparison.py` judges episodes and trainings: rows over seeds, scores, plateau, the median seed."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from learned_tasks import MEASURES, TASKS

from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.evaluation.statistics import estimate


def summarised(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per task and policy: how many episodes, how many failed, and the errors of the others.

    Each error is a mapping of ``mean``, ``low`` and ``high`` [mm] by `estimate`, None if every episode failed.
    """
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for record in records:
        groups.setdefault((record["task"], record["policy"]), []).append(record)
    rows = []
    for task in TASKS:
        for (of, policy), group in groups.items():
            if of != task:
                continue
            good = [record for record in group if record["failed"] is None]
            row = {"task": task, "policy": policy, "episodes": len(group), "failed": len(group) - len(good)}
            for key in MEASURES:
                values = [record[key] for record in good]
                row[key] = estimate(values)._asdict() if values else None
            rows.append(row)
    return rows


def judged_cases(distribution: str) -> tuple[str, ...]:
    """Return the cases in which a policy is judged: Case 1 if it was trained on ``"nominal"``, otherwise all three."""
    return ("nominal",) if distribution == "nominal" else PAPER_CASES


def scores(records: Sequence[dict[str, Any]], distribution: str) -> dict[int, float]:
    """Return the score of each seed [mm]: the mean rms over the judged cases, infinite if the policy failed in one.

    Args:
        records: of the seeds of one learned policy.
        distribution: of the training, see `judged_cases`.
    """
    judged = judged_cases(distribution)
    result: dict[int, float] = {}
    for seed in dict.fromkeys(record["seed"] for record in records):
        found = [record for record in records if record["seed"] == seed and record["task"] in judged]
        failed = any(record["failed"] for record in found)
        result[seed] = math.inf if failed else statistics.mean(record["tip_error_rms_mm"] for record in found)
    return result


def plateau(curve: Sequence[Mapping[str, Any]], distribution: str) -> float | None:
    """Return the score at the end of a training relative to that just before: 1 if it no longer changed.

    With S the steps of the last evaluation and the score the mean rms over the judged cases, it is

        mean score over 0.9 S < steps <= S  /  mean score over 0.8 S < steps <= 0.9 S.

    Args:
        curve: of a bundle, one mapping per evaluation in the order of time.
        distribution: of the training, see `judged_cases`.

    Returns:
        The ratio; None if one of the two intervals holds no evaluation, or an evaluation in which the episode of a
        judged case ended early.
    """
    total, judged = curve[-1]["steps"], judged_cases(distribution)
    last: list[float] = []
    before: list[float] = []
    for row in curve:
        if 10 * row["steps"] > 8 * total:
            ended_early = any(row.get(f"{case}_share", 1.0) < 1.0 for case in judged)
            score = math.nan if ended_early else statistics.mean(row[f"{case}_rms_mm"] for case in judged)
            (last if 10 * row["steps"] > 9 * total else before).append(score)
    ratio = statistics.mean(last) / statistics.mean(before) if before else math.nan
    return ratio if math.isfinite(ratio) else None


def median_seed(score: Mapping[int, float]) -> int:
    """Return the seed with the median score: of an even number the better of the middle two, of equal ones the first.

    It is always one of the seeds, and a failed one only if at least half of them failed.
    """
    ranked = sorted(score, key=lambda seed: (score[seed], seed))
    return ranked[(len(ranked) - 1) // 2]


def worst_task(records: Sequence[dict[str, Any]]) -> str:
    """Return the task with the largest rms among some records, or among those that failed if there are any."""
    worst: str = max(records, key=lambda record: (record["failed"] is not None, record["tip_error_rms_mm"]))["task"]
    return worst


def best_model_based(records: Sequence[dict[str, Any]], task: str) -> str:
    """Return the model-based policy with the smallest rms on a task; policies that failed come last."""
    found = [record for record in records if record["task"] == task and record["seed"] is None]
    best: str = min(found, key=lambda record: (record["failed"] is not None, record["tip_error_rms_mm"]))["policy"]
    return best
