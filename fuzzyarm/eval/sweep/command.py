"""The sub-command `fuzzyarm sweep`: its options, and what happens with them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzyarm.eval.sweep.config import SweepConfig
    from fuzzyarm.eval.sweep.engine import Engine
    from fuzzyarm.eval.sweep.run import Sweep

__all__ = ["add_sweep_command", "configured", "given", "run_sweep"]


def add_sweep_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the sub-command to a parser's."""
    parser = commands.add_parser(
        "sweep",
        help="run policies on thousands of different plants",
        description="Run policies on many plants, drawn from a distribution or on a grid over two quantities. Writes "
        "success rates, quantiles of the tip error with intervals, heat maps and the worst plants to a folder, chunk "
        "by chunk: after a kill --resume goes on. Quantities: mass, motor_inertia, stiffness, damping, dry_friction, "
        "viscous_friction (factors), payload [kg], force (factor), noise (factor of 1e-5 rad, 1e-3 rad/s), delay "
        "[control periods of 1 ms].",
    )
    add = parser.add_argument
    add(
        "--policy",
        action="append",
        metavar="NAME",
        help="a policy's name, controller file, learned policy's folder, or code of your own as "
        "package.module:factory, which must act on batches; may be repeated (default: fuzzy-4, fuzzy-4-tip, "
        "computed-torque-tip and elastic-observer). With --resume, code that the folder names runs only if it is "
        "named again",
    )
    add("--case", action="append", metavar="NAME", help="nominal, machining or payload; may be repeated (default: all)")
    add("--robot", type=Path, metavar="FILE", help="TOML file of the arm to draw plants around (default: Table 1)")
    add(
        "--plants",
        type=int,
        metavar="N",
        help="number of plants (default: 1000), with --grid of each cell (default: 1)",
    )
    add("--seed", type=int, metavar="N", help="plant i is drawn from seed N + i (default: 0)")
    add(
        "--distribution",
        metavar="NAME",
        help="nominal, plants, loads (plants with payload and tip force) or all (with "
        "encoder noise and delay); default: loads, with --grid nominal",
    )
    add(
        "--range",
        nargs=3,
        action="append",
        metavar=("QUANTITY", "LOW", "HIGH"),
        help="draw a quantity uniformly from this range instead; may be repeated",
    )
    add(
        "--grid",
        nargs=4,
        action="append",
        metavar=("QUANTITY", "LOW", "HIGH", "COUNT"),
        help="set a quantity to COUNT values from LOW to HIGH; given twice, for the two axes of a grid",
    )
    add("--chunk", type=int, metavar="N", help="plants that a worker runs at a time (default: 500)")
    add("--bound", type=float, metavar="MM", help="success: to the end, with tip errors below this [mm] (default: 20)")
    add("--worst", type=int, metavar="N", help="plants kept for replay, of each policy and case (default: 5)")
    add(
        "--map",
        nargs=2,
        metavar="COLUMN",
        help="what the heat maps of a sweep without a grid are over, such as payload "
        "stiffness_1 (default: stiffness_1 payload, or the first two that vary)",
    )
    add("--backend", default="local", metavar="NAME", help="local (processes of this machine) or ray (default: local)")
    add(
        "--address",
        metavar="ADDRESS",
        help="of a Ray cluster: auto on one of its machines, or HOST:PORT (default: start Ray on this machine)",
    )
    add("--jobs", type=int, metavar="N", help="workers (default: one per core, or all CPUs of the cluster)")
    add("--out", type=Path, default=Path("fuzzyarm-sweep"), metavar="DIR", help="folder (default: fuzzyarm-sweep)")
    add("--resume", action="store_true", help="go on with the sweep in the folder; its options need not be repeated")
    add(
        "--replay",
        nargs=3,
        metavar=("POLICY", "CASE", "PLANT"),
        help="run one plant of the folder's sweep anew and write its signals and figures",
    )
    add("--json", action="store_true", help="print the summary as JSON instead of the table")
    parser.set_defaults(run=run_sweep)


