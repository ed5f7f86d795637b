"""Tables show what is stored: the commits that they come from, which bounds are proven, and how many digits count."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
VERSIONS = dict.fromkeys(("python", "numpy", "llvmlite", "clarabel"), "1")
MADE = {"commit": "a" * 40, "versions": VERSIONS, "machine": {"cpu": "one", "cores": 2}}
ONE = "one, 2 cores, Python 1, numpy 1, llvmlite 1, clarabel 1"
CIRCLE = {"case": "nominal", "path": "circle", "duration": 1.5, "proven": True}
ROWS = [{"commit": "b" * 40, "cpu": "two"}, {"x": 1.0}, {"provenance": MADE | {"commit": "c" * 40}}]


@pytest.mark.parametrize(
    ("parts", "line"),
    [
        (
            (MADE, MADE | {"commit": "b" * 40 + "+changes"}, MADE),
            f"{ONE}, commits aaaaaaaaaa, bbbbbbbbbb with changes.",
        ),
        (({**MADE, "rows": ROWS},), f"{ONE}, commits aaaaaaaaaa, cccccccccc; two, commit bbbbbbbbbb."),
        ((MADE, [{"commit": "a" * 40}]), f"{ONE}, commit aaaaaaaaaa."),
        ((MADE, [{"commit": "b" * 40}]), f"{ONE}, commit aaaaaaaaaa; machine not stored, commit bbbbbbbbbb."),
    ],
)
def test_the_line_below_a_table_names_every_commit_and_machine(module, parts, line):
    assert module("tables").made_with(*parts) == line


def test_readme_names_the_commits_of_its_bounds(module):
    """The column of proofs has rows of another commit than the others."""
    script = module("readme")
    text, policies = script.readme_sections()["results"], {row["policy"] for row in script.stored("overview")["rows"]}
    bounds = module("tables_results").on_the_circle(script.stored("tip_bound"))
    shown = [row for row in bounds if row["set"] == "near" and row["policy"] in policies]
    assert {row["commit"] for row in shown} - {script.stored("overview")["commit"]}
    assert all(f"{row['commit'][:10]}" in text and row["cpu"] in text for row in shown)


def test_every_table_of_the_pages_is_made_and_every_one_that_is_made_is_shown(module):
    pages = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md")]
    asked = {name for page in pages for name in re.findall(r"^```\{results\} (\S+)$", page, re.MULTILINE)}
    sections = module("readme").sections()
    assert asked == sections.keys()
    assert all(text.strip() and "commit" in text for name, text in sections.items() if name != "robots")


def bound(policy, name, millimetres, payload=0.0, **others):
    row = {"policy": policy, "set": name, "bound_mm": millimetres, "plants": {"payload": [0.0, payload]}}
    return {**CIRCLE, **row, **MADE, **others}


EXACT, NEAR = bound("a", "table-1", 0.00226), bound("a", "near", 0.6747)
OTHERS = {"proven": False}, {"case": "payload"}, {"path": "lemniscate"}, {"duration": 1.2}, {"policy": "b"}
LOADS = [bound("a", f"payload 0 to {load:g} kg", load, load) for load in (5.0, 0.2)]


@pytest.mark.parametrize(
    ("rows", "certificate", "words"),
    [
        ((EXACT,), None, "tip within 0.0023 mm (exact)"),
        ((EXACT, NEAR), None, "tip within 0.68 mm (near)"),
        ((NEAR, EXACT), None, "tip within 0.68 mm (near)"),
        (
            (EXACT, *LOADS, NEAR, bound("a", "any-friction", 0.97)),
            None,
            "tip within 0.68 mm (near), 0.97 mm (any friction), 5 mm (payload 0 to 5 kg)",
        ),
        ((NEAR,), "For the rigid arm ...", "rigid arm; tip within 0.68 mm (near)"),
        *(((NEAR | other,), None, "no") for other in OTHERS),
    ],
)
def test_proofs_of_the_circle_are_shown_and_the_bound_of_one_arm_is_labelled_or_left_out(
    module, rows, certificate, words
):
    document = {"certificates": {"a": certificate}}
    assert module("tables_results")._proven(document, {"rows": rows}) == {"a": words}


def test_the_readme_shows_seeds_noise_plants_and_the_bound_for_nearby_arms(module):
    """Below a micrometre no number, above it two digits, the bound rounded up; a policy that lost a plant has none."""
    row = {
        **{"policy": "a", "rms_mm": [0.0004, 4.98, 1.839], "rms_mm_of_seeds": [], "noisy_rms_mm": [0.0053, 4.98, 1.84]},
        "plants_mm": 15.43,
    }
    seeds = {**row, "policy": "b", "rms_mm_of_seeds": [[0.9, 3.0, 2.0], [1.6, 2.9, 2.6]], "plants_mm": None}
    documents = {
        "overview": {"rows": [row, seeds], "command": "x", **MADE},
        "tip_bound": {"rows": [EXACT, NEAR], "command": "y"},
    }
    text = module("tables_results").README["results"].text(documents.__getitem__)
    assert "| `a` | < 0.001 | 5.0 | 1.8 | 0.0053 / 5.0 / 1.8 | 15 | 0.68 mm |" in text
    assert (
        "| `b` | < 0.001 (0.90 to 1.6) | 5.0 (2.9 to 3.0) | 1.8 (2.0 to 2.6) | 0.0053 / 5.0 / 1.8 | lost |  |" in text
    )
