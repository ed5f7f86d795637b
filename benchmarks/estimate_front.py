"""The front between accuracy and margin of `learned-observer`: trainings with other weights of the loss of eigenvalues.

    for seed in 0 1 2 3 4; do fuzzyarm train estimate --seed $seed --stability 1 --out runs/front-$seed; done
    python benchmarks/estimate_front.py runs/front-*/policy benchmarks/estimates/* [--json FILE]

Folders are grouped by their weight; those in the repository have the default. Of every training: tip errors in the
paper's three cases, on time and with torques half a sample late, and the spectral radius in every condition of
`fuzzyarm margins`. Of the median seed of each weight, by the rms errors of Cases 2 and 3, and of `elastic-observer`:
largest tip errors over the first held-out plants of `all`, with noise and late commands.
"""

from __future__ import annotations

import argparse
import json
from itertools import groupby
from pathlib import Path
from typing import Any

from learned_observer import BASE, QUANTILES, SEED, assess, held_out, stable
from ppo_observer import in_cases
from rich.console import Console
from rich.table import Table

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance


def weight_of(row: dict[str, Any]) -> float:
    """Return the weight of the loss of eigenvalues that a row was trained with."""
    return float(row["training"]["stability"])


def both_cases(row: dict[str, Any]) -> float:
    """Return the sum of the rms errors of Cases 2 and 3 [mm]."""
    return float(row["cases"]["machining_rms_mm"] + row["cases"]["payload_rms_mm"])


def trained_with(weight: float, rows: list[dict[str, Any]], plants: int) -> dict[str, Any]:
    """Return what the table says of the trainings with a weight, the median seed's plants included."""
    ranked = sorted(rows, key=both_cases)
    median = ranked[(len(ranked) - 1) // 2]
    policies = {BASE: load_policy(BASE), "median": load_policy(median["folder"])}
    kept = "seed", "cases", "late", "margins"
    return {
        "stability": weight,
        "median": median["seed"],
        "stable": [row["seed"] for row in rows if stable(row)],
        "seeds": [{key: row[key] for key in kept} | {"cpu_time_s": row["training"]["cpu_time_s"]} for row in rows],
        "held_out": held_out(policies, "all", plants),
    }


def print_document(document: dict[str, Any], console: Console) -> None:
    """Print a row for each training, and the plants."""
    table = Table(
        "weight",
        "seed",
        "Case 2 rms / max, mm",
        "Case 3 rms / max, mm",
        "largest radius",
        "CPU, s",
    )
    for front in document["weights"]:
        for row in front["seeds"]:
            cases, radii = row["cases"], row["margins"]["spectral_radius"].values()
            table.add_row(
                f"{front['stability']:g}",
                str(row["seed"]),
                *(
                    f"{cases[f'{case}_rms_mm']:.3f} / {cases[f'{case}_max_mm']:.2f}"
                    for case in ("machining", "payload")
                ),
                "-" if None in radii else f"{max(radii):.3f}",
                f"{row['cpu_time_s']:.0f}",
            )
    console.print(table)
    table = Table("weight", "policy, case", *(f"{100 * q:g} %" for q in QUANTILES), "lost")
    for front in document["weights"]:
        for name, row in front["held_out"]["rows"].items():
            cells = (f"{value:.2f}" for value in row["quantiles_mm"])
            table.add_row(f"{front['stability']:g}", name, *cells, str(row["lost"]))
    console.print("largest tip error, mm", table)


def main() -> None:
    """Measure, print, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--plants", type=int, default=250)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows = [
        assess(folder) | {"folder": folder, "late": in_cases(load_policy(folder), late=True)}
        for folder in arguments.folders
    ]
    rows.sort(key=lambda row: (weight_of(row), row["seed"]))
    document = {
        "schema": "fuzzyarm-estimate-front/1",
        **current_provenance(),
        "quantiles": list(QUANTILES),
        "first_held_out_seed": SEED,
        "weights": [
            trained_with(weight, list(group), arguments.plants) for weight, group in groupby(rows, key=weight_of)
        ],
    }
    if arguments.json:
        write_atomically(arguments.json, json.dumps(document, indent=1) + "\n")
    print_document(document, Console(width=160))


if __name__ == "__main__":
    main()
