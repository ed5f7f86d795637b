"""Cost and benefit of fewer rules: the consistent form with integral for 1 to 32 rules, at equal gain and at equal γ.

    python benchmarks/complexity.py [--json FILE]

All models are designed for the smallest gains at the same α and γ, without a bound of the fastest pole, which models
without z1 do not bear (so these are not the shipped files). Proof: the scaled gain that each meets; and the other way
round the smallest γ under one bound of the scaled gains, 1.2 times what the 4-rule controller meets. (The bound enters
a design by a sufficient condition; the gains met stay 5 to 10 % below.) Cost: synthesis (solve and exact proof), one
call of `predict`, the file. Arm: tip error in the three cases and distance from instability. Each time is the median of
five rounds over all models; for `predict` each round has three episodes of each policy, computed torque among them as a
peer. Four minutes, half of it the search for the smallest γ with 32 rules.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from rich.console import Console
from rich.table import Table

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import gain_margin, spectral_radius
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.policies import resolve
from fuzzyarm.synthesis import Design, Specification, design
from fuzzyarm.synthesis.search import scaled_gain

COMMAND = "python benchmarks/complexity.py"
RULES = tuple(sorted(NAMED_RULES))
COMMON = Specification()
"""What every model is designed for, but for the premises kept."""
COMMON_RULES = 4
GAIN_ROOM = 1.2  # the common gain bound over the gain that the controller of `COMMON_RULES` meets
ROUNDS = 5
PERIOD = 1e-3  # s
PEER = "computed-torque"

LEFT, WITHOUT_Z1, RIGHT = 2**-0.8, 2**1.5, 2**5.6  # of the figure: its ends and the end of the models without z1
SMALL: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8, "color": "#333333", "ha": "center"}

Row = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A line of the table, and a panel of the figure.

    Attributes:
        name: what it is called.
        unit: of what is shown, empty for a pure number.
        value: where it is in a row.
        form: format of its value.
        axis: what its vertical axis is called.
        log: whether that axis is logarithmic; else it begins at zero.
        beside: where values are written beside their points, (right, up) [1/72 inch].
    """

    name: str
    unit: str
    value: Callable[[Row], float]
    form: str
    axis: str = ""
    log: bool = False
    beside: tuple[float, float] = (0.0, 6.0)


def _tip_error(kind: str, case: str) -> Quantity:
    return Quantity(f"tip error {kind}, {case}", "mm", lambda r: float(r[f"tip_error_{kind}_mm"][case]), "{:.2f}")


GAMMA = Quantity(
    "smallest proven γ at equal gain", "µrad/(N m)", lambda r: 1e6 * r["gamma"], "{:.0f}", "γ", beside=(8, 5)
)
GAIN = Quantity("gain at equal γ", "kN m/rad", lambda r: 1e-3 * r["gain"], "{:.1f}", "scaled gain", beside=(6, 5))
SYNTHESIS = Quantity(
    "synthesis: solve + proof", "s", lambda r: r["synthesis_s"], "{:#.2g}", "time", log=True, beside=(-10, 4)
)
PREDICT = Quantity("control law, one step", "µs", lambda r: r["predict_us"], "{:.2f}", "time")
FILE = Quantity("controller file", "kB", lambda r: 1e-3 * r["file_bytes"], "{:.1f}", "size", log=True, beside=(-10, 4))
TIP_MAX, TIP_RMS = ({case: _tip_error(kind, case) for case in PAPER_CASES} for kind in ("max", "rms"))
PANELS = (GAMMA, GAIN, SYNTHESIS, PREDICT, FILE)
LINES = (
    GAMMA,
    Quantity("  gain met there", "kN m/rad", lambda r: 1e-3 * r["gain_at_gamma"], "{:.1f}"),
    GAIN,
    Quantity("variables of the cone program", "", lambda r: r["variables"], "{:.0f}"),
    SYNTHESIS,
    Quantity("  of it proof", "s", lambda r: r["proof_s"], "{:#.2g}"),
    PREDICT,
    FILE,
    *TIP_MAX.values(),
    *TIP_RMS.values(),
    Quantity("loop gain up to", "", lambda r: r["gain_margin_upper"], "{:.2f}"),
    Quantity("  one sample later", "", lambda r: r["gain_margin_upper_delayed"], "{:.2f}"),
    Quantity("spectral radius one sample later", "", lambda r: r["radius_delayed"], "{:.4f}"),
)


