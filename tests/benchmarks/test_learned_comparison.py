"""The comparison of learned and model-based policies: averages, the shipped seed, and what is refused."""

import contextlib
import dataclasses
import importlib.util
import io
import json
import math
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from support import bundles

from fuzzyarm import load_policy
from fuzzyarm.common.console import PIPED_WIDTH
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.rl_baselines.case_evaluation import evaluate_cases

ROOT = Path(__file__).parents[2]


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tasks = loaded(ROOT / "benchmarks" / "learned_tasks.py")  # under its name, as if run from that folder
figures = loaded(ROOT / "benchmarks" / "learned_figures.py")
seeds = loaded(ROOT / "benchmarks" / "learned_seeds.py")
scores = loaded(ROOT / "benchmarks" / "learned_scores.py")
loaded(ROOT / "benchmarks" / "learned_tables.py")
comparison = loaded(ROOT / "benchmarks" / "learned_comparison.py")

pytestmark = pytest.mark.slow  # a script outside of the package

# A good law with a few random newton metres stays on the path; hundreds of random newton metres alone do not.
GENTLE = ActionDefinition(scale=(1e-4, 1e-4), base="fuzzy-4-tip")
WILD = ActionDefinition()
# Almost without torque the arm hangs and swings, a metre from the path and well within the joint limits.
IDLE = ActionDefinition(scale=(1e-6, 1e-6))


def decaying(factor, count=100, **others):
    """A curve whose errors shrink by a factor from one evaluation to the next."""
    sizes = {"nominal_rms_mm": 1.0, "machining_rms_mm": 5.0, "payload_rms_mm": 2.0}
    return [
        {"steps": 1000 * k, **{key: size * factor**k for key, size in sizes.items()}, **others}
        for k in range(1, count + 1)
    ]


