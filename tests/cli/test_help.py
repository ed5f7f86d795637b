"""Mistakes of a user, each one line with a way out; help, completion, and the end of an evaluation."""

import importlib.util
import json
import platform
import shlex
import subprocess
import sys
import types
from importlib import metadata, resources

import pytest
import rich.console
from support.command_line import printed, refused

from fuzzyarm import EvaluationConfig, __version__
from fuzzyarm.cli._application import GROUPS, command_line
from fuzzyarm.eval.episodes.metrics import columns
from fuzzyarm.eval.evaluation.result_table import certificate_lines, print_results

MISTAKES = [
    ("evalute", "unknown command evalute", "did you mean evaluate? See fuzzyarm --help"),
    ("fly", "unknown command fly", "choose from: evaluate, report,"),
    ("train", "a command is missing", "see fuzzyarm train --help"),
    ("train ppo --out x --hidden 64 6.4", "--hidden 6.4", "must be a whole number"),
    ("evaluate --sedes 4", "--sedes", "Did you mean --seeds? See fuzzyarm evaluate --help"),
    ("evaluate --seeds 1.5", "--seeds 1.5", "must be a whole number"),
    ("evaluate --encoder-noise 1e-5", "--encoder-noise 1e-5", "needs 2 values"),
    ("evaluate --json=maybe", "--json maybe", "must be yes or no"),
    ("evaluate --policy", "--policy", "needs a value; see fuzzyarm evaluate --help"),
    ("evaluate now", "unexpected argument now; see fuzzyarm evaluate --help"),
    ("evaluate --policy nobody", "choose from: fuzzy-32, fuzzy-16"),
    ("evaluate --policy missing.json", "missing.json"),
    ("evaluate --policy fuzzy-4 --robot arm.toml", "designed for another robot (different: mass)"),
    ("evaluate --case nowhere --out a/b/c", "choose from: nominal, machining, payload"),
    ("evaluate --case nominal --case nominal", "--case ['nominal', 'nominal'] must be one or more distinct"),
    ("evaluate --seeds 0", "--seeds 0 is out of range; allowed: 1, 2, 3"),
    ("evaluate --seeds 5", "encoder noise"),
    ("evaluate --passes 1001", "--passes 1001 is out of range; allowed: 1 to 1000"),
    ("evaluate --payload 0", "--payload 0.0 kg is out of range; allowed: (0,"),
    ("evaluate --force 3 2", "--force (3.0, 2.0) N must be a range (low, high)"),
    ("evaluate --force -1 2", "--force[0] -1.0 N is out of range"),
    ("evaluate --robot missing.toml", "missing.toml"),
    ("evaluate --path triangle", "choose from: circle, lemniscate, line, square, or give a file"),
    ("evaluate --path missing.csv", "missing.csv"),
    ("evaluate --out arm.toml/sub", "arm.toml/sub"),
    ("leaderboard --markdown", "FILE... is missing", "see fuzzyarm leaderboard --help"),
    ("verify broken.json", "broken.json"),
    ("design --out a.json --out b.json", "--out b.json is given twice", "leave out one"),
    ("design --out c.json --theorem papr", '"papr" for --theorem', '"consistent", "paper"'),
    ("design --out c.json --rules 4 --keep z1", "--keep z1", "leave out one"),
    ("design --out c.json --rules 5", "choose from: 32, 16, 8, 4, 2, 1"),
    ("design --out c.json --keep z1,z7", "z1, z2, z3, z4, z5"),
    ("design --out c.json --alpha fast", '--alpha fast must be a number or "max"'),
    ("design --out c.json --gamma min", "gamma and gain_bound are left open"),
    ("design --out c.json --gain-bound 0", "gain_bound = 0.0"),
    ("design --out c.json --gamma nan", "gamma = nan"),
    ("design --out c.json --rules 2 --feedforward 0.5", "--theorem paper"),
    ("design --out controller.txt", "must be a file ending in .json"),
    ("design --out no/such/folder/c.json", "does not exist"),
    ("bench --rounds 6", "rounds = 6 must be odd"),
    ("bench --lanes 64 0", "lanes = 0"),
    ("bench --lanes-sweep", "needs --out DIR, the folder for its figure"),
    ("design --out c.json --control-period 0", "control_period = 0.0 s is out of range"),
    ("evaluate --control-period 1", "--control-period 1.0 s is out of range"),
    ("margins --control-period 2", "control_period = 2.0 s is out of range"),
    ("linearise fuzzy-4 --out x --at 1,b", "--at 1,b must be joint angles"),
    ("linearise fuzzy-4 --out x --at 1", "posture = [1.0] rad must be 2 angles"),
    ("linearise fuzzy-4 --out x --at 1,4", "must be 2 angles, from [-3.14"),
    ("robot missing.urdf --tip t", "missing.urdf"),
    ("robot arm.toml", "must be a file ending in .urdf or .xml"),
    ("robot m.urdf --tip 1,2", "--tip 1,2 must be the name of a link or site, or three numbers"),
    ("robot m.urdf --set stiffness", "--set stiffness must be KEY=VALUE"),
    ("robot m.urdf --set mass=3", "keys: motor_inertia, stiffness"),
    ("robot m.urdf --set angle_range=3", "angle_range must be two numbers"),
    ("margins --robot bad.toml", "mass[0] = -1 kg is out of range"),
    ("margins --out folder.json", "folder.json must be a file ending in .json"),
    ("sweep --policy fuzzy-4.json --policy fuzzy-4 --out a/b/c", "fuzzy-4.json"),
    ("sweep --distribution x", "choose from: nominal, plants, loads, all"),
    ("sweep --range mass a 1", "--range a must be a number"),
    ("sweep --grid mass 1 2 2.5 --grid delay 0 1 2", "--grid 2.5 must be a whole number"),
    ("sweep --grid mass 0.9 1.1 3", "two different quantities"),
    ("sweep --backend dask", "choose from: local, ray"),
    ("sweep --resume --out new", "contains no sweep: run.json is missing; begin one without"),
    ("sweep --replay fuzzy-4 nominal 0 --out new", "contains no sweep: run.json is missing; begin one without"),
    ("sweep --policy ppo-nominal --robot arm.toml", "works only on it"),
    ("export java fuzzy-4 --out new", "java is not an export format; choose from: c"),
    ("export c fuzzy-4", "--out is missing"),
    ("export c fuzzy-4 --out new --number half", 'invalid value "half" for --number'),
    ("export c plant --out new", "unknown policy 'plant'"),
    ("export c adaptive-observer --number float --out new", 'adaptive-observer needs number = "double"'),
    ("export fmu plant --robot nobody --out new", "unknown robot 'nobody'"),
    ("export fmu plant --number float --out new", "--number float is for C source only, and fmu uses double"),
    ("show", "NAME|FILE is missing"),
    ("show fuzzy-5", "unknown policy 'fuzzy-5'; did you mean fuzzy-"),
    ("show fuzzy-4 --csv --json", "--csv and --json both choose the output format; leave out one"),
    ("show ppo-robust", "no sheet of equations and matrices can be written for LearnedPolicy; choose from"),
    ("show fuzzy-4 --robot ur5", "was designed for the two-joint arm"),
    ("report none", "is not a folder; run an evaluation with fuzzyarm evaluate"),
    ("report folder.json", "contains no results.json; run an evaluation with fuzzyarm evaluate"),
    ("leaderboard folder.json", "results.json does not exist"),
]


