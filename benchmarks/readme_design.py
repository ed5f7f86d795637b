"""The README's tables of designs and proofs, from stored results."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.stability.margins import margin_cells, margin_notes

__all__ = [
    "bounds_table",
    "complexity_table",
    "falsification_table",
    "feedforward_table",
    "gains_table",
    "margins_table",
    "synthesis_table",
    "tip_bound_table",
    "tip_gains_table",
    "tip_gamma_table",
]


def complexity_table(document: dict[str, Any]) -> str:
    """Return the table of controllers by number of rules: their bounds, cost and accuracy."""
    headings = ["rules", "γ at equal gain [µrad/(N m)]", "gain at equal γ [kN m/rad]", "solve + proof [s]"]
    headings += ["step [µs]", "file [kB]", "tip error max, Case 1 / 2 / 3 [mm]", "loop gain to, 1 ms later"]
    rows = [
        [
            str(row["rules"]),
            f"{1e6 * float(at_most(row['gamma'], 3)):.0f}",
            f"{1e-3 * row['gain']:.1f}",
            f"{row['synthesis_s'] + row['proof_s']:.2f}",
            f"{row['predict_us']:.1f}",
            f"{1e-3 * row['file_bytes']:.1f}",
            " / ".join(f"{row['tip_error_max_mm'][case]:.1f}" for case in PAPER_CASES),
            f"{row['gain_margin_upper_delayed']:.2f}",
        ]
        for row in document["rows"]
    ]
    return f"{table(headings, rows)}\n\n`{document['command']}`; {made_with(document)}"


def synthesis_table(document: dict[str, Any]) -> str:
    """Return the table of the sizes and times of the designs, by form and number of rules."""
    headings = [
        "form",
        "rules",
        "paper's N_var / N_row",
        "full problem",
        "reduced",
        "pair by pair: compile [s]",
        "solve [s]",
    ]
    headings += ["stacked and reduced: both [s]", "ratio", "proof [s]"]
    rows = [
        [
            row["form"],
            str(row["rules"]),
            *(f"{row[key]['variables']} / {row[key]['rows']}" for key in ("paper_formula", "full", "reduced")),
            f"{row['cvxpy_compile_s']:.2f}",
            f"{row['cvxpy_solve_s']:.2f}",
            f"{row['build_s'] + row['solve_s']:.2f}",
            f"{row['ratio']:.1f}",
            f"{row['proof_s']:.2f}",
        ]
        for row in document["rows"]
    ]
    return (
        f"{table(headings, rows)}\n\nVariables / rows of the cones; one thread; the paper's formula is that of its "
        f"Table 2. `{document['command']}`; {made_with(document)}"
    )


def bounds_table(document: dict[str, Any]) -> str:
    """Return the table of certified bounds and observed values."""
    headings = [
        "policy",
        "α certified [1/s]",
        "slowest decay observed",
        "γ certified [rad/(N m)]",
        "largest L2 gain observed",
    ]
    rows = []
    for name, bound in document["bounds"].items():
        decay, gain = bound["decay_per_s"], bound["gain_rad_per_Nm"]
        observed = f"{gain['observed']:.2e} ({gain['observed'] / gain['certified']:.0%})"
        alpha, gamma = at_least(decay["certified"], 6), f"{float(at_most(gain['certified'], 3)):.2e}"
        rows.append([name, alpha, f"{decay['observed']:.1f}", gamma, observed])
    return (
        f"{table(headings, rows)}\n\nOn the rigid arm in continuous time, which is what the certificates are about: "
        "the slowest decay of V and the largest gain over a library of disturbances and the worst found by search. "
        f"`{document['command']}`; {made_with(document)}"
    )


def tip_bound_table(document: dict[str, Any]) -> str:
    """Return the table of proven bounds of the tip error."""
    headings = ["policy", "case", "set", "motion", "proven [mm]", "simulated [mm]", "largest ratio", "proof [s]"]
    rows = []
    for row in document["rows"]:
        plants = row["set"] if row.get("cells", 1) == 1 else f"{row['set']}, in {row['cells']} cells"
        named = [row["policy"], row["case"], plants, f"{row['path']}, {row['duration']:g} s"]
        if row["proven"]:
            ratio = "" if row["largest_ratio"] is None else at_least(row["largest_ratio"], 4)
            found = [at_most(row["bound_mm"], 4), f"{row['simulated_mm']:.4g}", ratio, f"{row['cpu_seconds']:.0f}"]
        else:
            found = ["none", "", "", ""]
        rows.append([*named, *found])
    return (
        f"{table(headings, rows, left=4)}\n\nThe largest tip error at any sample: proven for every plant of the set, "
        f"and the largest of the simulated ones (one plant for `table-1`, integrated event by event; else "
        f"{document['plants']} of each set, half at its corners); the largest ratio of an error to the bound at the "
        f"same sample. Time on one core. `{document['command']}`; {made_with(document)}"
    )


def feedforward_table(document: dict[str, Any]) -> str:
    """Return the table of the paper's form over L, and which member comes nearest to the paper's numbers."""
    cases = {"nominal": "Case 1", "machining": "Case 2", "payload": "Case 3"}
    words = {"paper": "the paper's", "solver": "the solver's"}
    headings = ["rules", "L", "largest gain [kN m/rad]", *(f"{c}, {s} [mm]" for c in cases.values() for s in _SIDES)]
    rows = []
    for row in document["rows"]:
        ends = [[f"{x:.2f}" for x in row[case][side]] for case in cases for side in _SIDES]
        named = [str(row["rules"]), words.get(row["L"], row["L"]), f"{1e-3 * row['position_gain']:.1f}"]
        rows.append([*named, *(" to ".join(pair) for pair in ends)])
    nearest = " and ".join(
        f"at the {side} {best['rules']} rules and {words.get(best['L'], best['L'])}"
        for side, best in document["nearest"].items()
    )
    return (
        f"{table(headings, rows, left=2)}\n\nCircularity errors with L as a share of the consistent form's; all are "
        f"proven at γ = {document['gamma']:g}. Nearest to the paper's 1.3 mm and -2.3 to 4.4 mm are {nearest}. "
        f"`{document['command']}`; {made_with(document)}"
    )


_SIDES = ("tip", "motors")


def tip_gamma_table(document: dict[str, Any]) -> str:
    """Return the table of proven bounds of the tip error against γ of the design."""
    rows = [
        [f"{row['gamma']:.1e}", row["reason"] if row["bound_mm"] is None else at_most(row["bound_mm"], 4)]
        for row in document["rows"]
    ]
    return (
        f"{table(['γ [rad/(N m)]', 'proven [mm]'], rows, left=0)}\n\nSet: stiffness ± 10 %; fastest pole "
        f"{document['fastest_pole']:g} 1/s. `{document['command']}`; {made_with(document)}"
    )


def tip_gains_table(document: dict[str, Any]) -> str:
    """Return the table of gains that were found at vertices of the sampled elastic arm, and of arms of one's own."""
    sets = list(document["rows"][0]["bounds_mm"])
    headings = ["gains", "float part [mm]", "motors' rms, nominal [mrad]", "slowest rigid pole [1/s]"]
    headings += [f"proven, {name} [mm]" for name in sets]
    rows = [
        [
            row["gains"],
            at_most(row["linear_mm"], 3),
            f"{row['case_1_joint_error_rms_mrad']:.3f}",
            f"{row['slowest_rigid_pole']:.1f}",
            *(bound if isinstance(bound, str) else at_most(bound, 4) for bound in row["bounds_mm"].values()),
        ]
        for row in document["rows"]
    ]
    arms = ", ".join(
        f"{row['arm']} with {'no bound of the' if row['fastest_pole'] is None else 'a'} fastest pole"
        f"{'' if row['fastest_pole'] is None else ' of ' + format(row['fastest_pole'], 'g') + ' 1/s'} "
        f"{at_most(row['bounds_mm']['near'], 5)} mm"
        for row in document["arms"]
    )
    return (
        f"{table(headings, rows)}\n\nSet `near` for the [arms that were tuned](../controllers/tune.md): {arms}. "
        f"`{document['command']}`; {made_with(document)}"
    )


