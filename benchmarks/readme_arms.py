"""The tables of arms that were tuned, from stored results."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["own_arm_tables", "tuned_arms_table"]


def own_arm_tables(document: dict[str, Any], arm: str = "soft") -> str:
    """Return what was chosen for an arm, its margins and its errors, as three tables."""
    row = next(one for one in document["rows"] if one["arm"] == arm)
    chosen = [[name, _decision(values), str(row["tried"][name])] for name, values in row["decisions"].items()]
    policies = list(row["spectral_radius"])
    conditions, radii = list(row["spectral_radius"][policies[0]]), [row["spectral_radius"][name] for name in policies]
    margins = [[condition, *(_radius(one[condition]) for one in radii)] for condition in conditions]
    return "\n\n".join(
        [
            table(["policy", "chosen", "candidates"], chosen, left=2),
            table(["spectral radius", *policies], margins),
            _errors(row),
            f"`{document['command']}`; {made_with(document)}",
        ]
    )


def tuned_arms_table(document: dict[str, Any]) -> str:
    """Return for each arm and policy its largest spectral radius and its tip errors."""
    rows = []
    for row in document["rows"]:
        errors = {(one["policy"], one["case"]): one for one in row["results"]}
        for policy, radii in row["spectral_radius"].items():
            unstable = [name for name, radius in radii.items() if radius is None or radius >= 1.0]
            worst = f"unstable in {len(unstable)} of {len(radii)}" if unstable else f"{max(radii.values()):.4f}"
            cases = [
                millimetres(errors[policy, case]["tip_error_max_mm"], "{:.3g}".format)
                if errors[policy, case]["completed"]
                else "ended early"
                for case in row["titles"]
            ]
            rows.append([row["arm"], policy, worst, *cases])
    headings = ["arm", "policy", "largest spectral radius of the conditions"]
    headings += [f"tip error max, {case} [mm]" for case in document["rows"][0]["titles"]]
    return f"{table(headings, rows, left=2)}\n\n`{document['command']}`; {made_with(document)}"


def _decision(values: dict[str, float | None] | None) -> str:
    if values is None:
        return "left out"
    few = list(values.items())[:4]
    text = ", ".join(f"{name} {'none' if value is None else f'{value:.3g}'}".replace("_", " ") for name, value in few)
    return text if len(few) == len(values) else f"{text}, ..."


def _radius(radius: float | None) -> str:
    return "-" if radius is None else f"{radius:.4f}{' unstable' if radius >= 1.0 else ''}"


def _errors(row: dict[str, Any]) -> str:
    policies = list(row["spectral_radius"])
    errors = {(one["policy"], one["case"]): one for one in row["results"]}
    rows = [
        [
            policy,
            *(
                millimetres(errors[policy, case][f"tip_error_{kind}_mm"], "{:.3g}".format)
                for case in row["titles"]
                for kind in _KINDS
            ),
        ]
        for policy in policies
    ]
    return table(["tip error [mm]", *(f"{title}, {kind}" for title in row["titles"].values() for kind in _KINDS)], rows)


_KINDS = ("max", "rms")
