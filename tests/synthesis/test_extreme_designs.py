"""Extreme requirements end in one line: out of range, infeasible, or a design that is proven."""

import contextlib

import pytest
from slow_twins import slow_but

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.proof.certificate import certify
from fuzzyarm.synthesis import DesignFailed, Specification, design, search


@pytest.mark.parametrize(
    "option",
    [
        "--alpha=1e300",
        "--alpha=1e-300",
        "--gamma=1e300",
        "--gamma=1e-300",
        "--gain-bound=1e300",
        "--fastest-pole=1e300",
        f"--gamma=1{'0' * 400}",
        "--alpha=1e400",
        "--gamma=nan",
        "--gamma=-1",
    ],
)
def test_an_extreme_requirement_is_refused_in_one_line(tmp_path, capsys, option):
    assert main(["design", option, "--out", str(tmp_path / "extreme.json")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "is out of range; allowed: [1e-" in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "options",
    [
        ["--gamma=1e-30"],
        pytest.param(["--alpha=1e6"], marks=pytest.mark.slow),
        ["--alpha=2e-6", "--gamma=1e-30"],
        ["--gain-bound=1e-30"],
        pytest.param(["--alpha=9e5", "--fastest-pole=9.9e5"], marks=pytest.mark.slow),
        pytest.param(["--theorem=paper", "--gamma=1e-30"], marks=pytest.mark.slow),
    ],
    ids=" ".join,
)
@pytest.mark.slow
def test_requirements_at_the_end_of_their_ranges_fail_in_one_line(tmp_path, capsys, options):
    assert main(["design", "--rules=1", *options, "--out", str(tmp_path / "extreme.json")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "nothing was written" in error


EASY = ["--gamma=1e30", "--alpha=1e-6", "--fastest-pole=1e6"]


@pytest.mark.parametrize("option", slow_but(EASY[:1], EASY))
@pytest.mark.usefixtures("unmeasured")
def test_requirements_at_the_easy_end_of_their_ranges_are_proven(tmp_path, option):
    path = tmp_path / "easy.json"
    assert main(["design", "--rules=1", option, "--out", str(path)]) == 0
    assert main(["verify", str(path)]) == 0


@pytest.mark.parametrize("asked", [{"alpha": 1e-6}, {"fastest_pole": 1e6}], ids=str)
def test_a_design_at_the_easy_end_of_a_range_is_proven_from_its_file(tmp_path, asked):
    made = design(Specification(kept=(), **asked))
    made.controller.save(tmp_path / "easy.json")
    assert made.certificate.proven and certify(Controller.load(tmp_path / "easy.json")).proven


@pytest.mark.parametrize("field", ["alpha", "gamma", "gain_bound", "fastest_pole"])
def test_a_huge_whole_number_is_refused_in_python_too(field):
    with pytest.raises(ValueError, match=f"{field} = 1000.*is out of range"):
        Specification(**{field: 10**400})


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3, 1e9])
def test_a_design_for_an_arm_of_another_size_is_proven_or_fails_in_words(scale):
    table_1 = ArmParameters()
    arm = ArmParameters(
        mass=tuple(scale * mass for mass in table_1.mass),
        motor_inertia=(2.71 * scale, 0.5 * scale),
        inertia=(0.31 * scale, 0.19 * scale),
    )
    with contextlib.suppress(DesignFailed):
        assert design(Specification(kept=()), arm).certificate.proven


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        pytest.param(
            {"alpha": 1e6},
            "alpha would have to give: the largest that works for one vertex of the model alone is about",
            marks=pytest.mark.slow,
        ),
        pytest.param({"alpha": 9e5, "fastest_pole": 9.9e5}, "works for one vertex", marks=pytest.mark.slow),
        ({"gamma": 1e-30}, r"no decay rate down to 0\.02 1/s helps: raise gamma$"),
        ({"alpha": 1e5, "gamma": None, "gain_bound": 100.0}, "helps: raise the gain bound$"),
    ],
    ids=str,
)
@pytest.mark.slow
def test_the_32_rules_of_an_impossible_design_are_never_solved(monkeypatch, asked, words):
    """One vertex of A refutes it in a fraction of a second; its limit is the one that is named."""
    solved = []

    def noted(specification, arm, vertex, factor):
        solved.append(vertex)
        return asked_for(specification, arm, vertex, factor)

    asked_for = search._asked
    monkeypatch.setattr(search, "_asked", noted)
    with pytest.raises(DesignFailed, match=words):
        design(Specification(kept=NAMED_RULES[32], **asked))
    assert solved and None not in solved


@pytest.mark.slow
def test_what_one_vertex_allows_is_an_upper_bound_of_what_all_allow():
    asked = Specification(kept=NAMED_RULES[4], alpha=1e4, gamma=1e-3, gain_bound=1e5)
    one = search.nearest_feasible(asked, ArmParameters(), "alpha", 0)
    every = search.nearest_feasible(asked, ArmParameters(), "alpha")
    assert 0.5 * one < every < 1.03 * one