def falsification_table(document: dict[str, Any]) -> str:
    """Return the table of the plants that were bred to exceed a bound."""
    rows = []
    for row in document["rows"]:
        found = row["by_generation"][0], row["largest_ratio"], row["event_by_event"]
        ratios = ["" if ratio is None else at_least(ratio, 4) for ratio in found]
        rows.append([row["policy"], row["case"], row["set"], str(row["plants"]), *ratios])
    headings = ["policy", "case", "set", "plants", "largest ratio, random", "bred", "the worst, event by event"]
    return (
        f"{table(headings, rows, left=3)}\n\nLargest ratio of a tip error to the bound at the same sample, where the "
        f"bound is above 1 µm. `{document['command']}`; {made_with(document)}"
    )


def gains_table(document: dict[str, Any]) -> str:
    """Return the table of 4-rule designs, without a bound of the fastest pole and with the chosen bound."""
    chosen = document["chosen"][0]
    columns = {
        "largest_gain": ("largest gain [kN m/rad]", "{:.1f}"),
        "fastest_rigid_pole": ("fastest rigid pole [1/s]", "{:.0f}"),
        "radius": ("radius", "{:.4f}"),
        "radius_2_samples_later": ("2 samples later", "{:.4f}"),
        "radius_worst_condition": ("worst condition", "{:.5f}"),
        "gain_margin_upper": ("loop gain to", "{:.2f}"),
        "gain_margin_upper_1_sample_later": ("to, 1 sample later", "{:.2f}"),
        "tip_deviation_mm": ("tip, any friction [mm]", "{:.3f}"),
        "case_1_joint_error_rms_mrad": ("motors' rms, Case 1 [mrad]", "{:.3f}"),
        "case_2_joint_error_rms_mrad": ("Case 2", "{:.3f}"),
    }
    shown = [row for row in document["rows"] if row["rules"] == 4 and 1e-4 <= row["gamma"] <= 2.5e-4]
    rows = []
    for row in (row for row in shown if row["fastest_pole"] in (None, chosen["fastest_pole"])):
        bound = "none" if row["fastest_pole"] is None else at_most(row["fastest_pole"], 6)
        mark = " (shipped)" if all(row[key] == chosen[key] for key in ("gamma", "fastest_pole")) else ""
        values = {**row, "largest_gain": 1e-3 * row["largest_gain"]}
        gamma = f"{float(at_most(row['gamma'], 2)):.1e}"
        rows.append([bound + mark, gamma, *(form.format(values[key]) for key, (_, form) in columns.items())])
    headings = ["bound [1/s]", "γ [rad/(N m)]", *(heading for heading, _ in columns.values())]
    return f"{table(headings, rows)}\n\n`{document['command']}` (its JSON has the whole grid); {made_with(document)}"


def margins_table(document: dict[str, Any], tuning: dict[str, Any]) -> str:
    """Return the table of stability margins, and the limits of computed torque found in its tuning."""
    headings, cells = margin_cells(document["rows"])
    limit, delayed = tuning["stability_limit"]["no_extra_delay"], tuning["stability_limit"]["one_sample"]
    return (
        f"{table(headings, cells)}\n\n{' '.join(margin_notes(document)[:2])} `{document['command']}`; "
        f"{made_with(document)}\n\nComputed torque becomes unstable at {limit:.0f} rad/s, at {delayed:.0f} rad/s with "
        f"1 ms of extra delay. `{tuning['command']}`; {made_with(tuning)}"
    )