def finished_run(folder, seed, action=GENTLE, curve=None, **training):
    """Write those files of a training that the comparison reads."""
    folder.mkdir(parents=True)
    bundle = bundles.bundle(action, seed)
    recorded = {
        "distribution": "robust",
        "steps": 100,
        "steps_done": 128,
        "seed": seed,
        "threads": seed + 1,
        **training,
    }
    curve = decaying(0.99 + 0.001 * seed) if curve is None else curve
    dataclasses.replace(bundle, seed=seed, training=recorded, curve=curve).save(folder / "policy")
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
    folder: Path


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Three gentle seeds, given in any order, and two wild ones."""
    folder = tmp_path_factory.mktemp("runs")
    gentle = [finished_run(folder / f"gentle-{seed}", seed) for seed in (2, 0, 1)]
    for path, seconds in zip(gentle, (100.0, 300.0, 220.0), strict=True):
        (path / "run.json").write_text(json.dumps({"wall_time_s": seconds, "cpu_time_s": seconds / 2.0}))
    wild = [finished_run(folder / f"wild-{seed}", seed, WILD, distribution="nominal") for seed in (5, 6)]
    file = folder / "r.json"
    code, out, err = run("--learned", "gentle", *gentle, "--learned", "wild", *wild, "--json", file)
    text = file.read_text()
    return Made(code, out, err, text, json.loads(text), folder)


def record(seed, rms, task="nominal", failed=None, policy="mine"):
    return {
        "policy": policy,
        "seed": seed,
        "task": task,
        "failed": failed,
        "reason": "a joint angle left the domain (25)" if failed == "ended early" else "",
        "ended_at": 1.5,
        "tip_error_max_mm": 2.0 * rms,
        "tip_error_rms_mm": rms,
    }


def over_cases(seed, *rms, failed=()):
    how = dict.fromkeys(failed, "lost the path")
    return [record(seed, one, case, how.get(case)) for case, one in zip(PAPER_CASES, rms, strict=True)]


@pytest.fixture(scope="module")
def followed():
    """An episode that stays within a millimetre of the path."""
    return comparison.episode(load_policy("fuzzy-4-tip"), "good", comparison.TASKS["nominal"])


def strayed(run, distance, samples):
    """The episode with the tip farther down by a distance [mm] at some samples."""
    tip, error = run.tip.copy(), run.tip_error.copy()
    tip[samples] = run.tip_reference[samples] + [1e-3 * distance, 0.0]
    error[samples] = 1e-3 * distance
    return dataclasses.replace(run, tip=tip, tip_error=error)


@pytest.mark.parametrize(
    ("distance", "completed", "expected"),
    [
        (99.9, True, None),
        (100.1, True, ("lost the path", 700)),
        (100.1, False, ("ended early", 1499)),
        (0.0, False, ("ended early", 1499)),
    ],
)
def test_failure_is_to_end_early_or_to_be_100_mm_off(followed, distance, completed, expected):
    run = dataclasses.replace(strayed(followed, distance, slice(700, 800)), completed=completed)
    assert comparison.failure(run) == expected


def test_an_idle_arm_loses_the_path_within_the_box(tmp_path, monkeypatch):
    """Its episodes last to the end and still are among the failures."""
    two = {case: comparison.TASKS[case] for case in ("nominal", "payload")}
    for module in (tasks, scores, comparison):
        monkeypatch.setattr(module, "TASKS", two)
    idle = seeds.trained_seed(finished_run(tmp_path / "idle", 0, IDLE)).policy
    records = comparison.assess(idle, "idle", 0)
    assert [one["failed"] for one in records] == ["lost the path"] * 2
    assert all(one["reason"] == "" and one["ended_at"] == pytest.approx(1.5) for one in records)
    assert min(one["tip_error_max_mm"] for one in records) > 500.0
    assert [row["failed"] for row in scores.summarised(records)] == [1, 1]
    assert scores.scores(records, "nominal") == {0: math.inf}


@pytest.mark.parametrize("distribution", ["nominal", "robust"])
@pytest.mark.parametrize("count", [10, 100, 1000])
def test_plateau_of_an_exponential_is_a_power_of_its_factor(distribution, count):
    """Errors c^k at k = 1 to n: both windows have n/10 terms, and one is the other times c^(n/10)."""
    factor = 0.9 ** (10.0 / count)
    assert scores.plateau(decaying(factor, count), distribution) == pytest.approx(0.9, rel=1e-9)
    assert scores.plateau(decaying(1.0, count), distribution) == pytest.approx(1.0, rel=1e-12)


def test_plateau_is_of_the_judged_cases():
    keys = "steps", "nominal_rms_mm", "machining_rms_mm", "payload_rms_mm"
    values = [(50, 1e6, 1e6, 1e6), (80, 1e6, 1e6, 1e6), (85, 4.0, 1.0, 2.0), (90, 2.0, 3.0, 6.0), (100, 1.5, 7.0, 0.5)]
    curve = [dict(zip(keys, row, strict=True)) for row in values]
    assert scores.plateau(curve, "nominal") == pytest.approx(1.5 / 3.0)
    assert scores.plateau(curve, "robust") == pytest.approx(9.0 / ((7.0 + 11.0) / 2.0))
    curve[3]["payload_share"] = 0.4  # what ended early has the error of its beginning
    assert scores.plateau(curve, "nominal") == pytest.approx(1.5 / 3.0)
    assert scores.plateau(curve, "robust") is None
    curve[0]["nominal_share"] = 0.4  # long ago
    assert scores.plateau(curve, "nominal") == pytest.approx(1.5 / 3.0)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_plateau_needs_evaluations_in_both_tenths(count):
    assert scores.plateau(decaying(0.9, count), "robust") is None


def test_errors_are_of_the_middle_seeds():
    (row,) = scores.summarised([record(seed, rms) for seed, rms in enumerate((9.0, 1.0, 2.0, 3.0, 400.0))])
    assert (row["episodes"], row["failed"]) == (5, 0)
    assert row["tip_error_rms_mm"]["mean"] == pytest.approx(14.0 / 3.0)
    assert row["tip_error_max_mm"]["mean"] == pytest.approx(28.0 / 3.0)
    assert row["tip_error_rms_mm"]["low"] < 14.0 / 3.0 < row["tip_error_rms_mm"]["high"]


def test_failed_episodes_are_counted_and_not_averaged():
    records = [record(seed, rms) for seed, rms in enumerate((1.0, 2.0, 6.0))]
    records.append(record(3, 1e-6, failed="ended early"))  # a short episode has a small error
    records.append(record(4, 900.0, failed="lost the path"))
    (row,) = scores.summarised(records)
    assert (row["episodes"], row["failed"], row["tip_error_rms_mm"]["mean"]) == (5, 2, pytest.approx(3.0))
    (row,) = scores.summarised(records[3:])
    assert (row["failed"], row["tip_error_rms_mm"], row["tip_error_max_mm"]) == (2, None, None)
    (row,) = scores.summarised(records[2:])
    assert row["tip_error_rms_mm"] == {"mean": 6.0, "low": None, "high": None}


def test_rows_are_by_task_then_policy():
    tasks = list(comparison.TASKS)
    records = [record(0, 1.0, task, policy=policy) for policy in ("a", "b") for task in reversed(tasks)]
    rows = scores.summarised(records)
    assert [(row["task"], row["policy"]) for row in rows] == [(task, policy) for task in tasks for policy in "ab"]


def test_seeds_are_judged_as_the_training_judges():
    records = [*over_cases(0, 1.0, 2.0, 6.0), *over_cases(1, 2.0, 1.0, 1.5)]
    records += [record(0, 99.0, "fast", "ended early"), record(1, 0.0, "fast")]  # not evaluated
    assert scores.scores(records, "nominal") == {0: 1.0, 1: 2.0}
    assert scores.scores(records, "robust") == {0: pytest.approx(3.0), 1: pytest.approx(1.5)}


def test_a_seed_that_failed_where_it_is_judged_comes_last():
    records = [*over_cases(0, 0.1, 0.1, 0.1, failed=("payload",)), *over_cases(1, 5.0, 5.0, 5.0)]
    assert scores.scores(records, "nominal") == {0: 0.1, 1: 5.0}
    assert scores.scores(records, "robust") == {0: math.inf, 1: 5.0}


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
    assert scores.median_seed(score) == median
    assert scores.median_seed(dict(reversed(score.items()))) == median


def test_worst_task_and_its_best_rival():
    own = [record(0, 5.0, "nominal"), record(0, 9.0, "fast"), record(0, 7.0, "slow")]
    assert scores.worst_task(own) == "fast"
    assert scores.worst_task([*own, record(0, 0.1, "small", "ended early")]) == "small"
    rivals = [record(None, rms, "fast", policy=name) for name, rms in (("a", 3.0), ("b", 2.0), ("c", 4.0))]
    others = [record(1, 0.5, "fast", policy="learned too"), record(None, 0.4, "slow", policy="c")]
    assert scores.best_model_based([*rivals, *others], "fast") == "b"
    assert scores.best_model_based([*rivals, record(None, 0.1, "fast", "ended early", "d")], "fast") == "b"


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
    words = "--learned gentle gentle-2 gentle-0 gentle-1 --learned wild wild-5 wild-6"
    assert document["command"] == f"python benchmarks/learned_comparison.py {words}"
    assert document["method"]["failed"]["lost_mm"] == 100.0
    assert "100 mm" in document["method"]["failed"]["rule"]
    assert len({one["weights_sha256"] for one in gentle["runs"]}) == 3
    assert wild["training"] == {"distribution": "nominal", "steps": 100}
    assert str(result.folder) not in result.text  # its folder on this machine is not recorded
    circle = document["tasks"][0]
    assert (circle["path"]["curve"], circle["path"]["radius"], circle["duration"]) == ("Circle", 0.2, 1.5)


def test_every_failure_says_what_it_was(result):
    expected = []
    for one in result.document["episodes"]:
        far = "lost the path" if one["tip_error_max_mm"] > 100.0 else None
        expected.append("ended early" if one["reason"] else far)
    assert [one["failed"] for one in result.document["episodes"]] == expected
    assert {None, "ended early"} <= set(expected)


def test_table_is_made_again_from_the_document(result):
    assert scores.summarised(result.document["episodes"]) == result.document["rows"]
    out = io.StringIO()
    comparison.print_tables(result.document, Console(file=out, width=PIPED_WIDTH))
    assert out.getvalue() == result.out


def test_failed_and_completed_seeds_in_the_table(result):
    lines = [line.split() for line in result.out.splitlines()]
    assert "\x1b" not in result.out
    gentle = [line for line in lines if line[:1] == ["gentle"]]
    assert [line[-3:] for line in gentle[:8]] == [["0", "of", "3"]] * 8
    assert gentle[8][1:5] == ["0,", "1,", "2", str(result.document["learned"][0]["median_seed"])]
    # Errors shrink by 0.99, 0.991, 0.992 an evaluation, and the windows are ten evaluations apart.
    ratios = ["0.91", "(0.90", "to", "0.92)"]
    assert gentle[8][5:] == ["128", "220", "(100", "to", "300)", "110", "(50", "to", "150)", *ratios]
    wild = [line for line in lines if line[:1] == ["wild"]]
    assert ["wild", "-", "-", "2", "of", "2"] in wild
    assert wild[8][4:] == ["128", "-", "-", "0.96", "(0.95", "to", "0.96)"]  # no time was recorded
    one = next(line for line in lines if line[:1] == ["fuzzy-4"])
    assert one == ["fuzzy-4", "3.90", "1.75", "0", "of", "1"]
    assert result.err == ""  # the progress bar is for terminals


def test_errors_are_those_of_the_batched_evaluation(result):
    policy = load_policy(result.folder / "gentle-1" / "policy")
    batched = evaluate_cases(policy)
    for case in PAPER_CASES:
        (one,) = (e for e in result.document["episodes"] if (e["policy"], e["seed"], e["task"]) == ("gentle", 1, case))
        assert one["failed"] is None
        for measure in ("max_mm", "rms_mm"):
            assert one[f"tip_error_{measure}"] == pytest.approx(batched[f"{case}_{measure}"], rel=1e-9)


def test_median_seed_is_that_of_the_episodes(result):
    for one in result.document["learned"]:
        own = [record for record in result.document["episodes"] if record["policy"] == one["name"]]
        score = scores.scores(own, one["training"]["distribution"])
        assert one["median_seed"] == scores.median_seed(score)
        assert [run["score_mm"] for run in one["runs"]] == [None if math.isinf(s) else s for s in score.values()]


def test_figure_shows_the_median_seed_beside_the_best_rival(result):
    learned = {
        name: comparison.trained_seeds(name, sorted(result.folder.glob(f"{name}-*"))) for name in ("gentle", "wild")
    }
    for row, one in zip(comparison.worst_tasks(result.document, learned), result.document["learned"], strict=True):
        seed = one["median_seed"]
        own = [e for e in result.document["episodes"] if (e["policy"], e["seed"]) == (one["name"], seed)]
        failed = [e for e in own if e["failed"]]
        worst = max(failed or own, key=lambda e: e["tip_error_rms_mm"])
        mine, rival = row.episodes
        assert f"{one['name']}, seed {seed}: rms " in mine.label
        assert 1e3 * mine.run.tip_error.max() == pytest.approx(worst["tip_error_max_mm"])
        assert mine.label.endswith(f", {worst['failed']}" if failed else " mm")
        where = "where it fails" if failed else "where it is worst"
        assert row.title == f"{one['name']} {where}: {comparison.TASKS[worst['task']].title}"
        assert rival.label.split(":")[0] == scores.best_model_based(result.document["episodes"], worst["task"])
    assert [one["name"] for one in result.document["learned"]] == ["gentle", "wild"]


def test_curves_have_lines_for_orientation(result):
    levels = comparison.orientation(result.document)
    assert list(levels) == list(PAPER_CASES)
    for case, by_policy in levels.items():
        alone = {e["policy"]: e for e in result.document["episodes"] if e["task"] == case and e["seed"] is None}
        best = min(alone, key=lambda name: alone[name]["tip_error_rms_mm"])
        assert set(by_policy) == {"fuzzy-4-tip", "computed-torque", best}
        assert by_policy == {name: alone[name]["tip_error_rms_mm"] for name in by_policy}


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A repository of its own with few tasks and policies; returns its folder of trainings."""
    for module in (tasks, scores, comparison):
        monkeypatch.setattr(module, "TASKS", {case: comparison.TASKS[case] for case in PAPER_CASES})
    monkeypatch.setattr(comparison, "MODEL_BASED", comparison.ORIENTATION)
    monkeypatch.setattr(comparison, "ROOT", tmp_path)
    monkeypatch.setattr(comparison, "LEARNED", tmp_path / "benchmarks" / "learned")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "benchmarks" / "learned"


