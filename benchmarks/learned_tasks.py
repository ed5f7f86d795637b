"""The eight tasks of `learned_comparison.py`, an episode of a task, and what counts as a failure."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.metrics import LOST, metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout, record_rollout
from fuzzyarm.fuzzy_policy.policy import Predictor

CONTROL_PERIOD = 1e-3  # s
MEASURES = {"tip_error_max_mm": "max [mm]", "tip_error_rms_mm": "rms [mm]"}


@dataclasses.dataclass(frozen=True)
class Task:
    """A motion to be followed, and the load under which it is followed.

    Attributes:
        name: key in the document.
        title: heading in the table.
        case: name of the case.
        reference: the motion.
    """

    name: str
    title: str
    case: str = "nominal"
    reference: JointReference = dataclasses.field(default_factory=JointReference)


TASKS = {
    task.name: task
    for task in (
        *(Task(name, CASES[name].title, name) for name in PAPER_CASES),
        Task("small", "Case 1, radius 0.15 m", reference=JointReference(Circle(radius=0.15))),
        Task("fast", "Case 1, in 1.2 s", reference=JointReference(duration=1.2)),
        Task("slow", "Case 1, in 2.0 s", reference=JointReference(duration=2.0)),
        Task("backward", "Case 1, counter-clockwise", reference=JointReference(Circle(turns=1.0))),
        Task(  # about as long as the circle, 0.61 to 0.89 m from the base where the arm reaches 1 m
            "lemniscate",
            "Case 1, lemniscate",
            reference=JointReference(Lemniscate(center=(0.35, 0.65), half_width=0.2, angle=0.75 * math.pi)),
        ),
    )
}


def episode(policy: Predictor, name: str, task: Task) -> Rollout:
    """Run one episode of a task."""
    env = FuzzyArmEnv(task.case, reference=task.reference, control_period=CONTROL_PERIOD)
    return record_rollout(env, policy, policy_name=name, case=task.case, seed=0)


def failure(run: Rollout) -> tuple[str, int] | None:
    """Return ``"ended early"`` or ``"lost the path"`` with the sample where it happened; None if it did not fail."""
    if not run.completed:
        return "ended early", len(run.time) - 1
    far = 1e3 * run.tip_error > LOST
    return ("lost the path", int(np.argmax(far))) if far.any() else None


def assess(policy: Predictor, name: str, seed: int | None) -> list[dict[str, Any]]:
    """Return one record per task; the errors of an episode that ended early are those up to its end."""
    records = []
    for task in TASKS.values():
        run = episode(policy, name, task)
        measured, failed = metrics_of(run), failure(run)
        records.append(
            {
                "policy": name,
                "seed": seed,
                "task": task.name,
                "failed": failed and failed[0],
                "reason": run.reason,
                "ended_at": float(run.time[-1]),
                **{key: measured[key] for key in MEASURES},
            }
        )
    return records
