"""Tubes, their files and the commands that make and check them; `tip_fuzz` compares them with simulated plants."""

import itertools
import json

import pytest
from support.command_line import one_line_error

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.policies.tip_bound import TipClaim, arm_in_words, find_bound, plain
from fuzzyarm.policies.tip_files import check_bound, save_bound
from fuzzyarm.proof.tip.centre import Mode
from fuzzyarm.proof.tip.plant import PlantSet

STEPS = 24


def claim(plants=None, policy="fuzzy-4-tip", steps=STEPS, case="nominal"):
    return TipClaim(policy, case, "table-1" if plants is None else "own", plants or PlantSet(), steps=steps)


@pytest.fixture(scope="module")
def exact():
    return find_bound(claim())


def test_motors_of_the_centre_stick_and_slip(exact):
    """The first samples make the motors rest, break away and rest again, also within a period."""
    modes = {mode for step in exact.steps for segment in step.segments for mode in segment.modes}
    assert Mode.REST in modes and len(modes) > 1
    assert max(len(step.segments) for step in exact.steps) > 1
    assert sum(segment.duration for segment in exact.steps[2].segments) == 1e-3


def test_any_friction_has_a_wider_tube(exact):
    wide = find_bound(claim(PlantSet(friction="any"), steps=12))
    assert (wide.tip >= exact.tip[:12]).all() and wide.tip[-1] > 10.0 * exact.tip[11]


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
    for name, value in (
        ("policy", "fuzzy-99"),
        ("path", "cube"),
        ("plants", {"mass": [1.0]}),
        ("files", {"a": "b"}),
        ("set_name", "near"),
        ("bound", 1e300),
        ("tip", [1e300] * STEPS),
        ("duration", 1e300),
        ("plants", {"noise": [1e300, 0.0]}),
        ("steps", [[content["steps"][0][0] | {"duration": 1e300}]]),
        ("steps", [[content["steps"][0][0] | {"duration": 5e-324}]]),
    ):
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
    for change in (
        {"set_name": "n\u0435ar"},
        {"set_name": "near"},
        {"path": "cube"},
        {"plants": {}},
        {"steps": 1501},
    ):
        with pytest.raises((TypeError, ValueError), match=f"^{next(iter(change))}"):
            TipClaim("fuzzy-4-tip", **change)


def test_cells_cover_the_range_and_the_largest_counts(tmp_path, capsys):
    path = tmp_path / "set.toml"
    path.write_text("payload = [0.0, 0.3]\n")
    words = ["prove", "--set", str(path), "--steps", "4", "--json"]
    assert main([*words, "--cells", "payload", "3"]) == 0
    found = json.loads(capsys.readouterr().out)
    ends = [cell["payload"] for cell in found["cells"]]
    assert ends[0][0] == 0.0 and ends[-1][1] == 0.3 and all(a[1] == b[0] for a, b in itertools.pairwise(ends))
    assert found["bound"] == max(cell["bound"] for cell in found["cells"])
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["bound"] > 0.9 * found["bound"]
    assert main([*words, "--cells", "friction", "3"]) == 2
    assert "choose from: mass," in one_line_error(capsys)
    assert main([*words, "--cells", "payload", "3", "--cells", "payload", "2"]) == 2
    assert "distinct names" in one_line_error(capsys)


def test_the_file_of_cells_is_checked_with_every_cell(tmp_path, capsys):
    wanted, out = tmp_path / "set.toml", tmp_path / "loads.json"
    wanted.write_text("payload = [0.0, 0.2]\n")
    words = ["prove", "--set", str(wanted), "--steps", "2", "--cells", "payload", "2", "--out", str(out)]
    assert main(words) == 0
    assert {path.name for path in tmp_path.glob("*.json")} == {"loads.json", "loads-001.json", "loads-002.json"}
    assert (
        "at every instant of the first 2 of 1500 control steps of a lap of the circle in 1.5 s, case nominal, from rest"
        in capsys.readouterr().out
    )
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
def test_the_whole_circle():
    for policy, most in (("fuzzy-4-tip", 2.4e-6), ("fuzzy-4", 3.95e-3)):
        assert find_bound(claim(policy=policy, steps=None)).largest < most
