"""Learned policies beside model-based ones: tip errors over the seeds of a training, on eight tasks.

    python benchmarks/learned_comparison.py --learned NAME FOLDER [FOLDER ...] [--learned ...]
                                            [--json FILE] [--figure FILE.png]

NAME is what one configuration is called, each FOLDER what `fuzzyarm train ppo --out FOLDER` made of it with another
seed. What is run of each is its bundle `policy`, the last one. The bundle `best` was picked for the smallest error on
the paper's circle, which is what this table measures: the smallest of many evaluations says more of luck than the
last. All finished seeds belong into the command, the bad ones too.

The tasks: the paper's three cases, and without load another radius, two other durations, the other direction and an
eight. A policy of `--preset nominal` has seen the first of them only. Those trained on the robust distribution have
seen the paper's circle, under other loads and on other plants, and none of the other motions.

A row holds the largest and the root mean square tip error at 1 kHz, by `fuzzyarm.eval.metrics`; over seeds the
interquartile mean and its bootstrap interval of 95 % by `fuzzyarm.eval.statistics`. An episode that ended early has
failed: how many of the seeds did is a column, and the errors are of the others alone, a dash where there is none. An
error says little where seeds failed; what each seed did is in the JSON file. The model-based policies have no seed,
and nothing is random in these tasks: one episode is all there is.

The median seed, the one to ship, has the median score: the rms in Case 1 of a policy trained on the nominal
distribution, the mean rms over the three cases of any other, the two rules by which the training itself judges. The
figure shows it on the task where it is worst, beside the model-based policy that is best there. About a tenth of a
second per episode.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import io
import json
import math
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fuzzyarm import load_policy
from fuzzyarm.envs.disturbances import CASES
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.paths import Circle, Lemniscate
from fuzzyarm.envs.reference import JointReference
from fuzzyarm.eval import figures
from fuzzyarm.eval.metrics import metrics
from fuzzyarm.eval.provenance import provenance
from fuzzyarm.eval.rollout import Policy, Rollout, rollout
from fuzzyarm.eval.statistics import LEVEL, RESAMPLES, SEED, estimate
from fuzzyarm.files import write_atomically
from fuzzyarm.learned_policy.bundle import WEIGHTS
from fuzzyarm.learned_policy.policy import LearnedPolicy

SCHEMA = "fuzzyarm-learned-comparison/1"
MODEL_BASED = ("fuzzy-4", "fuzzy-1", "fuzzy-4-tip", "computed-torque", "computed-torque-tip", "elastic-observer")
CONTROL_PERIOD = 1e-3  # s
MEASURES = {"tip_error_max_mm": "max [mm]", "tip_error_rms_mm": "rms [mm]"}
BUNDLE, TIMES = "policy", "run.json"
# In which the seeds of one configuration may differ: nothing of it changes what is learned from a seed.
OF_THE_RUN = ("seed", "steps_done", "threads", "evaluation_interval", "checkpoint_interval", "tensorboard")
MAGNIFICATIONS = (100, 50, *figures.MAGNIFICATIONS)  # of a deviation in the figure, the largest that has room


@dataclasses.dataclass(frozen=True)
class Task:
    """What is to be followed, and under which load.

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
        *(Task(case.name, case.title, case.name) for case in CASES.values()),
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


@dataclasses.dataclass(frozen=True)
class TrainedSeed:
    """A finished training.

    Attributes:
        folder: of the training.
        policy: its last bundle at work.
        wall_time: of the training [s]; None if it was not recorded.
    """

    folder: Path
    policy: LearnedPolicy
    wall_time: float | None

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return self.policy.bundle.seed

    @property
    def training(self) -> dict[str, Any]:
        """The configuration, and the steps that were done."""
        return self.policy.bundle.training


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
    return TrainedSeed(folder, policy, _wall_time(folder / TIMES))


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


def episode(policy: Policy, name: str, task: Task) -> Rollout:
    """Run one episode of a task."""
    env = FuzzyArmEnv(task.case, reference=task.reference, control_period=CONTROL_PERIOD)
    return rollout(env, policy, policy_name=name, case=task.case, seed=0)


def assess(policy: Policy, name: str, seed: int | None) -> list[dict[str, Any]]:
    """Return one record per task; errors of an episode that ended early are those up to its end."""
    records = []
    for task in TASKS.values():
        run = episode(policy, name, task)
        measured = metrics(run)
        records.append(
            {
                "policy": name,
                "seed": seed,
                "task": task.name,
                "completed": run.completed,
                "reason": run.reason,
                "ended_at": float(run.time[-1]),
                **{key: measured[key] for key in MEASURES},
            }
        )
    return records


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
            completed = [record for record in group if record["completed"]]
            row = {"task": task, "policy": policy, "episodes": len(group), "failed": len(group) - len(completed)}
            for key in MEASURES:
                values = [record[key] for record in completed]
                row[key] = estimate(values)._asdict() if values else None
            rows.append(row)
    return rows


