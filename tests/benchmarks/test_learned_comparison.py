"""The comparison of learned and model-based policies: who is averaged, who is shipped, and what is refused."""

import contextlib
import dataclasses
import importlib.util
import io
import json
import math
import sys
from pathlib import Path

import matplotlib.style
import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.learned_policy.definition import ActionDefinition
from fuzzyarm.rl_baselines.case_evaluation import evaluate_cases

ROOT = Path(__file__).parents[2]


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


comparison = loaded(ROOT / "benchmarks" / "learned_comparison.py")
made = loaded(ROOT / "tests" / "learned_policy" / "made.py")

# A few newton metres at random on top of a good law stay on the path; hundreds alone do not.
GENTLE = ActionDefinition(torque_scale=(3.0, 2.0), base="fuzzy-4-tip")
WILD = ActionDefinition()


def finished_run(folder, seed, action=GENTLE, **training):
    """Write what a training leaves that a comparison reads."""
    folder.mkdir()
    bundle = made.bundle(action, seed)
    recorded = {
        "distribution": "robust",
        "steps": 100,
        "steps_done": 128,
        "seed": seed,
        "threads": seed + 1,
        **training,
    }
    dataclasses.replace(bundle, seed=seed, training=recorded).save(folder / "policy")
    return folder


def run(*words):
    """Return the exit code, stdout and stderr of the command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = comparison.main([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


@dataclasses.dataclass
class Made:
    """One run of the command."""

    code: int
    out: str
    err: str
    text: str
    document: dict
    picture: bytes
    folder: Path


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Three gentle seeds, given in any order, and two wild ones."""
    folder = tmp_path_factory.mktemp("runs")
    gentle = [finished_run(folder / f"gentle-{seed}", seed) for seed in (2, 0, 1)]
    for path, seconds in zip(gentle, (100.0, 300.0, 220.0), strict=True):
        (path / "run.json").write_text(json.dumps({"wall_time_s": seconds}))
    wild = [finished_run(folder / f"wild-{seed}", seed, WILD, distribution="nominal") for seed in (5, 6)]
    files = folder / "r.json", folder / "f.png"
    code, out, err = run(
        "--learned", "gentle", *gentle, "--learned", "wild", *wild, "--json", files[0], "--figure", files[1]
    )
    text = files[0].read_text()
    return Made(code, out, err, text, json.loads(text), files[1].read_bytes(), folder)


def record(seed, rms, task="nominal", completed=True, policy="mine"):
    return {
        "policy": policy,
        "seed": seed,
        "task": task,
        "completed": completed,
        "reason": "" if completed else "a joint angle left the domain (25)",
        "ended_at": 1.5,
        "tip_error_max_mm": 2.0 * rms,
        "tip_error_rms_mm": rms,
    }


def over_cases(seed, *rms, failed=()):
    return [record(seed, one, case, case not in failed) for case, one in zip(comparison.CASES, rms, strict=True)]


def test_errors_are_of_the_middle_seeds():
    (row,) = comparison.summarised([record(seed, rms) for seed, rms in enumerate((9.0, 1.0, 2.0, 3.0, 400.0))])
    assert (row["episodes"], row["failed"]) == (5, 0)
    assert row["tip_error_rms_mm"]["mean"] == pytest.approx(14.0 / 3.0)
    assert row["tip_error_max_mm"]["mean"] == pytest.approx(28.0 / 3.0)
    assert row["tip_error_rms_mm"]["low"] < 14.0 / 3.0 < row["tip_error_rms_mm"]["high"]


def test_failed_episodes_are_counted_and_not_averaged():
    records = [record(seed, rms) for seed, rms in enumerate((1.0, 2.0, 6.0))]
    records += [record(seed, 1e-6, completed=False) for seed in (3, 4)]  # a short episode has a small error
    (row,) = comparison.summarised(records)
    assert (row["episodes"], row["failed"], row["tip_error_rms_mm"]["mean"]) == (5, 2, pytest.approx(3.0))
    (row,) = comparison.summarised(records[3:])
    assert (row["failed"], row["tip_error_rms_mm"], row["tip_error_max_mm"]) == (2, None, None)
    (row,) = comparison.summarised(records[2:])
    assert row["tip_error_rms_mm"] == {"mean": 6.0, "low": None, "high": None}


