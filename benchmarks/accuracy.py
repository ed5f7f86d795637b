"""Accuracy of the time step: largest tip difference to the event integrator over 1.5 s, for several sub-steps.

    python benchmarks/accuracy.py [--json FILE]

Computed torque closes the loop at 1 kHz in each of the three cases. About a minute.
"""

from __future__ import annotations

from measuring import options_of, write

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.bench._accuracy import exact_tips, max_tip_difference, stepped_tips

SUBSTEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5)


def main() -> None:
    """Measure, print and optionally write."""
    options = options_of(__doc__).parse_args()
    policy, result = load_policy("computed-torque"), {}
    for case in PAPER_CASES:
        exact = exact_tips(policy, case)
        result[case] = {f"{h:g}": 1e6 * max_tip_difference(stepped_tips(policy, case, h), exact) for h in SUBSTEPS}
        cells = "  ".join(f"h = {h} s: {error:8.4f} µm" for h, error in result[case].items())
        print(f"{case:10}  {cells}", flush=True)
    write(options.json, "accuracy.py", max_tip_difference_um=result)


if __name__ == "__main__":
    main()