def run_sweep(options: argparse.Namespace) -> int:
    """Run the sub-command and return its exit code; bad usage raises ValueError or OSError."""
    from fuzzyarm.eval.sweep.engine import Engine, WorkersLost
    from fuzzyarm.eval.sweep.run import Sweep

    engine = Engine(options.backend, options.jobs, options.address)
    resumed = options.resume or options.replay
    sweep = Sweep.resume(options.out, given(options)) if resumed else Sweep.begin(options.out, configured(options))
    if options.replay:
        policy, case, plant = options.replay
        return _replay(sweep, policy, case, _number("--replay", plant, int))
    try:
        _run(sweep, engine)
        return _summarise(sweep, options.json)
    except KeyboardInterrupt:
        code, reason = 130, "interrupted"
    except WorkersLost as error:
        code, reason = 1, str(error)
    except (OSError, ValueError):
        if not resumed:
            sweep.store.take_back()
        raise
    print(f"fuzzyarm sweep: {reason}; what is done is kept: --resume --out {options.out} goes on", file=sys.stderr)
    return code


def configured(options: argparse.Namespace) -> SweepConfig:
    """Return the configuration that the options ask for."""
    from fuzzyarm.eval.sweep.config import SweepConfig

    return SweepConfig.of(given(options))


def given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the fields of the configuration that are given."""
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.eval.sweep.config import Axis, QuantityRange

    values = {
        "policies": options.policy and tuple(options.policy),
        "cases": options.case and tuple(options.case),
        "robot": options.robot and ArmParameters.from_toml(options.robot),
        "map": options.map and tuple(options.map),
        "ranges": options.range
        and tuple(
            QuantityRange(name, _number("--range", low), _number("--range", high)) for name, low, high in options.range
        ),
        "grid": options.grid
        and tuple(
            Axis(name, _number("--grid", low), _number("--grid", high), _number("--grid", count, int))
            for name, low, high, count in options.grid
        ),
        **{name: getattr(options, name) for name in ("plants", "seed", "distribution", "chunk", "bound", "worst")},
    }
    return {name: value for name, value in values.items() if value is not None}


def _number(option: str, text: str, kind: Callable[[str], Any] = float) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"{option}: {text!r} must be a {'whole ' if kind is int else ''}number") from None


def _run(sweep: Sweep, engine: Engine) -> None:
    """Run the missing chunks, with a progress bar."""
    from fuzzyarm.common.console import progress

    total, remaining = sweep.store.config.total, sweep.remaining
    with progress("plants", total) as advance:
        advance(completed=total - remaining)
        for done in sweep.run(engine, lambda text: advance(completed=done, line=f"fuzzyarm sweep: {text}")):
            pass


def _summarise(sweep: Sweep, as_json: bool) -> int:
    """Write the results and print them."""
    from fuzzyarm.common.console import output, progress
    from fuzzyarm.eval.sweep.run import EPISODES, SUMMARY, TABLE
    from fuzzyarm.eval.sweep.table import print_sweep

    with progress("figures", None) as advance:
        summary = sweep.summarise(advance)
    if as_json:
        print(json.dumps(summary.document, indent=1))
    else:
        print_sweep(summary.document, output())
        print(f"\n{SUMMARY}, {TABLE}, {EPISODES} and {summary.figures} figures in {sweep.store.folder}")
    return 0


def _replay(sweep: Sweep, policy: str, case: str, plant: int) -> int:
    """Run one plant again and say how it ended."""
    replayed = sweep.replay_plant(policy, case, plant)
    rollout = replayed.rollout
    end = "followed to the end" if rollout.completed else f"ended at {rollout.time[-1]:.3f} s: {rollout.reason}"
    largest = 1e3 * rollout.tip_error.max()
    print(f"plant {plant} (seed {rollout.seed}), {policy}, {case}: {end}, tip error up to {largest:.6g} mm")
    print(f"signals and figures in {replayed.folder}")
    return 0