def scores(records: Sequence[dict[str, Any]], distribution: str) -> dict[int, float]:
    """Return by seed what it is judged by [mm]: the mean rms over the judged cases, infinite if one ended early.

    Args:
        records: of one learned policy's seeds.
        distribution: what was trained on; ``"nominal"`` is judged in Case 1, any other in the three cases.
    """
    judged = ("nominal",) if distribution == "nominal" else tuple(CASES)
    result: dict[int, float] = {}
    for seed in dict.fromkeys(record["seed"] for record in records):
        found = [record for record in records if record["seed"] == seed and record["task"] in judged]
        complete = all(record["completed"] for record in found)
        result[seed] = statistics.mean(record["tip_error_rms_mm"] for record in found) if complete else math.inf
    return result


def median_seed(score: Mapping[int, float]) -> int:
    """Return the seed with the median score; of an even number the better of the middle two, of equal ones the first.

    It is always a seed that was run, and a failed one only if half of them or more failed.
    """
    ranked = sorted(score, key=lambda seed: (score[seed], seed))
    return ranked[(len(ranked) - 1) // 2]


def compare(learned: Mapping[str, Sequence[TrainedSeed]], progress: Callable[[str], None]) -> dict[str, Any]:
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
        score = scores(own, runs[0].training.get("distribution", ""))
        described.append(_described(name, runs, score))
        records += own
    return {
        "schema": SCHEMA,
        "command": _command(learned),
        **provenance(),
        "method": {
            "control_period": CONTROL_PERIOD,
            "mean": "interquartile",
            "interval": {"method": "percentile bootstrap", "level": LEVEL, "resamples": RESAMPLES, "seed": SEED},
            "failed": "ended early; not among the errors",
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
                "folder": _folder_name(run),
                "seed": run.seed,
                "steps": run.training["steps_done"],
                "wall_time_s": run.wall_time,
                "score_mm": score[run.seed] if math.isfinite(score[run.seed]) else None,
                "weights_sha256": hashlib.sha256((run.folder / BUNDLE / WEIGHTS).read_bytes()).hexdigest(),
                "versions": run.policy.bundle.versions,
            }
            for run in runs
        ],
    }


def _folder_name(run: TrainedSeed) -> str:
    """Return a folder without where it lies, which is nobody else's business."""
    return run.folder.resolve().name


def _command(learned: Mapping[str, Sequence[TrainedSeed]]) -> str:
    words = [word for name, runs in learned.items() for word in ("--learned", name, *map(_folder_name, runs))]
    return " ".join(["python benchmarks/learned_comparison.py", *words])


def _wall_time(path: Path) -> float | None:
    """Return ``wall_time_s`` of a training's `TIMES` if it has one."""
    if not path.exists():
        return None
    try:
        seconds = json.loads(path.read_text(encoding="utf-8"))["wall_time_s"]
    except (ValueError, KeyError, TypeError):
        seconds = None
    if not _is_number(seconds) or not 0.0 <= seconds < math.inf:
        raise ValueError(f"{path} is damaged: wall_time_s must be a number of seconds; remove it for a dash instead")
    return float(seconds)


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
    """Return headings and cells of the trainings; a dash for a wall time that was not recorded with every seed."""
    rows = []
    for one in document["learned"]:
        runs = one["runs"]
        times = [run["wall_time_s"] for run in runs]
        time = "-"
        if None not in times:
            time = f"{statistics.median(times):.0f} ({min(times):.0f} to {max(times):.0f})"
        seeds = ", ".join(str(run["seed"]) for run in runs)
        steps = ", ".join(f"{count:,}" for count in sorted({run["steps"] for run in runs}))
        rows.append([one["name"], seeds, str(one["median_seed"]), steps, time])
    return ["learned policy", "seeds", "median seed", "steps of a seed", "wall time of a seed [s]"], rows


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
        "\nTip error, interquartile mean over the seeds that did not fail (bootstrap interval of 95 %); failed: "
        "episodes that ended early. Where a heading does not say otherwise, on the paper's circle in 1.5 s.\n",
        highlight=False,
        soft_wrap=True,
    )
    headings, trainings = training_cells(document)
    table = _table(headings, console.is_terminal)
    for cells in trainings:
        table.add_row(*map(Text, cells))
    console.print(table)


def _table(headings: Sequence[str], terminal: bool) -> Table:
    table = Table(box=box.SIMPLE_HEAD if terminal else None, pad_edge=False, padding=(0, 1, 0, 0))
    for column, heading in enumerate(headings):
        table.add_column(Text(heading), justify="right" if column else "left", no_wrap=not terminal or not column)
    return table


def worst_task(records: Sequence[dict[str, Any]]) -> str:
    """Return the task with the largest rms among some records, or among those that failed if there are any."""
    worst: str = max(records, key=lambda record: (not record["completed"], record["tip_error_rms_mm"]))["task"]
    return worst


def best_model_based(records: Sequence[dict[str, Any]], task: str) -> str:
    """Return the model-based policy with the smallest rms on a task; one that failed comes last."""
    found = [record for record in records if record["task"] == task and record["seed"] is None]
    best: str = min(found, key=lambda record: (not record["completed"], record["tip_error_rms_mm"]))["policy"]
    return best