def main() -> None:
    """Measure, show, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    document = measure()
    show(document)
    if options.json:
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


def measure() -> dict[str, Any]:
    """Return everything as one document for JSON, one row for each number of rules."""
    syntheses, controllers = synthesise()
    bound = GAIN_ROOM * scaled_gain(controllers[COMMON_RULES])
    with tempfile.TemporaryDirectory() as folder:
        files = {rules: Path(folder) / f"rules-{rules}.json" for rules in RULES}
        for rules, path in files.items():
            controllers[rules].save(path)
        sizes = {rules: path.stat().st_size for rules, path in files.items()}
        driven, peer_us = drive(files)
    rows = [
        {
            "rules": rules,
            "kept": list(NAMED_RULES[rules]),
            **at_equal_gain(rules, bound),
            "gain": scaled_gain(controllers[rules]),
            **syntheses[rules],
            "file_bytes": sizes[rules],
            **driven[rules],
            **margins(controllers[rules]),
        }
        for rules in RULES
    ]
    return {
        "command": COMMAND,
        **current_provenance(),
        "alpha": COMMON.alpha,
        "equal_gamma": COMMON.gamma,
        "equal_gain_bound": bound,
        "rounds": ROUNDS,
        "peer": {"policy": PEER, "predict_us": peer_us},
        "rows": rows,
    }


def at_equal_gain(rules: int, bound: float) -> Row:
    """Return the smallest proven γ [rad/(N m)] under a bound of the scaled gains [N m/rad], and the gain met."""
    _progress(f"smallest gamma, rules: {rules}")
    made = design(dataclasses.replace(COMMON, kept=NAMED_RULES[rules], gamma=None, gain_bound=bound))
    return {
        "gamma": made.controller.gamma,
        "gain_at_gamma": scaled_gain(made.controller),
        "gamma_search_s": made.solve_seconds,
    }


def synthesise() -> tuple[dict[int, Row], dict[int, Controller]]:
    """Return medians of the time [s] that each design takes with the cone program's size, and the controllers."""
    made: dict[int, list[Design]] = {rules: [] for rules in RULES}
    for number in range(1, ROUNDS + 1):
        for rules in RULES:
            _progress(f"synthesis {number} of {ROUNDS}, rules: {rules}")
            made[rules].append(design(dataclasses.replace(COMMON, kept=NAMED_RULES[rules])))
    costs = {
        rules: {
            "synthesis_s": statistics.median(d.solve_seconds + d.proof_seconds for d in designs),
            "proof_s": statistics.median(d.proof_seconds for d in designs),
            "variables": designs[0].variables,
            "cone_rows": designs[0].rows,
        }
        for rules, designs in made.items()
    }
    return costs, {rules: designs[0].controller for rules, designs in made.items()}


def drive(files: dict[int, Path]) -> tuple[dict[int, Row], float]:
    """Return tip errors [mm] by case and the time of `predict` [µs] by number of rules, and the peer's time."""
    names = {rules: resolve(path).label for rules, path in files.items()}
    config = EvaluationConfig(policies=(*map(str, files.values()), PEER), control_period=PERIOD)
    _progress(f"{ROUNDS} rounds of episodes")
    evaluations = [evaluate(config) for _ in range(ROUNDS)]
    if not evaluations[0].complete:
        raise ValueError("an episode ended early: its tip error says nothing")
    calls: dict[str, list[float]] = {name: [] for name in (*names.values(), PEER)}
    for row in (row for evaluation in evaluations for row in evaluation.rows):
        calls[row["policy"]].append(row["predict_us"])
    errors = {(row["policy"], row["case"]): row for row in evaluations[0].rows}  # nothing is random: all rounds agree
    driven = {
        rules: {"predict_us": statistics.median(calls[name])}
        | {
            key: {case: errors[name, case][key] for case in config.cases}
            for key in ("tip_error_max_mm", "tip_error_rms_mm")
        }
        for rules, name in names.items()
    }
    return driven, statistics.median(calls[PEER])


def margins(controller: Controller) -> Row:
    """Return how much loop gain the sampled elastic arm bears, also with one extra sample of delay."""
    policy, arm = FuzzyPolicy(controller, PERIOD), ArmParameters()
    return {
        "gain_margin_upper": gain_margin(policy, arm, control_period=PERIOD)[1],
        "gain_margin_upper_delayed": gain_margin(policy, arm, control_period=PERIOD, delay=1)[1],
        "radius_delayed": spectral_radius(policy, arm, control_period=PERIOD, delay=1),
    }


