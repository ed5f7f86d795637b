"""Comparison of learned with model-based policies: tip errors over the seeds of a training, on eight tasks.

    python benchmarks/learned_comparison.py [--learned NAME FOLDER [FOLDER ...]] [--learned ...]
                                            [--json FILE] [--figure FILE.png] [--curves FILE.png]

NAME is the name of a configuration, and each FOLDER the output of `fuzzyarm train ppo --out FOLDER` with another seed;
without --learned these are all folders NAME-SEED of benchmarks/learned. The bundle that is evaluated is `policy`, the
last one of a training. The bundle `best` was selected by the error on the paper's circle, which this table measures;
the smallest of many evaluations is biased by chance, so it is not used. All finished seeds belong into the command, bad
ones included.

The tasks are the paper's three cases and, without load, another radius, two other durations, the other direction and a
lemniscate. A policy of `--preset nominal` was trained on the first of them only. Policies of the robust distribution
were trained on the paper's circle with other loads and plants, and on none of the other motions.

A row holds the largest and the root mean square tip error at 1 kHz, by `fuzzyarm.eval.episodes.metrics`; over seeds,
the interquartile mean and its bootstrap interval of 95 % by `fuzzyarm.eval.evaluation.statistics`. An episode has
failed if it ended early, or if the tip was ever more than 100 mm off, half the radius of the paper's circle: a policy
may lose the path by a metre without leaving the joint limits, and its errors then say nothing about tracking. A column
counts the failed seeds. The errors are those of the other seeds, with a dash if there are none; they say little if many
seeds failed, and the JSON file has the result of each seed. Model-based policies have no seed and nothing is random in
these tasks, so they have a single episode.

The median seed, which is shipped, has the median score. The score is the rms in Case 1 for a policy trained on the
nominal distribution and the mean rms over the three cases for any other, as in the training itself. The figure of
--figure shows this seed on its worst task, beside the model-based policy that is best on it; that of --curves shows the
rms of every seed over the steps of its training.

The second table shows whether a training had reached a plateau: the score in its last tenth divided by that in the
tenth before (`plateau`), as median and range over the seeds. A ratio near 1 means that the error no longer fell when
the training ended. The learning rate is almost zero by then, so this is weaker evidence than a training of twice the
length without improvement. An episode takes about a tenth of a second.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import shlex
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from learned_figures import Shown, Training, WorstTask, draw_learning_curves, draw_worst_tasks, png
from learned_tasks import CONTROL_PERIOD, LOST, MEASURES, TASKS, assess, episode, failure
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.evaluation.statistics import LEVEL, RESAMPLES, SEED, estimate
from fuzzyarm.eval.provenance import provenance
from fuzzyarm.learned_policy.bundle import WEIGHTS
from fuzzyarm.learned_policy.policy import LearnedPolicy

SCHEMA = "fuzzyarm-learned-comparison/1"
MODEL_BASED = ("fuzzy-4", "fuzzy-1", "fuzzy-4-tip", "computed-torque", "computed-torque-tip", "elastic-observer")
ORIENTATION = ("fuzzy-4-tip", "computed-torque")  # beside the learning curves, with the best in each case
BUNDLE, TIMES = "policy", "run.json"
MEASURED_TIMES = {"wall_time_s": "wall time of a seed [s]", "cpu_time_s": "processor time [s]"}
# In which the seeds of one configuration may differ: nothing of it changes what is learned from a seed.
OF_THE_RUN = ("seed", "steps_done", "threads", "evaluation_interval", "checkpoint_interval", "tensorboard")
ROOT = Path(__file__).resolve().parents[1]
LEARNED = ROOT / "benchmarks" / "learned"  # the trainings of the repository, NAME-SEED/


@dataclasses.dataclass(frozen=True)
class TrainedSeed:
    """A finished training.

    Attributes:
        folder: of the training.
        policy: its last bundle at work.
        times: of the training [s] by `MEASURED_TIMES`; None where it was not recorded.
    """

    folder: Path
    policy: LearnedPolicy
    times: dict[str, float | None]

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return self.policy.bundle.seed

    @property
    def training(self) -> dict[str, Any]:
        """The configuration, and the steps that were done."""
        return self.policy.bundle.training

    @property
    def distribution(self) -> str:
        """What was trained on."""
        return str(self.training.get("distribution"))

    @property
    def curve(self) -> list[dict[str, Any]]:
        """What was measured on the way."""
        return self.policy.bundle.curve


def trained_seed(folder: Path) -> TrainedSeed:
    """Load the last bundle of a finished training.

    Raises:
        ValueError: there is none, it is damaged, or the training is unfinished.
    """
    if not (folder / BUNDLE).is_dir():
        raise ValueError(
            f"{folder} has no folder {BUNDLE}/; give the folder that --out of fuzzyarm train ppo named, and let the "
            "training end"
        )
    policy = load_policy(folder / BUNDLE, control_period=CONTROL_PERIOD)
    assert isinstance(policy, LearnedPolicy)
    training = policy.bundle.training
    done, asked = training.get("steps_done"), training.get("steps")
    if not (isinstance(done, int) and isinstance(asked, int)):
        raise ValueError(f"{folder / BUNDLE} does not say how many steps it was trained for; train anew")
    if done < asked:
        raise ValueError(
            f"{folder} is unfinished, {done} of {asked} steps; go on with fuzzyarm train ppo --resume --out {folder}"
        )
    measured = ("steps", *(f"{case}_rms_mm" for case in CASES))
    curve = policy.bundle.curve
    if not (curve and all(_is_number(row.get(key)) and row[key] > 0 for row in curve for key in measured)):
        raise ValueError(f"{folder / BUNDLE} has no curve with positive {', '.join(measured)} in all rows; train anew")
    return TrainedSeed(folder, policy, _times(folder / TIMES))


def trained_seeds(name: str, folders: Sequence[Path]) -> list[TrainedSeed]:
    """Load the seeds of one configuration, in the order of their seeds.

    Raises:
        ValueError: as `trained_seed`; or there are none, one comes twice, or they are of several configurations.
    """
    if not folders:
        raise ValueError(f"--learned {name} names no folder; give one or more: --learned NAME FOLDER [FOLDER ...]")
    runs = sorted((trained_seed(folder) for folder in folders), key=lambda run: run.seed)
    first, by_seed = runs[0], {runs[0].seed: runs[0]}
    for run in runs[1:]:
        if run.seed in by_seed:
            raise ValueError(
                f"--learned {name}: {by_seed[run.seed].folder} and {run.folder} both have seed {run.seed}; give each "
                "seed once"
            )
        by_seed[run.seed] = run
        ours, theirs = configuration(first.training), configuration(run.training)
        differing = [key for key in sorted({*ours, *theirs}) if ours.get(key) != theirs.get(key)]
        if differing:
            raise ValueError(
                f"--learned {name}: {first.folder} and {run.folder} differ in {', '.join(differing)}; give each "
                "configuration a name of its own"
            )
    return runs


def configuration(training: Mapping[str, Any]) -> dict[str, Any]:
    """Return of a bundle's training what all seeds share."""
    return {key: value for key, value in training.items() if key not in OF_THE_RUN}


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
    """Return the cases in which what was trained on a distribution is judged: Case 1 for ``"nominal"``, else all."""
    return ("nominal",) if distribution == "nominal" else tuple(CASES)


