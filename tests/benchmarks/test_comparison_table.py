"""The comparison's table and figure show what is stored, every policy on the same terms."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
STORED = json.loads((BENCHMARKS / "results" / "comparison.json").read_text(encoding="utf-8"))


@pytest.fixture
def module(monkeypatch):
    """Return a function that imports a script as if run from its folder."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module


def test_everything_that_is_drawn_is_in_sight_and_what_has_no_mean_says_so(module):
    panels = module("comparison_figure").draw_comparison(STORED).axes
    for axes, case in zip(panels, STORED["cases"], strict=True):
        low, high = axes.get_xlim()
        for line in axes.lines:
            assert low <= min(line.get_xdata()) and max(line.get_xdata()) <= high
        means = [row["plants"][case]["score_mm"]["mean"] for row in STORED["rows"]]
        dots = [line.get_xdata()[0] for line in axes.lines if line.get_marker() == "o"]
        assert dots == [mean for mean in means if mean is not None]
        assert len(axes.texts) == means.count(None)
    assert any(axes.texts for axes in panels)


def test_scores_show_three_digits(module):
    found = {"score_mm": {"mean": 1.2854, "low": 1.2726, "high": None}, "rank": 2}
    other = {"score_mm": {"mean": 159.43, "low": 33.711, "high": 469.25}, "rank": 11}
    assert [module("readme_comparison")._score(one) for one in (found, other)] == [
        "1.29, 1.27 to ∞ (2)",
        "159, 33.7 to 469 (11)",
    ]


def test_a_search_without_a_stored_time_is_not_measured(module):
    lines = module("readme_comparison").comparison_table(STORED).splitlines()
    unmeasured = [line.split("`")[1] for line in lines if " not measured " in line]
    assert unmeasured == ["computed-torque", "computed-torque-tip", "elastic-observer", "adaptive-observer"]


def test_what_a_policy_knows_includes_what_is_known_within_it_and_all_seeds_are_found(module):
    known = module("compared_policies").POLICIES
    assert list(known) == [row["name"] for row in STORED["rows"]]
    assert known["learned-observer"].knows == known["adaptive-observer"].knows
    assert known["ppo-residual"].knows == known["fuzzy-4-tip"].knows
    for one in known.values():
        assert len(list(BENCHMARKS.glob(one.seeds)) if one.seeds else ()) == (5 if one.learned else 0)


@pytest.mark.parametrize("seeds", [0, 5])
def test_the_table_says_of_which_learned_policy_no_other_seed_ran(seeds, module):
    rows = [row | ({"seeds": seeds} if row["name"] == "learned-observer" else {}) for row in STORED["rows"]]
    text = module("readme_comparison").comparison_table(STORED | {"rows": rows})
    assert ("Of `learned-observer` the shipped seed alone ran." in text) == (seeds == 0)


def test_a_run_takes_every_stored_seed_and_fills_table_and_figure(module, monkeypatch):
    """With stand-ins for what takes long: the policies themselves, their episodes and their margins."""
    script, loaded = module("comparison"), []
    task = {"task": "nominal", "tip_error_rms_mm": 1.0, "failed": None}
    tasks = [task | {"task": name} for name in STORED["rows"][0]["tasks"]]
    margins = [{"policy": row["name"], "spectral_radius": row["spectral_radius"]} for row in STORED["rows"]]

    def errors_of(policies, plants, jobs, advance):
        errors = np.ones((len(policies), len(script.COMPARED_CASES), plants)) + np.arange(len(policies))[:, None, None]
        return errors, errors

    monkeypatch.setattr(script, "load_policy", lambda name: loaded.append(name))
    monkeypatch.setattr(script, "assess", lambda policy, name, arm: tasks)
    monkeypatch.setattr(script, "measure_margins", lambda config: {"rows": margins})
    monkeypatch.setattr(script, "errors_of", errors_of)
    document = json.loads(json.dumps(script.compare(4, 2, None)))
    seeds = {row["name"]: row["seeds"] for row in document["rows"]}
    assert seeds == {name: 5 if one.learned else 0 for name, one in script.POLICIES.items()}
    assert len(loaded) == len(seeds) + sum(seeds.values())
    assert "`learned-observer`, 5 seeds" in module("readme_comparison").comparison_table(document)
    module("comparison_figure").draw_comparison(document)
