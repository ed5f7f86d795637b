"""The comparison's table shows what is stored, every policy on the same terms."""

import json
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm.policies.registry import NAMES

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
STORED, MARGINS = (
    json.loads((BENCHMARKS / "results" / f"{name}.json").read_text(encoding="utf-8"))
    for name in ("comparison", "margins")
)


def test_what_a_policy_knows_includes_what_is_known_within_it_and_all_seeds_are_found(module):
    known = module("compared_policies").POLICIES
    assert list(known) == [row["name"] for row in STORED["rows"]]
    assert set(known) == set(NAMES)
    assert known["learned-observer"].knows == known["adaptive-observer"].knows
    assert known["ppo-residual"].knows == known["fuzzy-4-tip"].knows
    for one in known.values():
        assert len(list(BENCHMARKS.glob(one.seeds)) if one.seeds else ()) == (5 if one.learned else 0)


def test_stable_conditions_are_counted_and_a_policy_without_margins_says_so(module):
    stable = module("tables_comparison").stable_of
    assert (stable([0.99, 1.0, 1.2, None]), stable(None)) == ("1 of 4", "not measured")
    found = {row["policy"]: stable(row["spectral_radius"].values()) for row in MARGINS["rows"]}
    assert (found["elastic-observer"], found["adaptive-observer"]) == ("8 of 8", "2 of 8")


@pytest.mark.parametrize("seeds", [0, 5])
def test_the_table_says_of_which_learned_policy_no_other_seed_ran(seeds, module):
    rows = [row | ({"seeds": seeds} if row["name"] == "learned-observer" else {}) for row in STORED["rows"]]
    documents = {"comparison": STORED | {"rows": rows}, "margins": MARGINS}
    text = module("tables_comparison").COMPARISON["comparison"].text(documents.get)
    assert ("Of `learned-observer` the shipped seed alone ran." in text) == (seeds == 0)


def test_errors_on_other_plants_or_cases_are_not_taken_for_these(module, tmp_path, monkeypatch):
    script, runs = module("plant_errors"), []

    def errors_of(policy, plants, jobs, report):
        runs.append(plants)
        return script.Errors(np.arange(5.0 * plants).reshape(5, plants), np.full((5, plants), np.inf), "")

    monkeypatch.setattr(script, "errors_of", errors_of)
    first, again = (script.measured(tmp_path / "a.npz", None, 3, None, None) for _ in range(2))
    assert runs == [3] and again.commit == ""
    assert np.array_equal(first.rms_mm, again.rms_mm) and np.array_equal(first.largest_mm, again.largest_mm)
    script.measured(tmp_path / "a.npz", None, 2, None, None)
    monkeypatch.setattr(script, "FIRST_SEED", script.FIRST_SEED + 1)
    script.measured(tmp_path / "a.npz", None, 2, None, None)
    assert runs == [3, 2, 2]