@pytest.mark.parametrize(("line", "parts"), [(line, parts) for line, *parts in MISTAKES], ids=lambda one: str(one)[:60])
def test_a_mistake_is_one_line_with_the_value_and_a_way_out(line, parts, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "broken.json").write_text("{}")
    (tmp_path / "bad.toml").write_text("mass = [-1, 8]\n")
    (tmp_path / "arm.toml").write_text("mass = [12, 8]\n")
    before = sorted(tmp_path.rglob("*"))
    error = refused(capsys, *shlex.split(line))
    assert error.startswith("fuzzyarm") and all(part in error for part in parts), error
    assert sorted(tmp_path.rglob("*")) == before


LOADED = """
import sys
from fuzzyarm.cli import main  # noqa: E402
heavy = ("llvmlite", "scipy", "matplotlib", "torch", "ray", "joblib", "clarabel", "flint")
for line in sys.argv[1:]:
    main(line.split())
    print("loaded", [name for name in heavy if name in sys.modules])
"""


def test_help_loads_nothing_that_computes():
    lines = "--help", "--version", "evaluate --help", "design --help"
    done = subprocess.run([sys.executable, "-c", LOADED, *lines], capture_output=True, text=True, check=True)
    assert [line for line in done.stdout.splitlines() if line.startswith("loaded")] == ["loaded []"] * 4


def test_every_option_has_help():
    application = command_line()
    commands = {name: application[name] for names in GROUPS.values() for name in names}
    commands["train"] = commands["train"]["ppo"]
    for name, command in commands.items():
        arguments = command.assemble_argument_collection(parse_docstring=True)
        assert len(arguments) > 1, name
        for argument in arguments:
            text = argument.parameter.help
            assert text and len(text) > 10 and (text[0].isupper() or text[0].isdigit()), (name, argument.name, text)


def test_the_version(capsys):
    first, *others = printed(capsys, "--version").splitlines()
    assert first == f"fuzzyarm {__version__}"
    versions = dict(line.split(" ", maxsplit=1) for line in others)
    assert {"Python", "numpy", "llvmlite", "scipy", "gymnasium", "clarabel", "python-flint", "on"} <= set(versions)
    assert versions["Python"] == platform.python_version() and versions["numpy"] == metadata.version("numpy")
    assert ("torch" in versions) == (importlib.util.find_spec("torch") is not None)


