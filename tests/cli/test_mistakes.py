"""Every mistake of a user is one line that names the value and a way out; nothing is written."""

import shlex

import pytest
from support.command_line import one_line_error

from fuzzyarm.cli import main

MISTAKES = [
    ("", "fuzzyarm: a command is missing", "choose from: evaluate, report,"),
    ("evalute", "unknown command evalute", "did you mean evaluate? See fuzzyarm --help"),
    ("fly", "unknown command fly", "choose from: evaluate, report,"),
    ("train", "a command is missing", "see fuzzyarm train --help"),
    ("train pp", "unknown command pp", "did you mean ppo? See fuzzyarm train --help"),
    ("train ppo --out x --hidden 64 6.4", "--hidden 6.4", "must be a whole number"),
    ("evaluate --sedes 4", "--sedes", "Did you mean --seeds? See fuzzyarm evaluate --help"),
    ("evaluate --seeds 1.5", "--seeds 1.5", "must be a whole number"),
    ("evaluate --encoder-noise 1e-5", "--encoder-noise 1e-5", "needs 2 values"),
    ("evaluate --json=maybe", "--json maybe", "must be yes or no"),
    ("evaluate --policy", "--policy", "needs a value; see fuzzyarm evaluate --help"),
    ("evaluate now", "now", "belongs to no option; see fuzzyarm evaluate --help"),
    ("evaluate --policy nobody", "choose from: fuzzy-32, fuzzy-16"),
    ("evaluate --policy missing.json", "missing.json"),
    ("evaluate --policy fuzzy-4 --robot arm.toml", "designed for another robot (mass differ)"),
    ("evaluate --case nowhere --out a/b/c", "choose from: nominal, machining, payload"),
    ("evaluate --case nominal --case nominal", "--case ['nominal', 'nominal'] must be one or more different"),
    ("evaluate --seeds 0", "--seeds 0 is out of range; allowed: 1, 2, 3"),
    ("evaluate --seeds 5", "encoder noise"),
    ("evaluate --passes 1001", "--passes 1001 is out of range; allowed: 1 to 1000"),
    ("evaluate --payload 0", "--payload 0.0 kg is out of range; allowed: (0,"),
    ("evaluate --force 3 2", "--force (3.0, 2.0) N must be a range (low, high)"),
    ("evaluate --force -1 2", "--force[0] -1.0 N is out of range"),
    ("evaluate --encoder-noise -1 0", "EncoderNoise.position = -1.0"),
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
    ("bench --lanes-sweep", "say where with --out DIR"),
    ("bench --out arm.toml/sub", "arm.toml/sub"),
    ("margins --policy nobody", "choose from: fuzzy-32, fuzzy-16"),
    ("margins --policy broken.json", "broken.json"),
    ("margins --policy fuzzy-1 --policy fuzzy-1", "must be one or more different names"),
    ("margins --robot bad.toml", "mass[0] = -1 kg is out of range"),
    ("margins --policy fuzzy-4 --robot arm.toml", "designed for another robot (mass differ)"),
    ("margins --out folder.json", "folder.json must be a file ending in .json"),
    ("sweep --policy nobody", "unknown policy 'nobody'; choose from: fuzzy-32"),
    ("sweep --policy fuzzy-4.json --policy fuzzy-4 --out a/b/c", "fuzzy-4.json"),
    ("sweep --distribution x", "choose from: nominal, plants, loads, all"),
    ("sweep --range mass 0.9", "--range mass 0.9", "needs 3 values"),
    ("sweep --range mass a 1", "--range a must be a number"),
    ("sweep --grid mass 0.9 1.1 3", "two different quantities"),
    ("sweep --grid mass 1 2 2.5 --grid delay 0 1 2", "--grid 2.5 must be a whole number"),
    ("sweep --backend dask", "choose from: local, ray"),
    ("sweep --resume --out new", "holds no sweep to go on with"),
    ("sweep --replay fuzzy-4 nominal 0 --out new", "holds no sweep to go on with"),
    ("sweep --policy ppo-nominal --robot arm.toml", "knows no other"),
    ("export java fuzzy-4 --out new", "java is no language of an export; choose from: c"),
    ("export c fuzzy-4", "--out is missing"),
    ("export c fuzzy-4 --out new --number half", 'invalid value "half" for --number'),
    ("export c fuzzy-9 --out new", "unknown policy 'fuzzy-9'"),
    ("export c plant --out new", "unknown policy 'plant'"),
    ("export c adaptive-observer --number float --out new", "adaptive-observer needs double"),
    ("export fmu plant --robot nobody --out new", "unknown robot 'nobody'"),
    ("export fmu plant --number float --out new", "--number float is for C source; an FMU computes in"),
    ("show", "NAME|FILE is missing"),
    ("show fuzzy-5", "unknown policy 'fuzzy-5'; choose from"),
    ("show fuzzy-4 --csv --json", "--csv and --json both choose the form; leave out one"),
    ("show ppo-robust", "LearnedPolicy has no sheet of equations and matrices; there is one of"),
    ("show fuzzy-4 --robot ur5", "was designed for the two-joint arm"),
    ("report none", "is not a folder; make an evaluation with fuzzyarm evaluate"),
    ("report folder.json", "holds no results.json; make an evaluation with fuzzyarm evaluate"),
    ("leaderboard folder.json", "results.json is not there"),
]


@pytest.mark.parametrize(("line", "parts"), [(line, parts) for line, *parts in MISTAKES], ids=lambda one: str(one)[:60])
def test_a_mistake_is_one_line_with_the_value_and_a_way_out(line, parts, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "broken.json").write_text("{}")
    (tmp_path / "bad.toml").write_text("mass = [-1, 8]\n")
    (tmp_path / "arm.toml").write_text("mass = [12, 8]\n")
    before = sorted(tmp_path.rglob("*"))
    assert main(shlex.split(line)) == 2
    error = one_line_error(capsys)
    assert error.startswith("fuzzyarm") and all(part in error for part in parts), error
    assert sorted(tmp_path.rglob("*")) == before
