"""The proven bound of the tip error against γ of the design, for `fuzzy-4-tip` with joints of stiffness ± 10 %.

    python benchmarks/tip_gamma.py [--json FILE]

For each γ of the grid 4 rules are designed as the shipped ones, with their bound of the fastest pole; the bound is that
of `fuzzyarm prove`, on the paper's circle. Three minutes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.synthesis import DesignFailed, Specification, design

COMMAND = "python benchmarks/tip_gamma.py"
GAMMAS = (1e-4, 1.2e-4, 1.4e-4, 1.7e-4, 2e-4, 3e-4)  # rad/(N m)
FASTEST_POLE = 200.0  # 1/s
PLANTS = PlantSet(stiffness=(0.9, 1.1))


def bounded(gamma: float, folder: Path) -> dict[str, Any]:
    """Return the row of a γ: the bound [mm], or why there is none."""
    try:
        controller = design(Specification(gamma=gamma, fastest_pole=FASTEST_POLE)).controller
    except DesignFailed:
        return {"gamma": gamma, "bound_mm": None, "reason": "no design"}
    controller.save(folder / "design.json")
    claim = TipClaim(f"{folder / 'design.json'}-tip", "nominal", "stiffness +-10 %", PLANTS)
    try:
        return {"gamma": gamma, "bound_mm": 1e3 * find_bound(claim).largest, "reason": ""}
    except NoBound as error:
        return {"gamma": gamma, "bound_mm": None, "reason": str(error).rsplit(": ", 1)[-1]}


def main() -> None:
    """Bound the grid, print a line for each and optionally write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        for gamma in GAMMAS:
            rows.append(bounded(gamma, Path(name)))
            print(json.dumps(rows[-1]), flush=True)
    if options.json:
        document = {"command": COMMAND, "fastest_pole": FASTEST_POLE, "rows": rows, **current_provenance()}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
