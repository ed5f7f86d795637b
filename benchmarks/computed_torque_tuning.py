"""The bandwidth of the computed-torque policy: as high as a rule allows that considers the nominal case only.

    python benchmarks/computed_torque_tuning.py [--json FILE]

The rule and the grid are those of `fuzzyarm.eval.tuning.bandwidth`, with which `fuzzyarm tune` chooses for any arm;
here it is the arm of Table 1, with fuzzy-4 beside it and the bandwidths at which the loop becomes unstable. It takes
twenty seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import spectral_radius
from fuzzyarm.eval.tuning.bandwidth import BANDWIDTHS, LEAST_GAIN_MARGIN, assess, assess_policy, choice_of
from fuzzyarm.eval.tuning.finding import PERIOD
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy

ARM = ArmParameters()
UNSTABLE = 400.0  # rad/s, upper end of the search for the stability limit
BANDWIDTH_TOLERANCE = 0.05  # rad/s
RULE = (
    "smallest rms motor-side joint error in the nominal case among the bandwidths with an upper gain margin of at "
    f"least {LEAST_GAIN_MARGIN:g}, and with which deviations halve within the movement with one extra sample of delay, "
    "another loop gain, other stiffness or the payload"
)
COLUMNS = {
    "tip_error_max_mm": ("tip max [mm]", "{:.2f}"),
    "tip_error_rms_mm": ("rms [mm]", "{:.2f}"),
    "joint_error_rms_mrad": ("joint rms [mrad]", "{:.3f}"),
    "torque_peak_1": ("peak 1 [N m]", "{:.0f}"),
    "torque_peak_2": ("peak 2", "{:.0f}"),
    "torque_rate_rms": ("rate rms [N m/s]", "{:.0f}"),
    "radius": ("radius", "{:.4f}"),
    "radius_delayed": ("1 sample later", "{:.4f}"),
    "gain_margin_lower": ("gain margin low", "{:.2f}"),
    "gain_margin_upper": ("up", "{:.2f}"),
    "gain_margin_upper_delayed": ("up, 1 sample later", "{:.2f}"),
}
"""Heading and format of each quantity; a dash stands for a loop that is unstable already, or a run that ended early."""


def stability_limit(delay: int) -> float:
    """Return the bandwidth [rad/s] at which the spectral radius passes 1, by bisection."""
    stable, unstable = BANDWIDTHS[0], UNSTABLE
    while unstable - stable > BANDWIDTH_TOLERANCE:
        middle = 0.5 * (stable + unstable)
        policy = ComputedTorquePolicy(ARM, PERIOD, middle)
        if spectral_radius(policy, ARM, control_period=PERIOD, delay=delay) < 1.0:
            stable = middle
        else:
            unstable = middle
    return stable


def show(rows: list[dict[str, Any]], chosen: str) -> None:
    """Print the table, the chosen row marked."""
    table = Table("policy", box=None, pad_edge=False)
    for heading, _ in COLUMNS.values():
        table.add_column(heading, justify="right")
    for row in rows:
        cells = ["-" if row[key] is None else form.format(row[key]) for key, (_, form) in COLUMNS.items()]
        mark = " <- chosen" if row["policy"] == chosen else ""
        table.add_row(row["policy"] + mark, *cells)
    Console(width=None if sys.stdout.isatty() else 170).print(table)


def main() -> None:
    """Assess the grid and fuzzy-4, choose, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    rows = [assess(ARM, omega) for omega in BANDWIDTHS]
    fuzzy = assess_policy(ARM, load_policy("fuzzy-4", control_period=PERIOD, robot=ARM), "fuzzy-4")
    best, limits = choice_of(rows), [stability_limit(delay) for delay in (0, 1)]
    if best is None:
        raise SystemExit("no bandwidth of the grid has the margins that the rule asks for")
    show([*rows, fuzzy], best["policy"])
    print(f"\nRule: {RULE}.\nChosen bandwidth: {best['bandwidth']:g} rad/s")
    print(f"Unstable on the elastic arm above {limits[0]:.1f} rad/s, one sample later {limits[1]:.1f} rad/s")
    if options.json:
        document = {
            "command": "python benchmarks/computed_torque_tuning.py",
            **current_provenance(),
            "rule": RULE,
            "chosen_bandwidth": best["bandwidth"],
            "stability_limit": {"no_extra_delay": limits[0], "one_sample": limits[1]},
            "rows": [*rows, fuzzy],
        }
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