def test_command_of_the_document_makes_it_again(small):
    names = "my-ppo-0", "my-ppo-1", "other-7"
    for name in names:
        finished_run(small / name, int(name[-1]))
    (small / "README.md").write_text("no training")
    shutil.copytree(Path(__file__).parents[2] / "benchmarks" / "learned" / "ppo-ur5-0", small / "ur5-0")  # another arm
    first, again, chosen = (small / f"{name}.json" for name in ("first", "again", "chosen"))
    assert run("--json", first)[0] == 0
    document = json.loads(first.read_text())
    assert document["command"] == "python benchmarks/learned_comparison.py"
    assert {one["name"]: [r["folder"] for r in one["runs"]] for one in document["learned"]} == {
        "my-ppo": ["benchmarks/learned/my-ppo-0", "benchmarks/learned/my-ppo-1"],
        "other": ["benchmarks/learned/other-7"],
    }
    assert run(*shlex.split(document["command"])[2:], "--json", again)[0] == 0
    assert again.read_text() == first.read_text()
    assert run("--learned", "a b", *sorted(small.glob("my-ppo-*")), "--json", chosen)[0] == 0
    command = json.loads(chosen.read_text())["command"]
    words = "--learned 'a b' benchmarks/learned/my-ppo-0 benchmarks/learned/my-ppo-1"
    assert command == f"python benchmarks/learned_comparison.py {words}"
    assert run(*shlex.split(command)[2:], "--json", again)[0] == 0
    assert again.read_text() == chosen.read_text()


