"""Tubes, cells, their files and the commands that make and check them; `tip_fuzz` compares with simulated plants."""

import itertools
import json
import subprocess
import sys
from pathlib import Path

import pytest
from support.command_line import one_line_error

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.policies import tip_cells as module
from fuzzyarm.policies.tip_bound import TipClaim, arm_in_words, find_bound, plain
from fuzzyarm.policies.tip_cells import _bounds_of_cell as bounds_of_cell
from fuzzyarm.policies.tip_cells import cells
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import BY_JOINT, BallPlant, PlantSet

STEPS = 24


def claim(plants=None, steps=STEPS):
    return TipClaim("fuzzy-4-tip", "nominal", "own" if plants else "table-1", plants or PlantSet(), steps=steps)


@pytest.fixture(scope="module")
def exact():
    return find_bound(claim())


def test_the_file_is_checked_again(exact, tmp_path, capsys):
    path = tmp_path / "bound.json"
    save_bound(exact, path)
    found = check_bound(path)
    assert found.proven and found.bound == exact.largest
    assert sum(exact.spent().values()) == pytest.approx(exact.largest, rel=0.1)
    assert main(["verify", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["proven"] is True


def test_the_words_are_made_from_the_numbers(tmp_path, capsys):
    """No label of a set is repeated, no name of a set for another arm, no letter that looks like another one."""
    path = tmp_path / "bound.json"
    save_bound(find_bound(claim(steps=2)), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"set_name": "near, and stiffness ± 10 %"}))
    assert main(["verify", str(path)]) == 0
    said = capsys.readouterr().out
    assert "for set table-1, proven (elastic arm, the arm of Table 1; sampled control;" in said and "10 %" not in said
    other, own = ArmParameters(mass=(12.0, 9.0)), PlantSet(stiffness=(0.99, 1.01), late=1)
    assert TipClaim("it").named_set(other) == "of one plant"
    assert arm_in_words(other) == "an arm with mass = (12.0, 9.0) kg instead of Table 1's"
    assert "stiffness 2 from 0.99 to 1.01 times, torques 1 control" in TipClaim("it", plants=own).named_set(other)
    assert plain("fuzz\u0443-4") == "fuzz\\u0443-4"


def test_files_that_are_none(exact, tmp_path, capsys):
    path = tmp_path / "bound.json"
    save_bound(exact, path)
    content = json.loads(path.read_text())
    segments = [content["steps"][0][0] | {"duration": duration} for duration in (1e300, 5e-324)]
    wrong = {"policy": "fuzzy-99", "path": "cube", "files": {"a": "b"}, "set_name": "near", "bound": 1e300}
    wrong |= {"tip": [1e300] * STEPS, "duration": 1e300}
    several = {"plants": ({"mass": [1.0]}, {"noise": [1e300, 0.0]}), "steps": [[[segment]] for segment in segments]}
    for name, value in (*wrong.items(), *((name, value) for name, values in several.items() for value in values)):
        path.write_text(json.dumps(content | {name: value}))
        assert main(["verify", str(path)]) == 2
        one_line_error(capsys)