def test_rows_are_by_task_then_policy():
    tasks = list(comparison.TASKS)
    records = [record(0, 1.0, task, policy=policy) for policy in ("a", "b") for task in reversed(tasks)]
    rows = comparison.summarised(records)
    assert [(row["task"], row["policy"]) for row in rows] == [(task, policy) for task in tasks for policy in "ab"]


def test_seeds_are_judged_as_the_training_judges():
    records = [*over_cases(0, 1.0, 2.0, 6.0), *over_cases(1, 2.0, 1.0, 1.5)]
    records += [record(0, 99.0, "fast", False), record(1, 0.0, "fast")]  # judged by nobody
    assert comparison.scores(records, "nominal") == {0: 1.0, 1: 2.0}
    assert comparison.scores(records, "robust") == {0: pytest.approx(3.0), 1: pytest.approx(1.5)}


def test_a_seed_that_failed_where_it_is_judged_comes_last():
    records = [*over_cases(0, 0.1, 0.1, 0.1, failed=("payload",)), *over_cases(1, 5.0, 5.0, 5.0)]
    assert comparison.scores(records, "nominal") == {0: 0.1, 1: 5.0}
    assert comparison.scores(records, "robust") == {0: math.inf, 1: 5.0}


@pytest.mark.parametrize(
    ("score", "median"),
    [
        ({4: 0.5}, 4),
        ({0: 3.0, 1: 1.0, 2: 2.0, 3: 9.0, 4: 0.1}, 2),
        ({0: 4.0, 1: 1.0, 2: 3.0, 3: 2.0}, 3),  # the better of the middle two
        ({0: 2.0, 1: 1.0}, 1),
        ({3: 1.0, 1: 1.0, 2: 1.0}, 2),  # all equal: as if ranked by seed
        ({4: 1.0, 3: 2.0, 1: 2.0, 2: 2.0, 0: 5.0}, 2),
        ({0: math.inf, 1: 1.0, 2: math.inf, 3: 2.0, 4: 3.0}, 4),  # the last that did not fail
        ({0: math.inf, 1: 1.0, 2: math.inf}, 0),  # most failed: so does the median
    ],
)
def test_median_seed(score, median):
    assert comparison.median_seed(score) == median
    assert comparison.median_seed(dict(reversed(score.items()))) == median


def test_worst_task_and_its_best_rival():
    own = [record(0, 5.0, "nominal"), record(0, 9.0, "fast"), record(0, 7.0, "slow")]
    assert comparison.worst_task(own) == "fast"
    assert comparison.worst_task([*own, record(0, 0.1, "small", completed=False)]) == "small"
    rivals = [record(None, rms, "fast", policy=name) for name, rms in (("a", 3.0), ("b", 2.0), ("c", 4.0))]
    others = [record(1, 0.5, "fast", policy="learned too"), record(None, 0.4, "slow", policy="c")]
    assert comparison.best_model_based([*rivals, *others], "fast") == "b"
    assert comparison.best_model_based([*rivals, record(None, 0.1, "fast", False, "d")], "fast") == "b"


def test_tasks_are_what_their_titles_say():
    reach = sum(ArmParameters().length)
    center = np.array([0.35, 0.65])
    found = {}
    for name, task in comparison.TASKS.items():
        duration = task.reference.duration
        p = task.reference.tip(np.linspace(0.0, duration, 2001)).position - center
        area = 0.5 * np.sum(p[:-1, 0] * p[1:, 1] - p[1:, 0] * p[:-1, 1])  # positive from +x towards +y
        found[name] = (task.case, duration, round(float(area), 5))
        assert 0.3 * reach < np.hypot(*(p + center).T).min()
        assert np.hypot(*(p + center).T).max() < 0.95 * reach
    circle, small = round(math.pi * 0.2**2, 5), round(math.pi * 0.15**2, 5)
    assert found == {
        "nominal": ("nominal", 1.5, -circle),
        "machining": ("machining", 1.5, -circle),
        "payload": ("payload", 1.5, -circle),
        "small": ("nominal", 1.5, -small),
        "fast": ("nominal", 1.2, -circle),
        "slow": ("nominal", 2.0, -circle),
        "backward": ("nominal", 1.5, circle),
        "lemniscate": ("nominal", 1.5, 0.0),
    }


