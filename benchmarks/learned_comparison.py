"""Learned policies beside model-based ones: tip errors over the seeds of a training, on eight tasks.

    python benchmarks/learned_comparison.py [--learned NAME FOLDER [FOLDER ...]] [--learned ...]
                                            [--json FILE]

NAME is a name for one configuration, and each FOLDER holds its training by `fuzzyarm train ppo --out FOLDER` with
another seed. Without --learned, every folder NAME-SEED of benchmarks/learned for the arm of Table 1 is compared. Of
each training the bundle `policy`, the last one, is run. The bundle `best` would flatter it: it was selected for the
smallest error on the paper's circle, which is what this table measures. The command should name all finished seeds, the
bad ones too.

The tasks are the paper's three cases and, without load, another radius, two other durations, the other direction and a
lemniscate. A policy of `--preset nominal` has seen only the first of them in its training. Those trained on the robust
distribution have seen the paper's circle, under other loads and on other plants, and none of the other motions.

A row holds the largest and the root mean square tip error at 1 kHz, by `fuzzyarm.eval.episodes.metrics`; over seeds it
holds the interquartile mean and its bootstrap interval of 95 %, by `fuzzyarm.eval.evaluation.statistics`. An episode
has failed if it ended early, or if the tip was ever more than 100 mm off, half the radius of the paper's circle: a
policy can lose the path by a metre without leaving the joints' box. One column counts the seeds that failed. The errors
are those of the other seeds, with a dash if all failed; they say little where seeds failed. The JSON file holds the
result of each seed. The model-based policies have no seed, and nothing is random in these tasks, so that one episode is
enough.

The median seed, the one that is shipped, has the median score. The score is the rms in Case 1 for a policy trained on
the nominal distribution, and the mean rms over the three cases for any other; the training itself uses the same two
rules. One figure shows the median seed on the task where it is worst, beside the model-based policy that is best there,
the other the rms of every seed over the steps of its training.

The second table holds the score in the last tenth of the training over that in the tenth before (`plateau`), as median
and range over the seeds. A ratio near 1 says that the error no longer fell when the training ended. Since the learning
rate is nearly zero by then, this is weaker evidence than a training of twice the length without a gain. An episode
takes about a tenth of a second.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import itertools
import json
import math
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from learned_figures import Shown, Training, WorstTask
from learned_scores import best_model_based, median_seed, plateau, scores, summarised, worst_task
from learned_seeds import BUNDLE, TrainedSeed, configuration, trained_seeds
from learned_tables import print_tables, three_digits
from learned_tasks import CONTROL_PERIOD, LOST, TASKS, assess, episode, failure

from fuzzyarm import load_policy
from fuzzyarm.common.console import output, progress
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.evaluation.statistics import LEVEL, RESAMPLES, SEED
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.laws.learned.bundle import WEIGHTS, PolicyBundle

SCHEMA = "fuzzyarm-learned-comparison/1"
MODEL_BASED = ("fuzzy-4", "fuzzy-1", "fuzzy-4-tip", "computed-torque", "computed-torque-tip", "elastic-observer")
ORIENTATION = ("fuzzy-4-tip", "computed-torque")  # beside the learning curves, with the best in each case
ROOT = Path(__file__).resolve().parents[1]
LEARNED = ROOT / "benchmarks" / "learned"  # the trainings of the repository, NAME-SEED/


def compare(
    learned: Mapping[str, Sequence[TrainedSeed]], command: str, report: Callable[[str], None]
) -> dict[str, Any]:
    """Run everything and return the document; `report` is called with the name of each policy before it runs."""
    records, described = [], []
    for name in MODEL_BASED:
        report(name)
        records += assess(load_policy(name, control_period=CONTROL_PERIOD), name, None)
    for name, runs in learned.items():
        own = []
        for run in runs:
            report(f"{name}, seed {run.seed}")
            own += assess(run.policy, name, run.seed)
        described.append(_described(name, runs, scores(own, runs[0].distribution)))
        records += own
    return {
        "schema": SCHEMA,
        "command": command,
        **current_provenance(),
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
            {"name": task.name, "title": task.title, "case": task.case, **_motion(task.reference)}
            for task in TASKS.values()
        ],
        "learned": described,
        "rows": summarised(records),
        "episodes": records,
    }


def _motion(reference: JointReference) -> dict[str, Any]:
    path = reference.path
    assert isinstance(path, (Circle, Lemniscate))
    return {"path": {"curve": type(path).__name__, **dataclasses.asdict(path)}, "duration": reference.duration}


def _described(name: str, runs: Sequence[TrainedSeed], score: Mapping[int, float]) -> dict[str, Any]:
    """Return the part of the document on a configuration and its seeds."""
    return {
        "name": name,
        "training": configuration(runs[0].training),
        "median_seed": median_seed(score),
        "runs": [
            {
                "folder": _folder_name(run.folder),
                "seed": run.seed,
                "steps": run.training["steps_done"],
                **run.times,
                "score_mm": score[run.seed] if math.isfinite(score[run.seed]) else None,
                "plateau": plateau(run.curve, run.distribution),
                "weights_sha256": hashlib.sha256((run.folder / BUNDLE / WEIGHTS).read_bytes()).hexdigest(),
                "versions": run.policy.bundle.versions,
            }
            for run in runs
        ],
    }


def _folder_name(folder: Path) -> str:
    """Return a folder relative to the repository; of a folder elsewhere only the name, to keep private paths out."""
    folder = folder.resolve()
    return folder.relative_to(ROOT).as_posix() if folder.is_relative_to(ROOT) else folder.name


def _command(given: Sequence[Sequence[str]]) -> str:
    """Return the command that makes the document again, with the folders that `--learned` gave."""
    words = ["python", "benchmarks/learned_comparison.py"]
    for name, *folders in given:
        words += ["--learned", name, *(_folder_name(Path(folder)) for folder in folders)]
    return shlex.join(words)


def worst_tasks(document: Mapping[str, Any], learned: Mapping[str, Sequence[TrainedSeed]]) -> list[WorstTask]:
    """Return, for the median seed of each learned policy, its worst task, run again beside the best rival there."""
    rows = []
    for one in document["learned"]:
        name, seed = one["name"], one["median_seed"]
        own = [record for record in document["episodes"] if (record["policy"], record["seed"]) == (name, seed)]
        task = TASKS[worst_task(own)]
        best = best_model_based(document["episodes"], task.name)
        policy = next(run.policy for run in learned[name] if run.seed == seed)
        mine = _shown(episode(policy, f"{name}, seed {seed}", task))
        rival = _shown(episode(load_policy(best, control_period=CONTROL_PERIOD), best, task))
        where = "where it is worst" if mine.failed_at is None else "where it fails"
        rows.append(WorstTask(f"{name} {where}: {task.title}", task.reference, (mine, rival), LOST))
    return rows


def _shown(run: Rollout) -> Shown:
    """Return an episode with its text in the legend."""
    how, sample = failure(run) or ("", None)
    label = f"{run.policy}: rms {three_digits(metrics_of(run)['tip_error_rms_mm'])} mm"
    return Shown(run, f"{label}, {how}" if how else label, sample)


def trainings(document: Mapping[str, Any], learned: Mapping[str, Sequence[TrainedSeed]]) -> list[Training]:
    """Return the curves of every seed."""
    return [
        Training(one["name"], {run.seed: run.curve for run in learned[one["name"]]}, one["median_seed"])
        for one in document["learned"]
    ]


def orientation(document: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return by case the rms [mm] of `ORIENTATION` and of the best model-based policy, without those that failed."""
    levels: dict[str, dict[str, float]] = {}
    for case in PAPER_CASES:
        rows = {row["policy"]: row["tip_error_rms_mm"] for row in document["rows"] if row["task"] == case}
        wanted = dict.fromkeys((*ORIENTATION, best_model_based(document["episodes"], case)))
        levels[case] = {policy: rows[policy]["mean"] for policy in wanted if rows[policy] is not None}
    return levels