def test_completion_is_installed_and_completes(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    script = tmp_path / "completion"
    assert str(script) in printed(capsys, "--install-completion", "--shell", "bash", "--output", script)

    def completed(*words):
        line = f'. "{script}"; COMP_WORDS=(fuzzyarm {" ".join(words)}); COMP_CWORD={len(words)}; _fuzzyarm; '
        command = ["bash", "-c", line + 'echo "${COMPREPLY[@]}"']
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()

    assert completed("eva") == ["evaluate"]
    assert completed("evaluate", "--enc") == ["--encoder-noise"]
    assert completed("train", "p") == ["ppo"]
    assert "paper" in completed("design", "--theorem", "p")


def row(policy, case, rms, *, seed=0, completed=True, largest=1.0):
    metrics = dict.fromkeys((one.name for metrics in columns().values() for one in metrics), -123456.789)
    metrics |= {"tip_error_rms_mm": rms, "tip_error_max_mm": largest}
    return {"case": case, "policy": policy, "seed": seed, "completed": completed, **metrics}


def printed_results(rows, files=(), **config):
    """The words that `evaluate` prints about rows, on a terminal of 80 columns."""
    policies = list(dict.fromkeys(one["policy"] for one in rows))
    made = {"policy_files": {name: dict(files).get(name, {}) for name in policies}}
    evaluation = types.SimpleNamespace(
        config=EvaluationConfig(**config), rows=rows, certificates=dict.fromkeys(policies), made_with=made
    )
    screen = rich.console.Console(force_terminal=True, width=80, color_system=None)
    with screen.capture() as captured:
        print_results(evaluation, screen)
    lines = captured.get().splitlines()
    assert max(map(len, lines)) <= 80
    return [" ".join(line.split()) for line in lines if line.strip()]


def test_the_table_fits_80_columns_marks_the_best_and_ranks_no_micrometre():
    names = ("computed-torque-tip", "fuzzy-4-sampled-tip")
    cases = (("nominal", 2e-3, (4e-4, 5e-4)), ("machining", 10.8, (4.98, 4.79)), ("payload", 10.8, (1.84, 1.79)))
    rows = [row(name, case, rms[k], largest=most) for case, most, rms in cases for k, name in enumerate(names)]
    stored = json.loads(resources.files("fuzzyarm.eval.evaluation").joinpath("near_bounds.json").read_text("utf-8"))
    lines = printed_results(rows, files={names[1]: stored["bounds"][names[1]]["files"]})
    assert f"{names[0]} < 0.001 / 0.00200 4.98 / 10.8 1.84 / 10.8" in lines
    assert f"{names[1]} < 0.001 / 0.00200 4.79 / 10.8* 1.79 / 10.8* 0.768" in lines
    for others in ({"files": {names[1]: {"fuzzy-4-sampled.json": "0"}}}, {"path": "lemniscate"}):
        assert not any("0.768" in line or "near" in line for line in printed_results(rows, **others))


def test_who_lost_the_path_once_has_no_mark():
    rows = [row("a", "nominal", 1e-2, seed=seed, completed=seed != 1) for seed in range(3)]
    rows += [row("far", "nominal", 1e-2, largest=101.0)]
    rows += [row("b", "nominal", rms, seed=seed) for seed, rms in enumerate((5.0, 1.0, 2.0))]
    lines = printed_results(rows, cases=("nominal",), seeds=3, encoder_noise=(1e-5, 1e-3))
    assert {"a lost 1 of 3", "far lost 1 of 1", "b 2.00 / 1.00*"} <= set(lines)
    assert any("medians of 3 seeds" in line for line in lines)


def test_certificates_are_a_line_each():
    numbers = {"a": {"alpha": 19.999, "gamma": 1.4001e-4}, "b": None, "c": None}
    assert certificate_lines({"a": "For ...", "b": "void", "c": None}, numbers) == [
        "a: proven for the rigid arm: alpha = 19.9 1/s, gamma = 0.000141; see fuzzyarm show a",
        "b: its certificate is void along this path; see fuzzyarm show b",
        "nothing is proven for the rigid arm: c",
    ]


def test_without_a_word_the_help_is_shown(capsys):
    shown = printed(capsys)
    assert shown.startswith("Usage: fuzzyarm COMMAND") and "evaluate" in shown and "score" in shown


def test_on_a_terminal_a_command_names_its_next_step(capsys, monkeypatch):
    assert "next:" not in printed(capsys, "show", "fuzzy-1")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    lines = printed(capsys, "show", "fuzzy-1").splitlines()
    assert lines[-1] == "next: fuzzyarm export c NAME --out DIR" and max(map(len, lines)) <= 80
    assert "next:" not in printed(capsys, "show", "fuzzy-1", "--json")