def scores(records: Sequence[dict[str, Any]], distribution: str) -> dict[int, float]:
    """Return by seed what it is judged by [mm]: the mean rms over the judged cases, infinite if one failed.

    Args:
        records: of one learned policy's seeds.
        distribution: what was trained on, see `judged_cases`.
    """
    judged = judged_cases(distribution)
    result: dict[int, float] = {}
    for seed in dict.fromkeys(record["seed"] for record in records):
        found = [record for record in records if record["seed"] == seed and record["task"] in judged]
        failed = any(record["failed"] for record in found)
        result[seed] = math.inf if failed else statistics.mean(record["tip_error_rms_mm"] for record in found)
    return result


def plateau(curve: Sequence[Mapping[str, Any]], distribution: str) -> float | None:
    """Return how the score at the end of a training compares with that just before: 1 if nothing changed any more.

    With S the steps of the last evaluation and the score the mean rms over the judged cases, it is

        mean score over 0.9 S < steps <= S  /  mean score over 0.8 S < steps <= 0.9 S.

    Args:
        curve: of a bundle, one mapping per evaluation, the last one last.
        distribution: what was trained on, see `judged_cases`.

    Returns:
        The ratio; None if one of the two has no evaluation, or if in a judged case one ended early.
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
    """Return the seed with the median score; of an even number the better of the middle two, of equal ones the first.

    It is always a seed that was run, and a failed one only if half of them or more failed.
    """
    ranked = sorted(score, key=lambda seed: (score[seed], seed))
    return ranked[(len(ranked) - 1) // 2]


def compare(
    learned: Mapping[str, Sequence[TrainedSeed]], command: str, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Run everything and return the document; `progress` is called with a line before each policy."""
    records, described = [], []
    for name in MODEL_BASED:
        progress(name)
        records += assess(load_policy(name, control_period=CONTROL_PERIOD), name, None)
    for name, runs in learned.items():
        own = []
        for run in runs:
            progress(f"{name}, seed {run.seed}")
            own += assess(run.policy, name, run.seed)
        described.append(_described(name, runs, scores(own, runs[0].distribution)))
        records += own
    return {
        "schema": SCHEMA,
        "command": command,
        **provenance(),
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
    """Return what there is to say of a configuration and of its seeds."""
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
    """Return a folder as seen from the repository's root; of one elsewhere its name, the rest is nobody's business."""
    folder = folder.resolve()
    return folder.relative_to(ROOT).as_posix() if folder.is_relative_to(ROOT) else folder.name


def _command(given: Sequence[Sequence[str]]) -> str:
    """Return the command with what `--learned` names."""
    words = ["python", "benchmarks/learned_comparison.py"]
    for name, *folders in given:
        words += ["--learned", name, *(_folder_name(Path(folder)) for folder in folders)]
    return shlex.join(words)


def _times(path: Path) -> dict[str, float | None]:
    """Return what a training's `TIMES` has of `MEASURED_TIMES`."""
    if not path.exists():
        return dict.fromkeys(MEASURED_TIMES)
    try:
        times = {name: json.loads(path.read_text(encoding="utf-8")).get(name) for name in MEASURED_TIMES}
    except (ValueError, AttributeError):
        raise ValueError(f"{path} is damaged: it must be a JSON mapping; remove it for dashes instead") from None
    for name, seconds in times.items():
        if seconds is not None and not (_is_number(seconds) and 0.0 <= seconds < math.inf):
            raise ValueError(f"{path} is damaged: {name} must be a number of seconds; remove it for a dash instead")
    return times


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def error_cells(document: Mapping[str, Any]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return the headings, and for each row the title of its task and the cells, which are text."""
    titles = {task["name"]: task["title"] for task in document["tasks"]}
    rows = []
    for row in document["rows"]:
        errors = ["-" if row[key] is None else _spread(*row[key].values()) for key in MEASURES]
        rows.append((titles[row["task"]], [row["policy"], *errors, f"{row['failed']} of {row['episodes']}"]))
    return ["policy", *MEASURES.values(), "failed"], rows


def training_cells(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return headings and cells of the trainings; a dash for what is not there of every seed."""
    rows = []
    for one in document["learned"]:
        runs = one["runs"]
        times = [_median([run[name] for run in runs], "{:.0f}") for name in MEASURED_TIMES]
        ratio = _median([run["plateau"] for run in runs], "{:.2f}")
        seeds = ", ".join(str(run["seed"]) for run in runs)
        steps = ", ".join(f"{count:,}" for count in sorted({run["steps"] for run in runs}))
        rows.append([one["name"], seeds, str(one["median_seed"]), steps, *times, ratio])
    headings = ["learned policy", "seeds", "median seed", "steps of a seed", *MEASURED_TIMES.values()]
    return [*headings, "last tenth / tenth before"], rows


def _median(values: Sequence[float | None], form: str) -> str:
    """Return the median and the range; a dash if a value is missing."""
    there = [value for value in values if value is not None]
    if len(there) < len(values):
        return "-"
    return "{} ({} to {})".format(*map(form.format, (statistics.median(there), min(there), max(there))))


def _spread(mean: float, low: float | None, high: float | None) -> str:
    return _number(mean) if low is None or high is None else f"{_number(mean)} ({_number(low)} to {_number(high)})"


def _number(value: float) -> str:
    """Return a number with three digits, or all before the point."""
    return f"{value:#.3g}" if value < 99.95 else f"{value:.0f}"


def print_tables(document: Mapping[str, Any], console: Console) -> None:
    """Print both tables: with lines in a terminal, plain columns when piped."""
    headings, rows = error_cells(document)
    table, last = _table(headings, console.is_terminal), None
    for title, cells in rows:
        if title != last:
            table.add_section()
            table.add_row(Text(title, style="bold"))
            last = title
        table.add_row(*map(Text, cells))
    console.print(table)
    console.print(
        "\nTip error, interquartile mean over the seeds that did not fail (bootstrap interval of 95 %); failed: ended "
        f"early, or the tip was ever more than {LOST:g} mm off. Where a heading does not say otherwise, on the paper's "
        "circle in 1.5 s.\n",
        highlight=False,
        soft_wrap=True,
    )
    headings, trainings = training_cells(document)
    table = _table(headings, console.is_terminal)
    for cells in trainings:
        table.add_row(*map(Text, cells))
    console.print(table)
    console.print(
        "\nTimes and ratios: median over the seeds (range). Last tenth / tenth before: of a training, the mean rms in "
        "the cases by which it is judged.",
        highlight=False,
        soft_wrap=True,
    )


def _table(headings: Sequence[str], terminal: bool) -> Table:
    table = Table(box=box.SIMPLE_HEAD if terminal else None, pad_edge=False, padding=(0, 1, 0, 0))
    for column, heading in enumerate(headings):
        table.add_column(Text(heading), justify="right" if column else "left", no_wrap=not terminal or not column)
    return table


def worst_task(records: Sequence[dict[str, Any]]) -> str:
    """Return the task with the largest rms among some records, or among those that failed if there are any."""
    worst: str = max(records, key=lambda record: (record["failed"] is not None, record["tip_error_rms_mm"]))["task"]
    return worst


def best_model_based(records: Sequence[dict[str, Any]], task: str) -> str:
    """Return the model-based policy with the smallest rms on a task; one that failed comes last."""
    found = [record for record in records if record["task"] == task and record["seed"] is None]
    best: str = min(found, key=lambda record: (record["failed"] is not None, record["tip_error_rms_mm"]))["policy"]
    return best


def worst_tasks(document: Mapping[str, Any], learned: Mapping[str, Sequence[TrainedSeed]]) -> list[WorstTask]:
    """Return for each learned policy's median seed the task where it is worst, run again beside the best rival's."""
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
    """Return an episode with what the legend says of it."""
    how, sample = failure(run) or ("", None)
    label = f"{run.policy}: rms {_number(metrics_of(run)['tip_error_rms_mm'])} mm"
    return Shown(run, f"{label}, {how}" if how else label, sample)


def trainings(document: Mapping[str, Any], learned: Mapping[str, Sequence[TrainedSeed]]) -> list[Training]:
    """Return the curves of every seed."""
    return [
        Training(one["name"], {run.seed: run.curve for run in learned[one["name"]]}, one["median_seed"])
        for one in document["learned"]
    ]


def orientation(document: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return by case the rms [mm] of `ORIENTATION` and of the best model-based policy, but for any that failed."""
    levels: dict[str, dict[str, float]] = {}
    for case in CASES:
        rows = {row["policy"]: row["tip_error_rms_mm"] for row in document["rows"] if row["task"] == case}
        wanted = dict.fromkeys((*ORIENTATION, best_model_based(document["episodes"], case)))
        levels[case] = {policy: rows[policy]["mean"] for policy in wanted if rows[policy] is not None}
    return levels


def _checked_outputs(options: argparse.Namespace) -> None:
    """Refuse before anything runs what could not be written in the end."""
    for flag, path in (("--json", options.json), ("--figure", options.figure), ("--curves", options.curves)):
        if path is not None and (path.is_dir() or not path.parent.is_dir()):
            raise ValueError(f"{flag} {path} must be a file in a folder that is there; make the folder first")
        if path is not None and flag != "--json" and path.suffix != ".png":
            raise ValueError(f"{flag} {path} must end in .png")


def _found() -> list[list[str]]:
    """Return of the folder `LEARNED` what `--learned` would name: each name, then its folders."""
    groups: dict[str, list[str]] = {}
    for folder in sorted(LEARNED.iterdir()) if LEARNED.is_dir() else []:
        if folder.is_dir():
            name, dash, _ = folder.name.rpartition("-")
            if not (name and dash):
                raise ValueError(
                    f"{folder} must be called NAME-SEED; rename it, or give --learned NAME FOLDER [FOLDER ...]"
                )
            groups.setdefault(name, [name]).append(str(folder))
    if not groups:
        raise ValueError(f"{LEARNED} holds no folder NAME-SEED; give --learned NAME FOLDER [FOLDER ...]")
    return list(groups.values())


def _chosen(given: Sequence[Sequence[str]]) -> dict[str, list[TrainedSeed]]:
    """Load what `--learned` names."""
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
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="also draw the worst tasks")
    parser.add_argument("--curves", type=Path, metavar="FILE.png", help="also draw the learning curves")
    options = parser.parse_args(arguments)
    try:
        _checked_outputs(options)
        learned = _chosen(options.learned or _found())
        command = _command(options.learned)
        document = compare(learned, command, lambda line: print(line, file=sys.stderr, flush=True))
        files: dict[Path, str | bytes] = {}
        if options.json:
            files[options.json] = json.dumps(document, indent=1, allow_nan=False) + "\n"
        if options.figure:
            files[options.figure] = png(lambda: draw_worst_tasks(worst_tasks(document, learned)))
        if options.curves:
            rows, levels = trainings(document, learned), orientation(document)
            files[options.curves] = png(lambda: draw_learning_curves(rows, levels))
        for path, content in files.items():
            write_atomically(path, content)
    except OSError as error:
        print(f"{error.filename}: {error.strerror}" if error.filename else error, file=sys.stderr)
        return 2
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    console = Console()
    print_tables(document, console if console.is_terminal else Console(width=200))
    return 0


if __name__ == "__main__":
    sys.exit(main())
