"""Learned policies beside model-based ones: tip errors over the seeds of a training, on eight tasks.

    python benchmarks/learned_comparison.py [--json FILE]

Every folder NAME-SEED of benchmarks/learned for the arm of Table 1 is compared: `fuzzyarm train ppo --out FOLDER` with
another seed. Of each training the bundle `policy`, the last one, is run. The bundle `best` would flatter it: it was
selected for the smallest error on the paper's circle, which is what this table measures. The folder should hold all
finished seeds, the bad ones too.

The tasks are the paper's three cases and, without load, another radius, two other durations, the other direction and a
lemniscate. A policy of `--preset nominal` has seen only the first of them in its training. Those trained on the robust
distribution have seen the paper's circle, under other loads and on other plants, and none of the other motions.

A row holds the largest and the root mean square tip error at 1 kHz, by `fuzzyarm.eval.episodes.metrics`; over seeds it
holds the interquartile mean and its bootstrap interval of 95 %, by `fuzzyarm.eval.evaluation._statistics`. An episode
has failed if it ended early, or if the tip was ever more than 100 mm off, half the radius of the paper's circle: a
policy can lose the path by a metre without leaving the joints' box. The errors are those of the other seeds; they say
little where seeds failed. The JSON file holds the result of each seed. The model-based policies have no seed, and
nothing is random in these tasks, so that one episode is enough.

The median seed, the one that is shipped, has the median score. The score is the rms in Case 1 for a policy trained on
the nominal distribution, and the mean rms over the three cases for any other; the training itself uses the same two
rules. `plateau` is the score in the last tenth of the training over that in the tenth before. A ratio near 1 says that
the error no longer fell when the training ended. Since the learning rate is nearly zero by then, this is weaker
evidence than a training of twice the length without a gain. An episode takes about a tenth of a second.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from learned_tasks import CONTROL_PERIOD, LOST, MEASURES, TASKS, assess
from measuring import options_of, printed, write

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.evaluation._statistics import _RESAMPLES as RESAMPLES
from fuzzyarm.eval.evaluation._statistics import LEVEL, SEED, estimate
from fuzzyarm.fuzzy_policy.laws.learned.bundle import WEIGHTS, PolicyBundle

SCHEMA = "fuzzyarm-learned-comparison/1"
MODEL_BASED = ("fuzzy-4", "fuzzy-1", "fuzzy-4-tip", "computed-torque", "computed-torque-tip", "elastic-observer")
ROOT = Path(__file__).resolve().parents[1]
LEARNED = ROOT / "benchmarks" / "learned"  # the trainings of the repository, NAME-SEED/
TIMES = ("wall_time_s", "cpu_time_s")
# The settings in which the seeds of one configuration may differ, because nothing that is learned depends on them.
OF_THE_RUN = ("seed", "steps_done", "threads", "evaluation_interval", "checkpoint_interval", "tensorboard")


class TrainedSeed(NamedTuple):
    """A finished training: its folder, the policy of its last bundle, and the bundle."""

    folder: Path
    policy: Any
    bundle: PolicyBundle

    @property
    def configuration(self) -> dict[str, Any]:
        """The settings that all seeds of a training share."""
        return {key: value for key, value in self.bundle.training.items() if key not in OF_THE_RUN}


def trained_seeds() -> dict[str, list[TrainedSeed]]:
    """Return the trainings in the folder `LEARNED` for the arm of Table 1, by name, in the order of their seeds.

    Raises:
        ValueError: a training is unfinished, a seed comes twice, or the seeds of a name have other settings.
    """
    groups: dict[str, list[TrainedSeed]] = {}
    for folder in sorted(LEARNED.glob("*-[0-9]*/")):
        bundle = PolicyBundle.load(folder / "policy")
        if bundle.arm is None or bundle.arm.digest == robot_of(ArmParameters()).digest:
            asked = bundle.training.get("total_timesteps", bundle.training.get("steps"))  # ``steps``: earlier trainings
            if bundle.training["steps_done"] < asked:
                raise ValueError(f"{folder} is unfinished; the command that began it goes on")
            policy = load_policy(folder / "policy", control_period=CONTROL_PERIOD)
            groups.setdefault(folder.name.rpartition("-")[0], []).append(TrainedSeed(folder, policy, bundle))
    for name, runs in groups.items():
        runs.sort(key=lambda run: run.bundle.seed)
        if len({run.bundle.seed for run in runs}) < len(runs):
            raise ValueError(f"{name}: two trainings have the same seed")
        if any(run.configuration != runs[0].configuration for run in runs):
            raise ValueError(f"{name}: the settings of its seeds differ; give each configuration a name of its own")
    return groups


def compare() -> dict[str, Any]:
    """Run everything and return the document."""
    records, described = [], []
    for name in MODEL_BASED:
        records += printed(assess(load_policy(name, control_period=CONTROL_PERIOD), name, None))
    for name, runs in trained_seeds().items():
        own = [record for run in runs for record in printed(assess(run.policy, name, run.bundle.seed))]
        described.append(_described(name, runs, scores(own, str(runs[0].bundle.training.get("distribution")))))
        records += own
    return {
        "schema": SCHEMA,
        "method": {
            "control_period": CONTROL_PERIOD,
            "mean": "interquartile",
            "interval": {"method": "percentile bootstrap", "level": LEVEL, "resamples": RESAMPLES, "seed": SEED},
            "failed": {
                "lost_mm": LOST,
                "rule": f"ended early, or the tip was ever more than {LOST:g} mm off; not among the errors",
            },
        },
        "tasks": [
            {
                **{"name": task.name, "title": task.title, "case": task.case, "duration": task.reference.duration},
                "path": {"curve": type(path := task.reference.path).__name__, **dataclasses.asdict(path)},
            }
            for task in TASKS.values()
        ],
        "learned": described,
        "rows": summarised(records),
        "episodes": records,
    }


def _described(name: str, runs: Sequence[TrainedSeed], score: Mapping[int, float]) -> dict[str, Any]:
    """Return the part of the document on a configuration and its seeds."""
    rows = []
    for folder, _, bundle in runs:
        times = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        finite = math.isfinite(score[bundle.seed])
        rows.append(
            {
                "folder": folder.relative_to(ROOT).as_posix(),
                "seed": bundle.seed,
                "steps": bundle.training["steps_done"],
                **{key: times.get(key) for key in TIMES},
                "score_mm": score[bundle.seed] if finite else None,
                "plateau": plateau(bundle.curve, str(bundle.training.get("distribution"))),
                "weights_sha256": hashlib.sha256((folder / "policy" / WEIGHTS).read_bytes()).hexdigest(),
                "versions": bundle.versions,
            }
        )
    return {"name": name, "training": runs[0].configuration, "median_seed": median_seed(score), "runs": rows}


def summarised(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per task and policy: how many episodes, how many failed, and the errors of the others.

    Each error is a mapping of ``mean``, ``low`` and ``high`` [mm] by `estimate`, None if every episode failed.
    """
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for record in records:
        groups.setdefault((record["task"], record["policy"]), []).append(record)
    rows = []
    for (task, policy), group in sorted(groups.items(), key=lambda item: list(TASKS).index(item[0][0])):
        good = [record for record in group if record["failed"] is None]
        row = {"task": task, "policy": policy, "episodes": len(group), "failed": len(group) - len(good)}
        errors = {key: [record[key] for record in good] for key in MEASURES}
        rows.append(row | {key: estimate(values)._asdict() if values else None for key, values in errors.items()})
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


def main() -> None:
    """Run all, print and optionally write."""
    options = options_of(__doc__).parse_args()
    write(options.json, "learned_comparison.py", **compare())


if __name__ == "__main__":
    main()