def test_document_holds_every_episode_and_where_it_is_from(result):
    document = result.document
    assert result.code == 0
    assert {"schema", "command", "commit", "versions", "machine", "method", "tasks", "learned"} <= set(document)
    assert len(document["episodes"]) == 8 * (6 + 3 + 2)
    keys = {(one["policy"], one["seed"], one["task"]) for one in document["episodes"]}
    learned = [("gentle", 0), ("gentle", 1), ("gentle", 2), ("wild", 5), ("wild", 6)]
    policies = [*((name, None) for name in comparison.MODEL_BASED), *learned]
    assert keys == {(*policy, task) for policy in policies for task in comparison.TASKS}
    gentle, wild = document["learned"]
    assert [one["seed"] for one in gentle["runs"]] == [0, 1, 2]
    assert [one["wall_time_s"] for one in gentle["runs"]] == [300.0, 220.0, 100.0]
    assert [one["folder"] for one in wild["runs"]] == ["wild-5", "wild-6"]
    assert len({one["weights_sha256"] for one in gentle["runs"]}) == 3
    assert wild["training"] == {"distribution": "nominal", "steps": 100}
    assert str(result.folder) not in result.text  # where it lay on this machine is of no use to others
    circle = document["tasks"][0]
    assert (circle["path"]["curve"], circle["path"]["radius"], circle["duration"]) == ("Circle", 0.2, 1.5)


def test_table_is_made_again_from_the_document(result):
    assert comparison.summarised(result.document["episodes"]) == result.document["rows"]
    out = io.StringIO()
    comparison.print_tables(result.document, comparison.Console(file=out, width=200))
    assert out.getvalue() == result.out


def test_failed_and_completed_seeds_in_the_table(result):
    lines = [line.split() for line in result.out.splitlines()]
    assert "\x1b" not in result.out
    gentle = [line for line in lines if line[:1] == ["gentle"]]
    assert [line[-3:] for line in gentle[:8]] == [["0", "of", "3"]] * 8
    assert gentle[8][1:5] == ["0,", "1,", "2", str(result.document["learned"][0]["median_seed"])]
    assert gentle[8][5:] == ["128", "220", "(100", "to", "300)"]
    wild = [line for line in lines if line[:1] == ["wild"]]
    assert ["wild", "-", "-", "2", "of", "2"] in wild
    assert wild[8][-2:] == ["128", "-"]  # no time was recorded
    one = next(line for line in lines if line[:1] == ["fuzzy-4"])
    assert one == ["fuzzy-4", "3.90", "1.75", "0", "of", "1"]
    assert result.err.splitlines()[-2:] == ["wild, seed 5", "wild, seed 6"]


def test_errors_are_those_of_the_batched_evaluation(result):
    policy = load_policy(result.folder / "gentle-1" / "policy")
    batched = evaluate_cases(policy)
    for case in comparison.CASES:
        (one,) = (e for e in result.document["episodes"] if (e["policy"], e["seed"], e["task"]) == ("gentle", 1, case))
        assert one["completed"]
        for measure in ("max_mm", "rms_mm"):
            assert one[f"tip_error_{measure}"] == pytest.approx(batched[f"{case}_{measure}"], rel=1e-9)


def test_median_seed_is_that_of_the_episodes(result):
    for one in result.document["learned"]:
        own = [record for record in result.document["episodes"] if record["policy"] == one["name"]]
        score = comparison.scores(own, one["training"]["distribution"])
        assert one["median_seed"] == comparison.median_seed(score)
        assert [run["score_mm"] for run in one["runs"]] == [None if math.isinf(s) else s for s in score.values()]


