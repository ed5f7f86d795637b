"""Evaluations with altered rollouts, and a policy name with markup that must be escaped."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import Rollout, write_results
from fuzzyarm.eval.episodes.rollout_file import write_rollouts
from fuzzyarm.eval.evaluation.run import Evaluation, row_of

NASTY = "<img src=x onerror=alert(1)>&\"'`${1}"  # a file may be called so


def write(evaluation: Evaluation, folder: Path) -> Path:
    """Write what the report reads, without the figures that it does not."""
    folder.mkdir(exist_ok=True)
    write_results(evaluation, folder)
    write_rollouts(evaluation.rollouts, folder)
    return folder


def with_runs(evaluation: Evaluation, runs: list[Rollout]) -> Evaluation:
    """The same evaluation with these rollouts, of the cases and policies in them."""
    policies, cases = (tuple(dict.fromkeys(getattr(run, field) for run in runs)) for field in ("policy", "case"))
    changed: dict[str, Any] = {"config": dataclasses.replace(evaluation.config, policies=policies, cases=cases)}
    for field in ("certificates", "bounds", "declared"):
        changed[field] = {name: getattr(evaluation, field).get(name) for name in policies}
    files = {name: evaluation.made_with["policy_files"].get(name, {}) for name in policies}
    changed["made_with"] = evaluation.made_with | {"policy_files": files}
    return dataclasses.replace(evaluation, rollouts=runs, rows=[row_of(run) for run in runs], **changed)


def scaled(run: Rollout, policy: str, factor: float, **changes: Any) -> Rollout:
    """The same run as a policy whose tip errs by `factor` times as much."""
    tip = run.tip_reference + factor * (run.tip - run.tip_reference)
    return dataclasses.replace(run, policy=policy, tip=tip, tip_error=factor * run.tip_error, **changes)


def wild(run: Rollout, policy: str, samples: int) -> Rollout:
    """The same run as a policy that swings by a decimetre and ends early, `samples` after the start."""
    swing = 0.1 * np.sin(20.0 * run.time)[:, np.newaxis] * [1.0, -1.0]
    tip = run.tip + swing
    changed = dataclasses.replace(
        run,
        policy=policy,
        completed=False,
        reason="the link velocity left the domain (25) </script ><img src=x onerror=alert(2) >",
        tip=tip,
        tip_error=np.hypot(*(tip - run.tip_reference).T),
        q_link=run.q_link + swing,
    )
    arrays = {name: value for name, value in vars(changed).items() if isinstance(value, np.ndarray)}
    return dataclasses.replace(changed, **{name: value[:samples] for name, value in arrays.items()})