@pytest.mark.parametrize(
    ("folders", "message"),
    [
        ([], "holds no folder NAME-SEED; give --learned NAME FOLDER"),
        (["."], "holds no folder NAME-SEED; give --learned NAME FOLDER"),
        (["nominal"], "must be called NAME-SEED"),
        (["-3"], "must be called NAME-SEED"),
        (["ppo-0"], "has no folder policy/"),
    ],
)
def test_bad_folder_of_trainings_is_one_line(small, folders, message):
    for folder in folders:
        (small / folder).mkdir(parents=True)
    code, out, err = run()
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert message in err


def test_script_runs_from_anywhere(tmp_path):
    """It finds its neighbour, which this file loads itself."""
    script = ROOT / "benchmarks" / "learned_comparison.py"
    done = subprocess.run([sys.executable, script, "--json", tmp_path], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert "make the folder first" in done.stderr


def _unfinished(folder):
    return ["--learned", "a", finished_run(folder / "x", 0, steps_done=64)]


def _silent(folder):
    return ["--learned", "a", finished_run(folder / "x", 0, steps_done=None)]


def _mixed(folder):
    runs = finished_run(folder / "x", 0), finished_run(folder / "y", 1, base="fuzzy-1")
    return ["--learned", "a", *runs]


def _twice(folder):
    return ["--learned", "a", finished_run(folder / "x", 3), finished_run(folder / "y", 3)]


def _without_curve(curve):
    return lambda folder: ["--learned", "a", finished_run(folder / "x", 0, curve=curve)]


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
        (lambda folder: ["--learned"], "no learned policy is named; give --learned"),
        (lambda folder: ["--learned", "a"], "--learned a names no folder"),
        (lambda folder: ["--learned", "a", folder / "none"], "has no folder policy/"),
        (lambda folder: ["--learned", "a", finished_run(folder / "x", 0) / "policy"], "has no folder policy/"),
        (_unfinished, "is unfinished, 64 of 100 steps; go on with fuzzyarm train ppo --resume"),
        (_silent, "does not say how many steps"),
        (_mixed, "differ in base; give each configuration a name"),
        (_twice, "both have seed 3; give each seed once"),
        (_without_curve([]), "has no curve with positive steps, nominal_rms_mm"),
        (_without_curve([*decaying(0.9), {"steps": 9}]), "has no curve with positive steps, nominal_rms_mm"),
        (_without_curve(decaying(0.9, payload_rms_mm=0.0)), "has no curve with positive steps, nominal_rms_mm"),
        (_damaged, "its sha256 differs"),
        (_half_written, "No such file or directory; a policy bundle is a folder"),
        (_without_time("{"), "run.json is damaged: it must be a JSON mapping"),
        (_without_time('{"wall_time_s": -1.0}'), "wall_time_s must be a number of seconds"),
        (_without_time('{"cpu_time_s": true}'), "cpu_time_s must be a number of seconds"),
        (
            lambda folder: ["--learned", "fuzzy-4", finished_run(folder / "x", 0)],
            "--learned fuzzy-4: the name is taken",
        ),
        (lambda folder: [*["--learned", "a", finished_run(folder / "x", 0)], "--learned", "a"], "the name is taken"),
        (lambda folder: ["--json", folder / "none" / "r.json"], "make the folder first"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(tmp_path, words, message):
    file = tmp_path / "r.json"
    code, out, err = run("--json", file, *words(tmp_path))
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert message in err
    assert not file.exists()