def test_no_bound_is_exit_code_1_and_bad_sets_and_names_are_2(tmp_path, capsys):
    assert main(["prove", "--policy", "adaptive-observer"]) == 1
    assert "no bound for" in one_line_error(capsys)
    wide = tmp_path / "wide.toml"
    wide.write_text("stiffness = [0.5, 1.5]\n")
    assert main(["prove", "--set", str(wide), "--steps", "60", "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["proven"] is False and answer["bound"] is None and "no bound beyond t" in answer["reason"]
    for text in ("stiffness = [1.1, 0.9]", "stifness = [1.0, 1.0]", "friction = 'none'", "late = 3", "mass = ["):
        wide.write_text(text + "\n")
        assert main(["prove", "--set", str(wide)]) == 2
        assert str(wide) in one_line_error(capsys)
    for words in (["--set", "table-2"], ["--policy", "fuzzy-99"], ["--case", "windy"], ["--steps", "0"]):
        assert main(["prove", *words]) == 2
        one_line_error(capsys)
    wrong = [("set_name", "n\u0435ar"), ("set_name", "near"), ("path", "cube"), ("plants", {}), ("steps", 1501)]
    for name, value in wrong:
        with pytest.raises((TypeError, ValueError), match=f"^{name}"):
            TipClaim("fuzzy-4-tip", **{name: value})


WIDE = PlantSet(mass=(0.95, 1.05), stiffness=((0.9, 1.1), (0.8, 1.0)), payload=(0.0, 1.0), dry_friction=(0.5, 1.5))
DIVISIONS = [("stiffness", 2), ("mass", 3), ("payload", 2)]


def test_cells_cover_the_set_and_each_is_needed():
    parts = list(cells(WIDE, DIVISIONS))
    assert len(parts) == 2**2 * 3**2 * 2 and WIDE.hole(parts) is None
    for gone in (0, 17, len(parts) - 1):
        assert WIDE.hole(parts[:gone] + parts[gone + 1 :]) == parts[gone]


def test_the_range_of_one_joint_alone_can_be_divided():
    parts = list(cells(WIDE, [("mass-2", 4)]))
    assert [part.of_joint("mass", 0) for part in parts] == [(0.95, 1.05)] * 4 and WIDE.hole(parts) is None
    with pytest.raises(ValueError, match="divides already"):
        list(cells(WIDE, [("mass", 2), ("mass-2", 4)]))


def test_a_cell_without_a_tube_is_halved_where_it_is_widest_until_all_have_one(monkeypatch):
    def find(claim):
        low, high = claim.plants.of_joint("stiffness", 1)
        if high - low > 0.06:
            raise NoBound("too wide")
        return claim

    monkeypatch.setattr(module, "find_bound", find)
    cell = TipClaim("fuzzy-4-tip", plants=next(cells(WIDE, DIVISIONS)))
    found = [part.plants for part in bounds_of_cell(cell, WIDE, ["stiffness", "mass"])]
    assert len(found) > 1 and cell.plants.hole(found) is None
    assert all(high - low <= 0.06 for low, high in (part.of_joint("stiffness", 1) for part in found))
    with pytest.raises(NoBound, match=r"stiffness 1 from 0\.9 to 1 times, .*: too wide"):
        list(bounds_of_cell(cell, WIDE, ["mass"], 2))


def test_ranges_of_one_joint_are_those_of_that_joint_alone():
    def plant(**ranges):
        return BallPlant.of(ArmParameters(), Disturbance(), PlantSet(**ranges))

    for name, joint in itertools.product(BY_JOINT, (0, 1)):
        pair = [[0.9, 1.1] if j == joint else [1.0, 1.0] for j in (0, 1)]
        one, both = plant(**{name: pair}), plant(**{name: (0.9, 1.1)})
        (parameter,) = one.parameters
        assert str(parameter) in map(str, both.parameters) and one.middle == both.middle
        assert (parameter.kind, parameter.joint) == (name, joint)
    middle = plant(stiffness=((0.8, 1.0), (1.0, 1.3))).middle
    assert (middle.stiffness1, middle.stiffness2) == pytest.approx((0.9 * 6.4e4, 1.15 * 1.2e4))


def test_cells_cover_the_range_and_the_largest_counts(tmp_path, capsys):
    path = tmp_path / "set.toml"
    path.write_text("payload = [0.0, 0.3]\n")
    words = ["prove", "--set", str(path), "--steps", "4", "--json"]
    assert main([*words, "--cells", "payload", "3"]) == 0
    found = json.loads(capsys.readouterr().out)
    lows, highs = zip(*(cell["payload"] for cell in found["cells"]), strict=True)
    assert (lows[0], *highs) == (*lows, 0.3) and lows[0] == 0.0
    assert found["bound"] == max(cell["bound"] for cell in found["cells"])
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["bound"] > 0.9 * found["bound"]
    twice = ["--cells", "payload", "3", "--cells", "payload", "2"]
    for divided, why in ((["--cells", "friction", "3"], "choose from: mass,"), (twice, "distinct names")):
        assert main([*words, *divided]) == 2
        assert why in one_line_error(capsys)


def test_the_file_of_cells_is_checked_with_every_cell(tmp_path, capsys):
    wanted, out = tmp_path / "set.toml", tmp_path / "loads.json"
    wanted.write_text("payload = [0.0, 0.2]\n")
    words = ["prove", "--set", str(wanted), "--steps", "2", "--cells", "payload", "2", "--out", str(out)]
    assert main(words) == 0
    assert {path.name for path in tmp_path.glob("*.json")} == {"loads.json", "loads-001.json", "loads-002.json"}
    motion = "of the first 2 of 1500 control steps of a lap of the circle in 1.5 s, case nominal, from rest"
    assert f"at every instant {motion}" in capsys.readouterr().out
    assert main(["verify", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["cells"] == 2
    assert "set with payload from 0.1 to 0.2 kg, proven" in check_bound(tmp_path / "loads-002.json").sentence
    sound = json.loads(out.read_text())
    first, second = sound["cells"]
    for change, why in (
        ({"cells": [second]}, "no cell covers payload from 0 to 0.1"),
        ({"cells": [first]}, "no cell covers payload from 0.1 to 0.2"),
        ({"bound": 0.5 * sound["bound"]}, "the tip error may reach"),
        ({"case": "payload"}, "has a different claim from this file"),
        ({"samples": 5}, "has a different claim from this file"),
    ):
        out.write_text(json.dumps(sound | change))
        assert main(["verify", str(out), "--json"]) == 1
        (found,) = json.loads(capsys.readouterr().out)
        assert not found["proven"] and why in found["reason"]
    for wrong in (["../loads-001.json"], [""], []):
        out.write_text(json.dumps(sound | {"cells": wrong}))
        assert main(["verify", str(out)]) == 2
        assert "without a folder" in one_line_error(capsys)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_published_bound_is_found_again_and_its_file_is_proven(tmp_path):
    script = Path(__file__).parents[3] / "benchmarks" / "tip_bound.py"
    made = subprocess.run([sys.executable, script, "--files", tmp_path], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    assert main(["verify", *map(str, sorted(tmp_path.glob("*.json")))]) == 0