def _found() -> list[list[str]]:
    """Return the trainings in the folder `LEARNED` as `--learned` would give them: each name, then its folders."""
    groups: dict[str, list[str]] = {}
    for folder in sorted(LEARNED.iterdir()) if LEARNED.is_dir() else []:
        if folder.is_dir() and not _knows_another_arm(folder):
            name, dash, _ = folder.name.rpartition("-")
            if not (name and dash):
                raise ValueError(
                    f"{folder} must be called NAME-SEED; rename it, or give --learned NAME FOLDER [FOLDER ...]"
                )
            groups.setdefault(name, [name]).append(str(folder))
    if not groups:
        raise ValueError(f"{LEARNED} holds no folder NAME-SEED; give --learned NAME FOLDER [FOLDER ...]")
    return list(groups.values())


def _knows_another_arm(folder: Path) -> bool:
    """Return whether a training was one for another arm than that of Table 1, which these tasks are for."""
    if not (folder / BUNDLE).is_dir():
        return False  # to be complained about by its name
    arm = PolicyBundle.load(folder / BUNDLE).arm
    return arm is not None and arm.digest != robot_of(ArmParameters()).digest


def chosen_trainings(given: Sequence[Sequence[str]] = ()) -> dict[str, list[TrainedSeed]]:
    """Load the trainings that `--learned` gave, by default all of the repository for the arm of Table 1."""
    given = given or _found()
    if not all(given):
        raise ValueError("no learned policy is named; give --learned NAME FOLDER [FOLDER ...]")
    names = [words[0] for words in given]
    for name in names:
        if names.count(name) > 1 or name in MODEL_BASED:
            raise ValueError(f"--learned {name}: the name is taken; give each configuration one of its own")
    return {name: trained_seeds(name, [Path(folder) for folder in folders]) for name, *folders in given}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all, print and optionally write; return the exit code: 0 fine, 2 bad usage or a file that cannot be used."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--learned",
        nargs="*",
        action="append",
        default=[],
        metavar=("NAME", "FOLDER"),
        help="a name and the folders of its seeds' trainings; repeatable; default: those in benchmarks/learned",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args(arguments)
    try:
        if options.json is not None and (options.json.is_dir() or not options.json.parent.is_dir()):
            raise ValueError(f"--json {options.json} must be a file in a folder that is there; make the folder first")
        learned = chosen_trainings(options.learned)
        command = _command(options.learned)
        count, done = len(MODEL_BASED) + sum(map(len, learned.values())), itertools.count()
        with progress("policies", count) as advance:
            document = compare(learned, command, lambda name: advance(name, completed=next(done)))
        if options.json:
            write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        print(f"{error.filename}: {error.strerror}" if error.filename else error, file=sys.stderr)
        return 2
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print_tables(document, output())
    return 0


if __name__ == "__main__":
    sys.exit(main())
