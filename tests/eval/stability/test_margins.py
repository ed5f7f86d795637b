"""The table of margins: numbers as by direct calls, and reasons for missing ones."""

import dataclasses
import functools
import json

import pytest
from rich.console import Console
from slow_twins import slow_but
from support.springs import Springs

from fuzzyarm import ArmParameters, MarginsConfig, load_policy, measure_margins
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.eval.stability._linearisation import gain_limits, largest_radius, linearise_path
from fuzzyarm.eval.stability.margins import margin_cells, margin_notes, margins_in_words, policy_margins, print_margins
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.policies import ANY_ROBOT, LEARNED, NAMES

ARM = ArmParameters()
NAMED = ("computed-torque", "fuzzy-4")
PAYLOAD = "5 kg payload"
pytestmark = pytest.mark.usefixtures("few_postures")


@functools.cache
def nominal():
    """Two policies with the arm of Table 1, measured once and not to be changed."""
    return measure_margins(MarginsConfig(NAMED))


@pytest.mark.parametrize("name", NAMED)
def test_rows_are_direct_calls(name):
    row = next(row for row in nominal()["rows"] if row["policy"] == name)
    policy = load_policy(name)
    soft, hard = (dataclasses.replace(ARM, stiffness=tuple(k * one for one in ARM.stiffness)) for k in (0.8, 1.2))
    loops = linearise_path(policy, ARM, 1e-3)
    assert row["spectral_radius"] == {
        "nominal": largest_radius(loops),
        "loop gain x 0.67": largest_radius(loops, 0.67),
        "loop gain x 1.5": largest_radius(loops, 1.5),
        "half a sample later": largest_radius(loops, delay=0.5),
        "one sample later": largest_radius(loops, delay=1),
        "stiffness - 20 %": largest_radius(linearise_path(policy, soft, 1e-3)),
        "stiffness + 20 %": largest_radius(linearise_path(policy, hard, 1e-3)),
        PAYLOAD: largest_radius(linearise_path(policy, ARM, 1e-3, Payload(5.0))),
    }
    (lower, upper), (_, later) = gain_limits(loops), gain_limits(loops, 1)
    assert row["loop_gain"] == {"lower": lower, "upper": upper, "upper_one_sample_later": later}
    assert row["reasons"] == {}
    assert json.loads(json.dumps(nominal(), allow_nan=False)) == nominal()


def test_the_command_of_a_configuration():
    words = "fuzzyarm margins --policy 'my own.json' --policy fuzzy-1 --robot 'other arm.toml'"
    assert MarginsConfig(("my own.json", "fuzzy-1"), "other arm.toml").command() == words
    assert MarginsConfig().command() == "fuzzyarm margins"


def test_a_condition_without_a_number_says_why(tmp_path):
    robot = tmp_path / "heavy.toml"
    robot.write_text("gravity = 45.0\n")
    document = measure_margins(MarginsConfig(("computed-torque",), str(robot)))
    (row,) = document["rows"]
    assert [name for name, radius in row["spectral_radius"].items() if radius is None] == [PAYLOAD]
    assert all(0.9 < radius < 1.0 for name, radius in row["spectral_radius"].items() if name != PAYLOAD)
    assert list(row["reasons"]) == [PAYLOAD] and "no equilibrium within 0.1 rad" in row["reasons"][PAYLOAD]
    headings, (cells,) = margin_cells([row])
    assert [heading for heading, cell in zip(headings, cells, strict=True) if cell == "-"] == [PAYLOAD]
    with (console := Console(width=400)).capture() as printed:
        print_margins(document, console)
    assert f"computed-torque has no '{PAYLOAD}': no equilibrium" in " ".join(printed.get().split())


def test_a_policy_that_cannot_be_linearised_has_no_numbers():
    row = policy_margins(Springs(lambda *_: ()), ARM, 1e-3)
    assert set(row["spectral_radius"].values()) == set(row["loop_gain"].values()) == {None}
    assert set(row["reasons"]) == {*row["spectral_radius"], *row["loop_gain"]}
    said = "state of type tuple; it must return a float64 torque, and a NumPy array or None as state"
    assert all(said in reason for reason in row["reasons"].values())
    rows = [{"policy": "p", **row}]
    assert margin_cells(rows)[1] == [["p", *["-"] * 11]]
    assert len(margin_notes(nominal() | {"rows": rows})) == 3  # one reason, told once


def test_a_gain_without_limit_is_none():
    """Springs without integral bear any smaller gain."""
    row = policy_margins(Springs(), ARM, 1e-3)
    assert row["loop_gain"]["lower"] is None and row["loop_gain"]["upper"] > 2.0
    assert row["reasons"] == {"lower": "stable at every loop gain tried, down to 0.01 times the nominal gain"}


def test_two_files_of_one_name_would_be_one_row(tmp_path):
    load_policy("fuzzy-1").controller.save(tmp_path / "fuzzy-1.json")
    with pytest.raises(ValueError, match="two of them have the same name"):
        measure_margins(MarginsConfig(("fuzzy-1", str(tmp_path / "fuzzy-1.json"))))


@pytest.mark.slow
def test_margins_of_a_robot():
    document = measure_margins(MarginsConfig(robot="planar-3r"))
    assert [row["policy"] for row in document["rows"]] == list(ANY_ROBOT)
    assert document["robot"]["name"] == "planar-3r" and "parameters" not in document
    assert all(row["spectral_radius"]["nominal"] < 1.0 for row in document["rows"])
    assert "the default reference of planar-3r" in margin_notes(document)[0]


ONE_OF_A_KIND = ("fuzzy-4-tip", "elastic-observer", "learned-observer", "ppo-robust")


@pytest.mark.parametrize("policies", slow_but([ONE_OF_A_KIND], [ONE_OF_A_KIND, None]), ids=str)
def test_every_policy_there_is(policies, monkeypatch):
    """By default each has its row, is stable in the nominal loop unless it was learned, and is reported when done."""
    monkeypatch.setattr("fuzzyarm.eval.stability._linearisation.POSTURES", 1)  # not 16: each row is tested
    steps = []
    document = measure_margins(MarginsConfig(policies), lambda: steps.append(1))
    names = [row["policy"] for row in document["rows"]]
    assert names == list(policies or NAMES) and len(steps) == len(names)
    for row in document["rows"]:
        radius = row["spectral_radius"]["nominal"]
        if row["policy"] in LEARNED:  # their training did not require stability
            assert radius is not None or "no equilibrium" in row["reasons"]["nominal"]
        else:
            assert radius is not None and 0.5 < radius < 1.0, row["reasons"]


def test_a_design_that_is_unstable_on_the_elastic_arm_is_warned_of_in_words():
    shipped = load_policy("fuzzy-4")
    hasty = FuzzyPolicy(dataclasses.replace(shipped.controller, gains=6.0 * shipped.controller.gains))
    assert "WARNING" not in margins_in_words(shipped, ARM, 1e-3)
    text = margins_in_words(hasty, ARM, 1e-3)
    assert "WARNING: the proof is for the rigid arm" in text and "raise --gamma" in text
