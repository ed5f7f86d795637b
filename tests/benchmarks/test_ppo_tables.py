"""How the tables of PPO sum up seeds."""

import pytest

MADE = {
    "commit": "0" * 40,
    "versions": dict.fromkeys(("python", "numpy", "llvmlite", "clarabel"), "1"),
    "machine": {"cpu": "a processor", "cores": 2},
}


@pytest.fixture
def script(module):
    """The script, which imports its neighbours."""
    return module("readme_learning")


def run(setting, seed, value, radius=0.5):
    """A run all of whose errors are one value."""
    cases = {case: {"rms_mm": value, "torque_rate": value} for case in ("nominal", "machining", "payload")}
    seen = {"median_mm": value, "mean_mm": value, "p99_mm": value, "lost": 0}
    curve = [{"steps": 1e6, "machining": value, "payload": value}]
    row = {"setting": setting, "seed": seed, "steps": 1e6, "development": seen, "cases": cases, "late": cases}
    return row | {"radius": {"0": radius}, "cpu_time_s": value, "curve": curve}


@pytest.fixture
def document():
    """Two settings with three seeds, and a run of each other group."""
    one = {group: [run("as is", 0, 1.0)] for group in ("observer", "told", "longer", "robust", "smooth")}
    several = [run(setting, seed, 10.0 * k + seed) for k, setting in enumerate("ab") for seed in (3, 1, 2)]
    return {"references": {}, "runs": one | {"knobs": several}, "command": "a command", **MADE}


def test_settings_with_several_seeds_have_median_and_range(script, document):
    rows = [line for line in script.observer_tables(document).splitlines() if line.startswith(("| a |", "| b |"))]
    assert len(rows) == 2
    assert "2.00 (1.00 to 3.00) / 2.00 (1.00 to 3.00)" in rows[0]
    assert "12.00 (11.00 to 13.00)" in rows[1]


def test_a_seed_without_a_radius_leaves_none_for_its_setting(script, document):
    document["runs"]["knobs"][1]["radius"]["0"] = None
    rows = [line.split("|") for line in script.observer_tables(document).splitlines() if line.startswith("| a |")]
    assert rows[0][-3].strip() == "-"