def test_figure_shows_the_median_seed_beside_the_best_rival(result):
    assert result.picture.startswith(b"\x89PNG")
    learned = {"gentle": comparison.trained_seeds("gentle", sorted(result.folder.glob("gentle-*")))}
    document = {**result.document, "learned": result.document["learned"][:1]}
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        figure = comparison.draw(document, learned)
    (row,) = figure.subfigs
    plane, errors = row.axes
    seed = document["learned"][0]["median_seed"]
    own = [e for e in document["episodes"] if (e["policy"], e["seed"]) == ("gentle", seed)]
    worst = max(own, key=lambda e: e["tip_error_rms_mm"])
    texts = [text.get_text() for text in row.legends[0].get_texts()]
    assert texts[0] == "reference"
    assert texts[1] == f"gentle, seed {seed}: rms {worst['tip_error_rms_mm']:#.3g} mm"
    assert comparison.TASKS[worst["task"]].title in row.get_suptitle()
    assert (plane.get_xlabel(), plane.get_ylabel()) == ("y, to the side [m]", "x, down [m]")
    assert (errors.get_xlabel(), errors.get_ylabel()) == ("time [s]", "tip error [mm]")
    # The plane and the panel over time tell the same: the magnified deviation is the error.
    factor = float(plane.get_title(loc="left").split("×")[1])
    reference = comparison.TASKS[worst["task"]].reference
    for path, error in zip(plane.lines[:2], errors.lines, strict=True):
        time, millimetres = error.get_data()
        right, down = path.get_data()
        deviation = np.column_stack([down, right]) - reference.tip(time).position
        assert 1e3 * np.hypot(*deviation.T) == pytest.approx(factor * np.array(millimetres), abs=2e-3 * factor)
    assert errors.lines[0].get_color() != errors.lines[1].get_color()
    assert errors.lines[0].get_linestyle() != errors.lines[1].get_linestyle()


def _unfinished(folder):
    return ["--learned", "a", finished_run(folder / "x", 0, steps_done=64)]


def _silent(folder):
    return ["--learned", "a", finished_run(folder / "x", 0, steps_done=None)]


def _mixed(folder):
    runs = finished_run(folder / "x", 0), finished_run(folder / "y", 1, base="fuzzy-1")
    return ["--learned", "a", *runs]


def _twice(folder):
    return ["--learned", "a", finished_run(folder / "x", 3), finished_run(folder / "y", 3)]


def _damaged(folder):
    run = finished_run(folder / "x", 0)
    path = run / "policy" / "weights.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    return ["--learned", "a", run]


def _half_written(folder):
    run = finished_run(folder / "x", 0)
    (run / "policy" / "policy.json").unlink()
    return ["--learned", "a", run]


def _without_time(text):
    def words(folder):
        run = finished_run(folder / "x", 0)
        (run / "run.json").write_text(text)
        return ["--learned", "a", run]

    return words


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (lambda folder: [], "no learned policy is named; give --learned"),
        (lambda folder: ["--learned"], "no learned policy is named; give --learned"),
        (lambda folder: ["--learned", "a"], "--learned a names no folder"),
        (lambda folder: ["--learned", "a", folder / "none"], "has no folder policy/"),
        (lambda folder: ["--learned", "a", finished_run(folder / "x", 0) / "policy"], "has no folder policy/"),
        (_unfinished, "is unfinished, 64 of 100 steps; go on with fuzzyarm train ppo --resume"),
        (_silent, "does not say how many steps"),
        (_mixed, "differ in base; give each configuration a name"),
        (_twice, "both have seed 3; give each seed once"),
        (_damaged, "its sha256 differs"),
        (_half_written, "No such file or directory; a policy bundle is a folder"),
        (_without_time("{"), "wall_time_s must be a number of seconds"),
        (_without_time('{"wall_time_s": -1.0}'), "wall_time_s must be a number of seconds"),
        (
            lambda folder: ["--learned", "fuzzy-4", finished_run(folder / "x", 0)],
            "--learned fuzzy-4: the name is taken",
        ),
        (lambda folder: [*["--learned", "a", finished_run(folder / "x", 0)], "--learned", "a"], "the name is taken"),
        (lambda folder: ["--json", folder / "none" / "r.json"], "make the folder first"),
        (lambda folder: ["--figure", folder / "f.pdf"], "must end in .png"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(tmp_path, words, message):
    outputs = {"--json": tmp_path / "r.json", "--figure": tmp_path / "f.png"}
    given = words(tmp_path)
    code, out, err = run(*(word for item in outputs.items() for word in item), *given)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert message in err
    assert not any(path.exists() for path in outputs.values())
