"""The table of the compared policies and a sentence on their pairs, from the result of `comparison.py`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from compared_policies import POLICIES, preparation_s
from tables import Section, made_with, markdown

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["COMPARISON", "score_of", "stable_of"]

_OF_THE_PAPER = ("nominal", "machining", "payload")


def _text(document: dict[str, Any], margins: dict[str, Any]) -> str:
    """Return what stands below the table, but for the line that says how it was made."""
    method, cases = document["method"], document["cases"]
    alone = [f"`{row['name']}`" for row in document["rows"] if POLICIES[row["name"]].learned and not row["seeds"]]
    return (
        f"Tasks: rms tip error [mm] with the arm of Table 1, of several seeds the interquartile mean of those that did "
        f"not lose the path; other motions: the largest of five. Plants: interquartile mean of the rms tip error [mm] "
        f"over {method['plants']:,} plants ({method['seed_plants']:,} for each of several seeds), interval of 95 % and "
        f"rank in brackets; where intervals overlap before they are rounded, policies share a rank. Ended early: of "
        f"{len(cases) * method['plants']:,} episodes of the shipped policy. Processor time: of the last training, "
        "median over seeds, or of the last synthesis with its proof, without the trials that chose their settings and "
        "without what a policy builds on; *not measured* where a search chose the numbers. Stable: in how many of the "
        f"eight conditions of [](../theory/margins.md) its local loop is stable, as `{margins['command']}` finds it."
        + (f" Of {' and '.join(alone)} the shipped seed alone ran." if alone else "")
    )


def _policies(document: dict[str, Any], margins: dict[str, Any]) -> str:
    """Return the table."""
    cases, radii = document["cases"], {row["policy"]: row["spectral_radius"].values() for row in margins["rows"]}
    headings = ["policy", "knows", "chosen or trained on", "processor time [s]"]
    headings += ["Case 1", "Case 2", "Case 3", "other motions", "runs lost"]
    headings += [f"plants, {title}" for title in cases.values()] + ["ended early", "stable"]
    rows = []
    for row in document["rows"]:
        tasks, plants, one = row["tasks"], row["plants"], POLICIES[row["name"]]
        spent = preparation_s(one.name)
        lost, runs = (sum(task[key] for task in tasks.values()) for key in ("failed", "runs"))
        rows.append(
            [
                f"`{row['name']}`" + (f", {row['seeds']} seeds" if row["seeds"] else ""),
                one.knows,
                one.chosen_on,
                "not measured" if spent is None else _digits(spent, 2),
                *(_task([tasks[name]]) for name in _OF_THE_PAPER),
                _task([task for name, task in tasks.items() if name not in _OF_THE_PAPER]),
                f"{lost} of {runs}",
                *(score_of(plants[case]) for case in cases),
                str(sum(plants[case]["ended_early"] for case in cases)),
                stable_of(radii.get(one.name)),
            ]
        )
    return markdown(headings, rows, left=3)


def stable_of(radii: Collection[float | None] | None) -> str:
    """Return in how many of its conditions a loop with these spectral radii is stable."""
    if radii is None:
        return "not measured"
    return f"{sum(radius is not None and radius < 1.0 for radius in radii)} of {len(radii)}"


def _task(found: list[dict[str, Any]]) -> str:
    """Return the largest of some tasks' errors; a dash where all runs of one were lost."""
    means = [None if task["rms_mm"] is None else task["rms_mm"]["mean"] for task in found]
    return "-" if None in means else millimetres(max(means), lambda value: _digits(value, 2))


def score_of(found: dict[str, Any]) -> str:
    """Return a score with its interval and rank."""
    if found["score_mm"]["mean"] is None:
        return f"- ({found['rank']})"
    mean, low, high = ("∞" if value is None else _digits(value, 3) for value in found["score_mm"].values())
    return f"{mean}, {low} to {high} ({found['rank']})"


def _made(document: dict[str, Any], margins: dict[str, Any]) -> str:
    """Return the line, with the policies whose errors another commit measured than the one of the document."""
    others = {row["name"]: row["commits"] for row in document["rows"] if row["commits"] != [document["commit"]]}
    words = "; ".join(f"`{name}` at {', '.join(one[:10] for one in commits)}" for name, commits in others.items())
    return (
        f"`{document['command']}`, plants from seed {document['method']['first_seed']} on; "
        f"{made_with(document, margins)}{f' Errors over plants measured at other commits: {words}.' if others else ''}"
    )


def _digits(value: float, count: int) -> str:
    return f"{value:#.{count}g}".rstrip(".") if abs(value) < 100.0 else f"{value:.0f}"


COMPARISON = {"comparison": Section(("comparison", "margins"), (_policies, _text, _made), None)}
"""The section by its name."""
