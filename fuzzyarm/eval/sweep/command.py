"""The sub-command `fuzzyarm sweep`: its options, and what happens with them."""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzyarm.eval.sweep.config import SweepConfig
    from fuzzyarm.eval.sweep.store import Store

EPISODES, SUMMARY, TABLE = "episodes.npz", "sweep.json", "sweep.csv"
LOOKED_AT = ("bound", "worst", "map")
"""Options that --resume may change: they decide no episode's numbers."""


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
        help="a policy's name, controller file or learned policy's folder; "
        "may be repeated (default: fuzzy-4, fuzzy-4-tip, computed-torque-tip and elastic-observer)",
    )
    add("--case", action="append", metavar="NAME", help="nominal, machining or payload; may be repeated (default: all)")
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
    from fuzzyarm.eval.sweep.run import load_policies
    from fuzzyarm.eval.sweep.store import Store

    engine = Engine(options.backend, options.jobs, options.address)
    if options.resume or options.replay:
        store = Store.open(options.out, **_looked_at(options))
        _check_same(options, store)
        policies = load_policies(store.config)
    else:
        config = configured(options)
        policies = load_policies(config)
        store = Store.create(options.out, config)
    if options.replay:
        return _replay(store, policies, *options.replay)
    store.missing()  # a broken chunk is found before anything runs
    try:
        return _run(store, policies, engine, options.json)
    except KeyboardInterrupt:
        code, reason = 130, "interrupted"
    except WorkersLost as error:
        code, reason = 1, str(error)
    except (OSError, ValueError):
        if not options.resume:
            store.take_back()
        raise
    print(f"fuzzyarm sweep: {reason}; what is done is kept: --resume --out {options.out} goes on", file=sys.stderr)
    return code


def configured(options: argparse.Namespace) -> SweepConfig:
    """Return the configuration that the options ask for."""
    from fuzzyarm.eval.sweep.config import SweepConfig

    given = _given(options)
    if "grid" in given:
        given = {"distribution": "nominal", "plants": 1} | given
    return SweepConfig(**given)


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the fields of the configuration that are given."""
    from fuzzyarm.eval.sweep.config import Axis

    values = {
        "policies": options.policy and tuple(options.policy),
        "cases": options.case and tuple(options.case),
        "map": options.map and tuple(options.map),
        "ranges": options.range
        and tuple((name, _number("--range", low), _number("--range", high)) for name, low, high in options.range),
        "grid": options.grid
        and tuple(
            Axis(name, _number("--grid", low), _number("--grid", high), _number("--grid", count, int))
            for name, low, high, count in options.grid
        ),
        **{name: getattr(options, name) for name in ("plants", "seed", "distribution", "chunk", "bound", "worst")},
    }
    return {name: value for name, value in values.items() if value is not None}


def _looked_at(options: argparse.Namespace) -> dict[str, Any]:
    return {name: value for name, value in _given(options).items() if name in LOOKED_AT}


def _check_same(options: argparse.Namespace, store: Store) -> None:
    """Raise ValueError if an option contradicts the sweep of the folder."""
    for name, value in _given(options).items():
        kept = getattr(store.config, name)
        if value != kept:
            raise ValueError(f"{store.folder} holds a sweep with {name} = {kept}, not {value}: choose another --out")


def _number(option: str, text: str, kind: Callable[[str], Any] = float) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"{option}: {text!r} must be a {'whole ' if kind is int else ''}number") from None


def _run(store: Store, policies: dict[str, Any], engine: Any, as_json: bool) -> int:
    import numpy as np
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.sweep.figures import write_sweep_figures
    from fuzzyarm.eval.sweep.run import run_missing
    from fuzzyarm.eval.sweep.summary import summarise
    from fuzzyarm.eval.sweep.table import print_sweep, summary_csv

    config, stderr = store.config, Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(
        *columns, console=stderr, disable=not stderr.is_terminal, transient=True, speed_estimate_period=600.0
    ) as bar:
        done = config.total - sum(len(config.members(number)) for number in store.missing())
        plants = bar.add_task("plants", total=config.total, completed=done)
        run_missing(
            store,
            policies,
            engine,
            progress=lambda number, _: bar.advance(plants, len(config.members(number))),
            report=lambda text: stderr.print(f"fuzzyarm sweep: {text}", markup=False, highlight=False, soft_wrap=True),
        )
        results = store.load_all()
        document = summarise(config, results)
        drawing = bar.add_task("figures", total=None)
        figures = write_sweep_figures(config, results, document["rows"], store.folder, lambda: bar.advance(drawing))
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **results)
    write_atomically(store.folder / EPISODES, content.getvalue())
    write_atomically(store.folder / TABLE, summary_csv(document["rows"]))
    write_atomically(store.folder / SUMMARY, json.dumps(document, indent=1) + "\n")
    if as_json:
        print(json.dumps(document, indent=1))
    else:
        # Wide when piped: a plain table must not be folded.
        print_sweep(document, Console() if sys.stdout.isatty() else Console(width=250))
        print(f"\n{SUMMARY}, {TABLE}, {EPISODES} and {len(figures)} figures in {store.folder}")
    return 0


def _replay(store: Store, policies: dict[str, Any], policy: str, case: str, plant: str) -> int:
    import numpy as np

    from fuzzyarm.common.files import write_atomically
    from fuzzyarm.eval.evaluation.figures import write_figures
    from fuzzyarm.eval.sweep.episodes import replay

    rollout = replay(store.config, policies, _number("--replay", plant, int), policy, case)
    folder = store.folder / f"replay-{policy}-{case}-{plant}"
    folder.mkdir(exist_ok=True)
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **dataclasses.asdict(rollout))
    write_atomically(folder / EPISODES.replace("episodes", "episode"), content.getvalue())
    write_figures([rollout], folder)
    end = "followed to the end" if rollout.completed else f"ended at {rollout.time[-1]:.3f} s: {rollout.reason}"
    largest = 1e3 * rollout.tip_error.max()
    print(f"plant {plant} (seed {rollout.seed}), {policy}, {case}: {end}, tip error up to {largest:.6g} mm")
    print(f"signals and figures in {folder}")
    return 0
