"""Tables of designs, proofs and margins."""

from __future__ import annotations

from typing import Any

from tables import Cell, Section, Table, made_with, markdown

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.eval.stability.margins import margin_cells, margin_notes

__all__ = ["PROOFS"]


def _size(key: str) -> Cell:
    return f"{{{key}[variables]}} / {{{key}[rows]}}"


def _gain(row: dict[str, Any]) -> str:
    gain = row["gain_rad_per_Nm"]
    return f"{gain['observed']:.2e} ({gain['observed'] / gain['certified']:.0%})"


def _plants_of_bound(row: dict[str, Any]) -> str:
    return row["set"] if row.get("cells", 1) == 1 else f"{row['set']}, in {row['cells']} cells"


def _if_proven(cell: Cell, otherwise: str = "") -> Cell:
    """Return the cell of what a row has only if its bound is proven."""
    return lambda row: otherwise if not row["proven"] else cell.format(**row) if isinstance(cell, str) else cell(row)


def _ratio(value: float | None) -> str:
    return "" if value is None else at_least(value, 4)


def _margins(document: dict[str, Any], tuning: dict[str, Any]) -> str:
    """Return the table of stability margins, and the limits of computed torque found in its tuning."""
    limit, delayed = tuning["stability_limit"]["no_extra_delay"], tuning["stability_limit"]["one_sample"]
    return (
        f"{markdown(*margin_cells(document['rows']))}\n\n{' '.join(margin_notes(document)[:2])} "
        f"`{document['command']}`; {made_with(document)}\n\nComputed torque becomes unstable at {limit:.0f} rad/s, at "
        f"{delayed:.0f} rad/s with 1 ms of extra delay. `{tuning['command']}`; {made_with(tuning)}"
    )


PROOFS = {
    "margins": Section(("margins", "computed_torque_tuning"), _margins, None),
    "synthesis": Section(
        "synthesis",
        Table(
            {
                "form": "{form}",
                "rules": "{rules}",
                "paper's N_var / N_row": _size("paper_formula"),
                "full problem": _size("full"),
                "reduced": _size("reduced"),
                "pair by pair: compile [s]": "{cvxpy_compile_s:.2f}",
                "solve [s]": "{cvxpy_solve_s:.2f}",
                "stacked and reduced: both [s]": lambda row: f"{row['build_s'] + row['solve_s']:.2f}",
                "ratio": "{ratio:.1f}",
                "proof [s]": "{proof_s:.2f}",
            }
        ),
        "Variables / rows of the cones; one thread; the paper's formula is that of its Table 2. `{command}`",
    ),
    "bounds": Section(
        "certified_bounds",
        Table(
            {
                "policy": "{policy}",
                "α certified [1/s]": lambda row: at_least(row["decay_per_s"]["certified"], 6),
                "slowest decay observed": "{decay_per_s[observed]:.1f}",
                "γ certified [rad/(N m)]": lambda row: f"{float(at_most(row['gain_rad_per_Nm']['certified'], 3)):.2e}",
                "largest L2 gain observed": _gain,
                "stays in the box: start [rad]": lambda row: at_least(row["invariant_set"]["start_rad"], 3),
                "with \\|d\\| up to [N m]": lambda row: at_least(row["invariant_set"]["disturbance_Nm"], 3),
            },
            lambda document: [{"policy": name, **bound} for name, bound in document["bounds"].items()],
        ),
        "On the rigid arm in continuous time: slowest decay of V, and largest gain over a library of disturbances and "
        "the worst found by search; start at rest and |d| up to which the box is not left on the circle. `{command}`",
    ),
    "tip-bound": Section(
        "tip_bound",
        Table(
            {
                "policy": "{policy}",
                "case": "{case}",
                "set": _plants_of_bound,
                "motion": lambda row: f"{row['path']}, {row['duration']:g} s{', for ever' * (row['laps'] == 'ever')}",
                "proven [mm]": _if_proven(lambda row: at_most(row["bound_mm"], 4), "none"),
                "simulated [mm]": _if_proven("{simulated_mm:.4g}"),
                "largest ratio": _if_proven(lambda row: _ratio(row["largest_ratio"])),
                "proof [s]": _if_proven("{cpu_seconds:.0f}"),
            },
            left=4,
        ),
        "The largest tip error at any instant: proven for every plant of the set, in every lap where the motion is for "
        "ever, and the largest of the simulated ones "
        "(one plant for `table-1`, integrated event by event; else {plants} of each set, half at its corners); the "
        "largest ratio of an error to the bound at the same sample. Time on one core. `{command}`",
    ),
    "shields": Section(
        "tip_bound",
        Table(
            {
                "law": lambda row: f"`{row['policy'].split(':')[1]}`",
                "margin [N m]": lambda row: row["policy"].rpartition(":")[2].replace(",", ", "),
                "set": _plants_of_bound,
                "proven for every guest [mm]": _if_proven(lambda row: at_most(row["bound_mm"], 3), "none"),
                "worst guest that switches [mm]": _if_proven("{simulated_mm:.3g}"),
            },
            lambda document: [row for row in document["rows"] if row["policy"].startswith("shield:")],
        ),
        "Nominal case: the proven bound on the tip error, and the largest tip error with {plants} guests, "
        "each on a plant of the set, that switch between the ends of the margin. `{command}`",
    ),
    "tip-falsification": Section(
        "tip_falsification",
        Table(
            {
                "policy": "{policy}",
                "case": "{case}",
                "set": "{set}",
                "plants": "{plants}",
                "largest ratio, random": lambda row: _ratio(row["by_generation"][0]),
                "bred": lambda row: _ratio(row["largest_ratio"]),
                "the worst, event by event": lambda row: _ratio(row["event_by_event"]),
            },
            left=3,
        ),
        "Largest ratio of a tip error to the bound at the same sample, where the bound is above 1 µm. `{command}`",
    ),
}
"""Sections by name."""