def draw(document: Mapping[str, Any], learned: Mapping[str, Sequence[TrainedSeed]]) -> Figure:
    """Return the figure: a row per learned policy, the path in the plane beside the tip error over time."""
    figure = Figure(figsize=(9.0, 4.6 * len(learned)))
    rows = figure.subfigures(len(learned), 1, squeeze=False)[:, 0]
    for row, one in zip(rows, document["learned"], strict=True):
        name, seed = one["name"], one["median_seed"]
        own = [record for record in document["episodes"] if (record["policy"], record["seed"]) == (name, seed)]
        task = TASKS[worst_task(own)]
        best = best_model_based(document["episodes"], task.name)
        policy = next(run.policy for run in learned[name] if run.seed == seed)
        rival = load_policy(best, control_period=CONTROL_PERIOD)
        runs = [episode(policy, f"{name}, seed {seed}", task), episode(rival, best, task)]
        plane, errors = row.subplots(1, 2)
        _draw_plane(plane, task, runs)
        _draw_errors(errors, runs)
        row.suptitle(f"{name} where it is worst: {task.title}", x=0.01, ha="left", fontsize=10.5, weight="bold")
        row.legend(loc="outside lower center", ncols=3)
    return figure


def _draw_plane(axes: Axes, task: Task, runs: Sequence[Rollout]) -> None:
    """Draw the plane of the arm, y to the right and x down: r and for each policy r + factor (p - r)."""
    reference = task.reference.tip(np.linspace(0.0, task.reference.duration, 1001)).position
    room = figures.ROOM * float(np.ptp(reference, axis=0).max())
    largest = max(float(run.tip_error.max()) for run in runs)
    factor = next((factor for factor in MAGNIFICATIONS if factor * largest <= room), 1)
    for run, look in zip(runs, _looks(), strict=False):
        path = run.tip_reference + factor * (run.tip - run.tip_reference)
        axes.plot(path[:, 1], path[:, 0], **look)
        if not run.completed:
            axes.plot(path[-1, 1], path[-1, 0], "x", color=look["color"], zorder=5.0)
    axes.plot(reference[:, 1], reference[:, 0], **figures.REFERENCE)
    axes.plot(*reference[0, ::-1], "o", color="black", markersize=5, zorder=4.0)
    axes.margins(0.05)
    axes.set(xlabel="y, to the side [m]", ylabel="x, down [m]", title=f"tip, deviation × {factor}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()


def _draw_errors(axes: Axes, runs: Sequence[Rollout]) -> None:
    """Draw the tip error over time, a micrometre at least, and put its rms into the legend of both panels."""
    for run, look in zip(runs, _looks(), strict=False):
        error = 1e3 * np.maximum(run.tip_error, 1e-3 * figures.LOWEST)
        rms = metrics(run)["tip_error_rms_mm"]
        ended = "" if run.completed else ", ended early"
        axes.plot(run.time, error, label=f"{run.policy}: rms {_number(rms)} mm{ended}", **look)
        if not run.completed:
            axes.plot(run.time[-1], error[-1], "x", color=look["color"], clip_on=False, zorder=5.0)
    axes.set(yscale="log", xlabel="time [s]", ylabel="tip error [mm]", title="tip error")


def _looks() -> list[dict[str, Any]]:
    colors = matplotlib.rcParams["axes.prop_cycle"].by_key()["color"]
    return [{"color": color, "linestyle": dashes} for color, dashes in zip(colors, figures.DASHES, strict=False)]


def figure_bytes(document: Mapping[str, Any], learned: Mapping[str, Sequence[TrainedSeed]]) -> bytes:
    """Return the figure as PNG in the project's style."""
    content = io.BytesIO()
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        draw(document, learned).savefig(content, format="png")
    return content.getvalue()


def _checked_outputs(options: argparse.Namespace) -> None:
    """Refuse before anything runs what could not be written in the end."""
    for flag, path in (("--json", options.json), ("--figure", options.figure)):
        if path is not None and (path.is_dir() or not path.parent.is_dir()):
            raise ValueError(f"{flag} {path} must be a file in a folder that is there; make the folder first")
    if options.figure is not None and options.figure.suffix != ".png":
        raise ValueError(f"--figure {options.figure} must end in .png")


def _chosen(given: Sequence[Sequence[str]]) -> dict[str, list[TrainedSeed]]:
    """Load what `--learned` names."""
    if not given or not all(given):
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
        help="a name and the folders of its seeds' trainings; repeatable",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="also draw the worst tasks")
    options = parser.parse_args(arguments)
    try:
        _checked_outputs(options)
        learned = _chosen(options.learned)
        document = compare(learned, lambda line: print(line, file=sys.stderr, flush=True))
        picture = figure_bytes(document, learned) if options.figure else b""
        if options.json:
            write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")
        if options.figure:
            write_atomically(options.figure, picture)
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
