"""The table of the compared policies, from the stored result of `comparison.py`."""

from __future__ import annotations

from typing import Any

from compared_policies import POLICIES, preparation_s
from readme_markdown import made_with, table

__all__ = ["comparison_table"]

_OF_THE_PAPER = ("nominal", "machining", "payload")


def comparison_table(document: dict[str, Any]) -> str:
    """Return the one table of the compared policies, the probabilities of improvement, and how they were made."""
    method, cases = document["method"], document["cases"]
    return (
        f"{_policies(document)}\n\n"
        f"Tasks: rms tip error [mm] with the arm of Table 1, of several seeds the interquartile mean of those that did "
        f"not lose the path; other motions: the largest of five. Plants: interquartile mean of the rms tip error [mm] "
        f"over {method['plants']:,} plants ({method['seed_plants']:,} for each of several seeds), interval of 95 % and "
        f"rank in brackets; where intervals overlap before they are rounded, policies share a rank. Ended early: of "
        f"{len(cases) * method['plants']:,} episodes of the shipped policy. Processor time: of the last training, "
        "median over seeds, or of the last synthesis with its proof, without the trials that chose their settings and "
        "without what a policy builds on; *not measured* where a search chose the numbers. Stable: in how many of the "
        f"eight conditions of [](../theory/margins.md) its local loop is stable.{_alone(document)}\n\n"
        f"Probability that the policy of the row has a smaller rms error than that of the column [%], over plants and "
        f"cases:\n\n{_improvements(document)}\n\n"
        f"`{document['command']}`, plants from seed {method['first_seed']} on; {made_with(document)}"
    )


def _alone(document: dict[str, Any]) -> str:
    """Return a sentence on the learned policies of which no other seed ran."""
    names = [f"`{row['name']}`" for row in document["rows"] if POLICIES[row["name"]].learned and not row["seeds"]]
    return f" Of {' and '.join(names)} the shipped seed alone ran." if names else ""


def _policies(document: dict[str, Any]) -> str:
    cases = document["cases"]
    headings = ["policy", "knows", "chosen or trained on", "processor time [s]"]
    headings += ["Case 1", "Case 2", "Case 3", "other motions", "runs lost"]
    headings += [f"plants, {title}" for title in cases.values()] + ["ended early", "stable"]
    rows = []
    for row in document["rows"]:
        tasks, plants, one = row["tasks"], row["plants"], POLICIES[row["name"]]
        spent = preparation_s(one.name)
        lost = sum(task["failed"] for task in tasks.values())
        runs = sum(task["runs"] for task in tasks.values())
        stable = sum(radius is not None and radius < 1.0 for radius in row["spectral_radius"].values())
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
                f"{stable} of {len(row['spectral_radius'])}",
            ]
        )
    return table(headings, rows, left=3)


def _task(found: list[dict[str, Any]]) -> str:
    """Return the largest of some tasks' errors; a dash where all runs of one were lost."""
    means = [None if task["rms_mm"] is None else task["rms_mm"]["mean"] for task in found]
    return "-" if None in means else _digits(max(mean for mean in means if mean is not None), 2)


def _score(found: dict[str, Any]) -> str:
    score = found["score_mm"]
    if score["mean"] is None:
        return f"- ({found['rank']})"
    mean, low, high = ("∞" if value is None else _digits(value, 3) for value in score.values())
    return f"{mean}, {low} to {high} ({found['rank']})"


def _improvements(document: dict[str, Any]) -> str:
    names = [row["name"] for row in document["rows"]]
    known = {(row["policy"], row["over"]): (row["probability"], row["interval"]) for row in document["improvement"]}
    known |= {(q, p): (1.0 - value, [1.0 - high, 1.0 - low]) for (p, q), (value, (low, high)) in known.items()}
    rows = []
    for one in names:
        cells = [
            "" if one == other else "{:.0f}, {:.0f} to {:.0f}".format(*(100.0 * v for v in _flat(known[one, other])))
            for other in names
        ]
        rows.append([f"`{one}`", *cells])
    return table(["", *(f"`{name}`" for name in names)], rows)


def _flat(found: tuple[float, list[float]]) -> list[float]:
    return [found[0], *found[1]]


def _digits(value: float, count: int) -> str:
    return f"{value:#.{count}g}".rstrip(".") if abs(value) < 100.0 else f"{value:.0f}"
