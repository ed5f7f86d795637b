"""The table of the compared policies and a sentence on their pairs, from the stored result of `comparison.py`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from compared_policies import POLICIES, preparation_s
from readme_markdown import made_with, table

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["comparison_table"]

_OF_THE_PAPER = ("nominal", "machining", "payload")


def comparison_table(document: dict[str, Any], margins: dict[str, Any]) -> str:
    """Return the one table of the compared policies, the probabilities of improvement, and how they were made.

    `margins` is the document of `fuzzyarm margins`.
    """
    method, cases = document["method"], document["cases"]
    return (
        f"{_policies(document, margins)}\n\n"
        f"Tasks: rms tip error [mm] with the arm of Table 1, of several seeds the interquartile mean of those that did "
        f"not lose the path; other motions: the largest of five. Plants: interquartile mean of the rms tip error [mm] "
        f"over {method['plants']:,} plants ({method['seed_plants']:,} for each of several seeds), interval of 95 % and "
        f"rank in brackets; where intervals overlap before they are rounded, policies share a rank. Ended early: of "
        f"{len(cases) * method['plants']:,} episodes of the shipped policy. Processor time: of the last training, "
        "median over seeds, or of the last synthesis with its proof, without the trials that chose their settings and "
        "without what a policy builds on; *not measured* where a search chose the numbers. Stable: in how many of the "
        f"eight conditions of [](../theory/margins.md) its local loop is stable, as "
        f"`{margins['command']}` finds it.{_alone(document)}\n\n"
        f"{_pairs(document['improvement'])}\n\n"
        f"`{document['command']}`, plants from seed {method['first_seed']} on; {made_with(document, margins)}"
        f"{_measured_at(document)}"
    )


def _alone(document: dict[str, Any]) -> str:
    """Return a sentence on the learned policies of which no other seed ran."""
    names = [f"`{row['name']}`" for row in document["rows"] if POLICIES[row["name"]].learned and not row["seeds"]]
    return f" Of {' and '.join(names)} the shipped seed alone ran." if names else ""


def _policies(document: dict[str, Any], margins: dict[str, Any]) -> str:
    cases, radii = document["cases"], {row["policy"]: row["spectral_radius"].values() for row in margins["rows"]}
    headings = ["policy", "knows", "chosen or trained on", "processor time [s]"]
    headings += ["Case 1", "Case 2", "Case 3", "other motions", "runs lost"]
    headings += [f"plants, {title}" for title in cases.values()] + ["ended early", "stable"]
    rows = []
    for row in document["rows"]:
        tasks, plants, one = row["tasks"], row["plants"], POLICIES[row["name"]]
        spent = preparation_s(one.name)
        lost = sum(task["failed"] for task in tasks.values())
        runs = sum(task["runs"] for task in tasks.values())
        rows.append(
            [
                f"`{row['name']}`" + (f", {row['seeds']} seeds" if row["seeds"] else ""),
                one.knows,
                one.chosen_on,
                "not measured" if spent is None else _digits(spent, 2),
                *(_task([tasks[name]]) for name in _OF_THE_PAPER),
                _task([task for name, task in tasks.items() if name not in _OF_THE_PAPER]),
                f"{lost} of {runs}",
                *(_score(plants[case]) for case in cases),
                str(sum(plants[case]["ended_early"] for case in cases)),
                _stable(radii.get(one.name)),
            ]
        )
    return table(headings, rows, left=3)


def _stable(radii: Collection[float | None] | None) -> str:
    """Return in how many of its conditions a loop with these spectral radii is stable."""
    if radii is None:
        return "not measured"
    return f"{sum(radius is not None and radius < 1.0 for radius in radii)} of {len(radii)}"


def _task(found: list[dict[str, Any]]) -> str:
    """Return the largest of some tasks' errors; a dash where all runs of one were lost."""
    means = [None if task["rms_mm"] is None else task["rms_mm"]["mean"] for task in found]
    return "-" if None in means else millimetres(max(mean for mean in means if mean is not None), _two_digits)


def _score(found: dict[str, Any]) -> str:
    score = found["score_mm"]
    if score["mean"] is None:
        return f"- ({found['rank']})"
    mean, low, high = ("∞" if value is None else _digits(value, 3) for value in score.values())
    return f"{mean}, {low} to {high} ({found['rank']})"


def _pairs(improvement: list[dict[str, Any]]) -> str:
    """Return how wide the intervals of the probabilities of improvement are, and which of them contain a half."""
    widest = max(high - low for low, high in (pair["interval"] for pair in improvement))
    equal = [pair for pair in improvement if pair["interval"][0] <= 0.5 <= pair["interval"][1]]
    words = "; ".join(f"`{pair['policy']}` and `{pair['over']}`" for pair in equal)
    return (
        f"The probabilities of improvement in the second figure have intervals of 95 % over plants that are at most "
        f"{100.0 * widest:.1f} percentage points wide. Of {len(improvement)} pairs "
        + (
            f"{len(equal)} have an interval that contains 50 %: {words}."
            if equal
            else "none has one that contains 50 %."
        )
    )


def _measured_at(document: dict[str, Any]) -> str:
    """Return a sentence on the policies whose errors another commit measured than the one of the document."""
    others = {row["name"]: row["commits"] for row in document["rows"] if row["commits"] != [document["commit"]]}
    words = "; ".join(f"`{name}` at {', '.join(one[:10] for one in commits)}" for name, commits in others.items())
    return f" Errors over plants measured at other commits: {words}." if others else ""


def _two_digits(value: float) -> str:
    return _digits(value, 2)


def _digits(value: float, count: int) -> str:
    return f"{value:#.{count}g}".rstrip(".") if abs(value) < 100.0 else f"{value:.0f}"
