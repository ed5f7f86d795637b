"""Design every shipped controller file anew.

python benchmarks/shipped_controllers.py [FOLDER]

The consistent form with integral for 32 to 1 rules (alpha = 20, gamma = 2e-4 rad/(N m), smallest gains), and witnesses of
the paper's own form (Theorem 2; Theorem 1 for 32 rules) at alpha = 20, gamma = 1000 and the paper's Q: for 4, 2 and 1 rules
with and without integral, with one multiplier for all dropped premises of A as printed and with one for each. Each file
is proven before it is written. A minute.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import fuzzyarm.fuzzy_policy.controllers
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.synthesis.design import Specification, design


def specifications() -> dict[str, Specification]:
    """Return the specification of each file by its name."""
    result = {f"fuzzy-{rules}": Specification(kept=kept) for rules, kept in NAMED_RULES.items()}
    for rules, integral, common in itertools.product((4, 2, 1), (False, True), (False, True)):
        name = f"paper-{rules}" + "-integral" * integral + "-common" * common
        result[name] = Specification(
            NAMED_RULES[rules], "paper", gamma=1000.0, integral=integral, common_multiplier=common
        )
    result["paper-32-integral"] = Specification(NAMED_RULES[32], "paper", gamma=1000.0)
    return result


def main() -> None:
    """Design, prove and write."""
    default = Path(fuzzyarm.fuzzy_policy.controllers.__file__).parent
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    for name, specification in specifications().items():
        made = design(specification)
        made.controller.save(folder / f"{name}.json")
        print(f"{name:24} solved in {made.solve_seconds:6.2f} s, proven in {made.proof_seconds:5.2f} s", flush=True)


if __name__ == "__main__":
    main()
