"""The tables of the opponents: model-predictive control, and classical laws tuned on the learners' reward."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["predictive_table", "reward_table"]


def predictive_table(document: dict[str, Any]) -> str:
    """Return the tip errors of each policy in each task, and what the programs cost."""
    headings = ["task", "policy", "rms [mm]", "max [mm]", "samples at a limit", "programs solved"]
    rows = []
    for row in document["rows"]:
        errors = [_text(row["rms_mm"]), _text(row["max_mm"])] if row["completed"] else ["ended early", "ended early"]
        task = CASES[row["task"]].title if row["task"] in CASES else row["task"]
        rows.append([task, row["policy"], *errors, f"{100.0 * row['at_limit']:.1f} %", str(row["programs"])])
    return (
        f"{table(headings, rows, left=2)}\n\nWith 5 kg, the payload being known, the circle takes "
        f"{document['shortest_s']:.3f} s at least. Horizon {document['horizon']} samples. "
        f"`{document['command']}`; {made_with(document)}"
    )


def reward_table(document: dict[str, Any]) -> str:
    """Return return and tip errors of classical laws before and after their tuning, beside learned policies."""
    rows = []
    for row in document["rows"]:
        radii = [radius for radius in row["spectral_radius"].values() if radius is not None]
        missing = len(radii) < len(row["spectral_radius"])
        errors = [f"{_text(rms)} / {_text(largest)}" for rms, largest in row["cases"].values()]
        worst = "no equilibrium" if missing else f"{max(radii):.3f}"
        rows.append([row["policy"], f"{row['return']:.4f}", str(row["lost"]), *errors, worst])
    names = list(document["rows"][0]["cases"])
    headings = ["policy", "return", f"ended early, of {document['rows'][0]['episodes']}"]
    headings += [f"{name}, rms / max [mm]" for name in names] + ["worst spectral radius"]
    searches = "; ".join(
        f"{name}: {found['tries']} tries, {found['simulated_s']:.0f} simulated seconds, "
        + ", ".join(f"{key} {found['shipped'][key]:.3g} → {value:.3g}" for key, value in found["numbers"].items())
        for name, found in document["searches"].items()
    )
    return (
        f"{table(headings, rows)}\n\nReturn: mean over held-out arms of the training distribution. {searches}. "
        f"`{document['command']}`; {made_with(document)}"
    )


def _text(error: float) -> str:
    return millimetres(error, "{:.2g}".format) if error < 10.0 else f"{error:.0f}"
