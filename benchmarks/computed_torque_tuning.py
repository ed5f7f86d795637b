"""The bandwidth of the computed-torque policy: as high as a rule allows that considers the nominal case only.

    python benchmarks/computed_torque_tuning.py [--json FILE]

Rule: the smallest rms motor-side joint error in the nominal case among the bandwidths 20, 25, ..., 160 rad/s whose
upper gain margin on the sampled elastic arm is at least 2 (6 dB) and which stay stable with one extra sample of delay.
The motor side counts because a controller of this kind measures only the motors; the margins are those of
`fuzzyarm.eval.stability.linearisation`. The error includes the start: the motors begin at their static deflection, 1 to
2 mrad from the reference. A rollout alone does not show that a loop is unstable: the torque limits keep it in a small
limit cycle, and the episode ends regularly. It takes ten seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import gain_margin, spectral_radius
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.policy import Predictor

ARM = ArmParameters()
PERIOD = 1e-3  # s
BANDWIDTHS = [float(omega) for omega in range(20, 161, 5)]  # rad/s
LEAST_GAIN_MARGIN = 2.0
UNSTABLE = 400.0  # rad/s, upper end of the search for the stability limit
BANDWIDTH_TOLERANCE = 0.05  # rad/s
RULE = (
    "smallest rms motor-side joint error in the nominal case among the bandwidths with an upper gain margin of at "
    f"least {LEAST_GAIN_MARGIN:g} and stability with one extra sample of delay"
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


def assess(policy: Predictor, name: str) -> dict[str, Any]:
    """Return one row: the nominal rollout and the margins; None for what an unstable loop does not have."""
    run = record_rollout(FuzzyArmEnv("nominal"), policy, policy_name=name, case="nominal", seed=0)
    measured = metrics_of(run) if run.completed else {}
    lower, upper = gain_margin(policy, ARM, control_period=PERIOD)
    row = {
        **measured,
        "radius": spectral_radius(policy, ARM, control_period=PERIOD),
        "radius_delayed": spectral_radius(policy, ARM, control_period=PERIOD, delay=1),
        "gain_margin_lower": lower,
        "gain_margin_upper": upper,
        "gain_margin_upper_delayed": gain_margin(policy, ARM, control_period=PERIOD, delay=1)[1],
    }
    values = {key: row.get(key, math.nan) for key in COLUMNS}
    return {"policy": name} | {key: value if math.isfinite(value) else None for key, value in values.items()}


def choose(rows: dict[float, dict[str, Any]]) -> float:
    """Return the bandwidth [rad/s] the rule picks; ValueError if none qualifies."""
    eligible = [
        omega
        for omega, row in rows.items()
        if row["joint_error_rms_mrad"] is not None
        and row["gain_margin_upper"] is not None
        and row["gain_margin_upper"] >= LEAST_GAIN_MARGIN
        and row["radius_delayed"] < 1.0
    ]
    if not eligible:
        raise ValueError("no bandwidth of the grid has the margins the rule asks for: extend BANDWIDTHS downwards")
    return min(eligible, key=lambda omega: float(rows[omega]["joint_error_rms_mrad"]))


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
    rows = {omega: assess(ComputedTorquePolicy(ARM, PERIOD, omega), f"{omega:g} rad/s") for omega in BANDWIDTHS}
    fuzzy = assess(load_policy("fuzzy-4", control_period=PERIOD, robot=ARM), "fuzzy-4")
    chosen, limits = choose(rows), [stability_limit(delay) for delay in (0, 1)]
    show([*rows.values(), fuzzy], f"{chosen:g} rad/s")
    print(f"\nRule: {RULE}.\nChosen bandwidth: {chosen:g} rad/s")
    print(f"Unstable on the elastic arm above {limits[0]:.1f} rad/s, one sample later {limits[1]:.1f} rad/s")
    if options.json:
        document = {
            "command": "python benchmarks/computed_torque_tuning.py",
            **current_provenance(),
            "rule": RULE,
            "chosen_bandwidth": chosen,
            "stability_limit": {"no_extra_delay": limits[0], "one_sample": limits[1]},
            "rows": [{"bandwidth": omega} | row for omega, row in rows.items()] + [fuzzy],
        }
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
