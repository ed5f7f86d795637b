"""The tables of the learned estimate: errors and margins of the seeds, quantiles over plants, and the front of both."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["estimate_front", "estimate_tables"]

_CASES = {"nominal": "Case 1", "machining": "Case 2", "payload": "Case 3"}


def estimate_tables(document: dict[str, Any]) -> str:
    """Return the table of the seeds, those of the plants, and the line that says how they were made."""
    plants = "\n\n".join(
        f"Largest tip errors [mm] over {part['plants']} plants of `{name.partition(',')[0]}`:\n\n"
        f"{_plants(part, document['quantiles'])}"
        for name, part in document["held_out"].items()
    )
    stable = document["stable_in_every_condition"]
    return (
        f"{_seeds(document)}\n\nShipped: seed {document['median']}. Stable in every condition: "
        f"{', '.join(map(str, stable)) or 'none'} of the five.\n\n{plants}\n\n"
        f"`python benchmarks/learned_observer.py`, trained by `fuzzyarm train estimate --seed 0` to `4` on the same "
        f"machine, shared with other work; plants from seed {document['first_held_out_seed']} on; {made_with(document)}"
    )


def estimate_front(document: dict[str, Any]) -> str:
    """Return the table of the trainings by their weight of the eigenvalues, and the line that says how it was made."""
    loads = ("machining", "payload")
    headings = ["weight", "seeds", "Case 2, rms [mm]", "Case 3, rms [mm]", "stable in every condition"]
    headings += [f"half a sample late: {what}" for what in ("Case 2 [mm]", "Case 3 [mm]", "torque rate [N m/ms]")]
    headings += [f"{case} of `all`, 50 % / 99 % [mm]" for case in list(_CASES.values())[1:]]
    share, rows = document["quantiles"], []
    for front in document["weights"]:
        seeds = front["seeds"]
        errors = [[row["cases"][f"{case}_rms_mm"] for row in seeds] for case in loads]
        late = [[row["late"][case]["rms_mm"] for row in seeds] for case in loads]
        rates = [max(row["late"][case]["torque_rate"] for case in loads) for row in seeds]
        plants = [front["held_out"]["rows"][f"median, {case}"]["quantiles_mm"] for case in loads]
        rows.append(
            [
                f"{front['stability']:g}",
                ", ".join(str(row["seed"]) for row in seeds),
                *(f"{min(values):.2f} to {max(values):.2f}" for values in errors),
                f"{len(front['stable'])} of {len(seeds)}",
                *(f"{min(values):.2f} to {max(values):.2f}" for values in late),
                f"{min(rates):.1f} to {max(rates):.1f}",
                *(f"{values[share.index(0.5)]:.1f} / {values[share.index(0.99)]:.1f}" for values in plants),
            ]
        )
    number = document["weights"][0]["held_out"]["plants"]
    return (
        f"{table(headings, rows)}\n\n`python benchmarks/estimate_front.py`, the last columns over {number} plants "
        f"under the median seed, from seed {document['first_held_out_seed']} on; {made_with(document)}"
    )


def _seeds(document: dict[str, Any]) -> str:
    conditions = list(document["seeds"][0]["margins"]["spectral_radius"])
    headings = ["seed", *(f"{name}, rms / max [mm]" for name in _CASES.values()), *conditions, "processor time [s]"]
    rows = []
    for row in document["seeds"]:
        cases, radius = row["cases"], row["margins"]["spectral_radius"]
        rows.append(
            [
                str(row["seed"]),
                *(f"{cases[f'{name}_rms_mm']:.4f} / {cases[f'{name}_max_mm']:.3f}" for name in _CASES),
                *("-" if radius[name] is None else f"{radius[name]:.4f}" for name in conditions),
                f"{row['training']['cpu_time_s']:.0f}",
            ]
        )
    return table(headings, rows)


def _plants(part: dict[str, Any], quantiles: list[float]) -> str:
    headings = ["policy", "case", *(f"{100 * share:g} %" for share in quantiles), "lost", "better than base [%]"]
    rows = []
    for name, row in part["rows"].items():
        policy, _, case = name.partition(", ")
        low, high = row["interval_95"]
        better = f"{100 * row['better_than_base']:.1f} ({100 * low:.1f} to {100 * high:.1f})"
        rows.append(
            [
                f"`{policy}`",
                _CASES[case],
                *(f"{value:.2f}" for value in row["quantiles_mm"]),
                str(row["lost"]),
                "" if policy == "elastic-observer" else better,
            ]
        )
    return table(headings, rows, left=2)
