"""A footer names every commit and machine that the rows above it come from."""

import json
from pathlib import Path

import pytest

VERSIONS = dict.fromkeys(("python", "numpy", "llvmlite", "clarabel"), "1")
MADE = {"commit": "a" * 40, "versions": VERSIONS, "machine": {"cpu": "one", "cores": 2}}
ONE = "one, 2 cores, Python 1, numpy 1, llvmlite 1, clarabel 1"


@pytest.fixture
def made_with(module):
    return module("readme_markdown").made_with


def test_commits_of_one_machine_stand_together(made_with):
    later = MADE | {"commit": "b" * 40 + "+changes"}
    assert made_with(MADE, later, MADE) == f"{ONE}, commits aaaaaaaaaa, bbbbbbbbbb with changes."


def test_rows_with_a_commit_of_their_own_are_named(made_with):
    rows = [{"commit": "b" * 40, "cpu": "two"}, {"x": 1.0}, {"provenance": MADE | {"commit": "c" * 40}}]
    expected = f"{ONE}, commits aaaaaaaaaa, cccccccccc; two, commit bbbbbbbbbb."
    assert made_with({**MADE, "rows": rows}) == expected


def test_a_commit_without_a_machine_says_so_unless_it_is_named_with_one(made_with):
    assert made_with(MADE, [{"commit": "a" * 40}]) == f"{ONE}, commit aaaaaaaaaa."
    assert (
        made_with(MADE, [{"commit": "b" * 40}]) == f"{ONE}, commit aaaaaaaaaa; machine not stored, commit bbbbbbbbbb."
    )


def test_readme_names_the_commits_of_its_bounds(module):
    """The column of proofs has rows of another commit than the comparison."""
    script = module("readme")
    text = script.readme_sections()["results"]
    bounds = json.loads((Path(script.RESULTS) / "tip_bound.json").read_text(encoding="utf-8"))
    tips = module("readme_results")._tips(script._stored("evaluate"), bounds)
    shown = [row for rows in tips.values() for row in rows]
    assert {row["commit"] for row in shown} - {script._stored("evaluate")["commit"]}
    assert all(f"{row['commit'][:10]}" in text and row["cpu"] in text for row in shown)
