"""How large the gains of the shipped controllers should be: a grid over γ and the bound of the fastest pole.

    python benchmarks/gain_choice.py [--json FILE]

The rule, the grid and the conditions are those of `fuzzyarm.eval.tuning.fuzzy_gains`, with which `fuzzyarm tune`
chooses for any arm; here it is the arm of Table 1 at α = 20 1/s. Case 2 is measured for the record. Models with z1 kept
are alike: what is chosen for 4 rules is taken for 8, 16 and 32. With z1 dropped a bound of the fastest pole is
infeasible below about 800 1/s, and no design of the grid bears all this; 2 and 1 rules are shipped at gamma = 2e-4, for
comparison. Designs with motor errors within 1 % of the smallest are equally good, and the float part of the tip's bound
decides between them; what it would decide with a larger share is printed and stored as well. A minute.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.tuning.fuzzy_gains import ALPHAS, assess, choice_of, points_of

RULES = (4, 2, 1)
SHARES = (0.01, 0.05, 0.1)
"""By which motor errors may be larger than the smallest, for designs to count as equally good."""
CASES = {"case_1": "nominal", "case_2": "machining"}


def main() -> None:
    """Assess the grid, choose for each number of rules, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    chosen, rows, wider = [], [], []
    for rules in RULES:
        for point in points_of(ArmParameters(), rules, ALPHAS[0]):
            row = assess(ArmParameters(), point, rules, CASES)
            if row is None:
                print(
                    f"rules = {rules}  gamma = {point.gamma:g}  fastest_pole = {point.fastest_pole}  infeasible",
                    flush=True,
                )
                continue
            rows.append(row)
            print("  ".join(f"{k} = {v:.5g}" if isinstance(v, float) else f"{k} = {v}" for k, v in row.items()))
        best = choice_of([row for row in rows if row["rules"] == rules])
        if best is None:
            print(f"no design for {rules} rules bears all that is asked", flush=True)
            continue
        chosen.append(_point(best))
        pole = "none" if best["fastest_pole"] is None else f"{best['fastest_pole']:g} 1/s"
        print(f"chosen for {rules} rules: gamma = {best['gamma']:g} rad/(N m), fastest pole {pole}", flush=True)
        for share in SHARES:
            other = choice_of([row for row in rows if row["rules"] == rules], share)
            wider.append({"share": share, **_point(other)})
            print(wider[-1])
    if options.json:
        document = {
            "command": "python benchmarks/gain_choice.py",
            **current_provenance(),
            "chosen": chosen,
            "by_share": wider,
            "rows": rows,
        }
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


def _point(row: dict[str, Any] | None) -> dict[str, Any]:
    """Return the point of the grid that a row is of."""
    assert row is not None
    return {name: row[name] for name in ("rules", "gamma", "fastest_pole")}


if __name__ == "__main__":
    main()