def show(document: dict[str, Any]) -> None:
    """Print the table, a line for each quantity, and what it was made with."""
    table = Table("rules", box=None, pad_edge=False)
    for row in document["rows"]:
        table.add_column(str(row["rules"]), justify="right")
    table.add_row("premises kept", *(", ".join(row["kept"]) or "none" for row in document["rows"]))
    for line in LINES:
        head = f"{line.name} \\[{line.unit}]" if line.unit else line.name
        table.add_row(head, *(line.form.format(line.value(row)) for row in document["rows"]))
    Console(width=None if sys.stdout.isatty() else 150).print(table)
    peer, machine = document["peer"], document["machine"]
    print(
        f"\nalpha = {document['alpha']:g} 1/s; equal gamma {document['equal_gamma']:g} rad/(N m), equal gain bound "
        f"{1e-3 * document['equal_gain_bound']:.1f} kN m/rad; times: medians of {document['rounds']} rounds.\n"
        f"Without z1 (2 rules, 1 rule) the inertia is not interpolated but uncertain.\n"
        f"{peer['policy']} in the same run: {peer['predict_us']:.2f} µs. {machine['cpu']}, {machine['cores']} cores."
    )


def draw(document: dict[str, Any]) -> Figure:
    """Return small multiples over the number of rules; a grey ground marks the models without z1."""
    rows, peer = document["rows"], document["peer"]
    figure = Figure(figsize=(9.6, 5.6))
    grid = figure.subplots(2, 3, sharex=True)
    for axes, panel in zip(grid.flat, PANELS, strict=False):
        _value_panel(axes, panel, rows)
    timing, tip = grid[1, 0], grid[1, 2]
    timing.axhline(peer["predict_us"], color="#666666", linewidth=1.0, linestyle=(0, (4, 1.5)))
    timing.annotate(peer["policy"], (16, peer["predict_us"]), (0, 3), **SMALL)
    timing.set_ylim(top=1.25 * peer["predict_us"])
    notes = (
        f"gain ≤ {1e-3 * document['equal_gain_bound']:.1f} kN m/rad",
        f"γ = {1e6 * document['equal_gamma']:.0f} µrad/(N m)",
    )
    for axes, text in zip(grid.flat, notes, strict=False):
        axes.annotate(text, (11, 0), (0, 8), **SMALL)
    _tip_panel(tip, rows)
    for axes in grid.flat:
        axes.axvspan(LEFT, WITHOUT_Z1, color="#EFEFEF", zorder=0.0)
    for axes in grid[1]:
        axes.set_xscale("log", base=2)
        axes.set(xlabel="number of rules", xlim=(LEFT, RIGHT))
        axes.xaxis.set_major_locator(FixedLocator(RULES))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda rules, _: f"{rules:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
    figure.align_ylabels()
    note = "z1 = cos q2 dropped: the inertia is uncertain, no longer interpolated"
    figure.legend(handles=[Patch(color="#EFEFEF", label=note)], loc="outside lower center", handlelength=1.6)
    return figure


def _value_panel(axes: Axes, panel: Quantity, rows: list[Row]) -> None:
    """Draw one quantity from zero, or on a logarithmic scale, with its values beside the points."""
    values = [panel.value(row) for row in rows]
    axes.plot(RULES, values, "o-", color="#0072B2", markersize=4, markeredgewidth=1.0)
    for rules, value in zip(RULES, values, strict=True):
        axes.annotate(panel.form.format(value), (rules, value), panel.beside, **SMALL)
    axes.set(title=panel.name, ylabel=f"{panel.axis} [{panel.unit}]")
    if panel.log:
        axes.set_yscale("log")
        axes.set_ylim(0.5 * min(values), 3.0 * max(values))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.set_ylim(0.0, 1.2 * max(values))


def _tip_panel(axes: Axes, rows: list[Row]) -> None:
    """Draw the largest tip error in each case, each with its own colour, marker and dashes."""
    looks = (("#0072B2", "o", "-"), ("#D55E00", "s", (0, (4, 1.5))), ("#009E73", "^", (0, (1, 1.2))))
    for (case, quantity), (color, marker, dashes) in zip(TIP_MAX.items(), looks, strict=True):
        values = [quantity.value(row) for row in rows]
        axes.plot(RULES, values, color=color, marker=marker, linestyle=dashes, markersize=4.5, label=case)
    axes.set(title="largest tip error", ylabel="tip error [mm]", ylim=(0.0, None))
    axes.legend(loc="lower right", handlelength=3.2, labelspacing=0.25, fontsize=8.5, borderaxespad=0.2)


def _progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
