"""Extreme requirements end in one line, or in a design that is proven."""

import contextlib

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.synthesis import DesignFailed, Specification, design
from fuzzyarm.synthesis import _feasibility as search


@pytest.mark.parametrize("option", slow_but(["--gamma=1e30"], ["--gamma=1e30", "--alpha=1e-6", "--fastest-pole=1e6"]))
@pytest.mark.usefixtures("unmeasured")
def test_requirements_at_the_easy_end_of_their_ranges_are_proven(tmp_path, option):
    path = str(tmp_path / "easy.json")
    assert main(["design", "--rules=1", option, "--out", path]) == main(["verify", path]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3, 1e9])
def test_a_design_for_an_arm_of_another_size_is_proven_or_fails_in_words(scale):
    scaled = {
        name: tuple(scale * np.array(getattr(ArmParameters(), name))) for name in ("mass", "motor_inertia", "inertia")
    }
    arm = ArmParameters(**scaled)
    with contextlib.suppress(DesignFailed):
        assert design(Specification(kept=()), arm).certificate.proven


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"alpha": 1e6}, r"relax alpha to about \S+ 1/s, the largest that works for one vertex of the model alone"),
        ({"alpha": 9e5, "fastest_pole": 9.9e5}, "works for one vertex"),
        ({"gamma": 1e-30}, r"lowering alpha, even to 0\.02 1/s, does not help: raise gamma$"),
        ({"alpha": 1e5, "gamma": None, "gain_bound": 100.0}, "does not help: raise the gain bound$"),
    ],
    ids=str,
)
@pytest.mark.slow
def test_the_32_rules_of_an_impossible_design_are_never_solved(monkeypatch, asked, words):
    """One vertex of A refutes it in a fraction of a second; its limit is the one that is named."""
    solved, asked_for = [], search._asked

    def noted(specification, arm, vertex, factor):
        solved.append(vertex)
        return asked_for(specification, arm, vertex, factor)

    monkeypatch.setattr(search, "_asked", noted)
    with pytest.raises(DesignFailed, match=words):
        design(Specification(kept=NAMED_RULES[32], **asked))
    assert solved and None not in solved
