"""The table of `fuzzyarm bench` and its notes, and the figure of --lanes-sweep: throughput by number of lanes."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console

from fuzzyarm.common.console import Sheet, print_paragraphs
from fuzzyarm.eval._figure_files import MARKERS
from fuzzyarm.eval.evaluation.figures import DASHES

__all__ = ["draw_throughput", "print_speeds"]


def _speed_cells(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Return the headings of the speed table, then a list with the cells of each of the document's `rows`, as text."""
    peers = list(dict.fromkeys(peer for row in rows for peer in row["ratios"]))
    headings = ["group", "entry", "lanes", "threads", "dtype", "steps/s [thousand]"]
    headings += [*(f"× {peer}" for peer in peers), "tip error [µm]"]
    cells = []
    for row in rows:
        speed, error = row["steps_per_s"], row["tip_error_um"]
        cells.append(
            [
                *(str(row[key]) for key in ("group", "name", "lanes", "threads", "dtype")),
                "not measured" if speed is None else _spread(speed, 1e-3),
                *(_spread(row["ratios"][peer]) if peer in row["ratios"] else "" for peer in peers),
                "" if error is None else f"{error:.3g}",
            ]
        )
    return headings, cells


def _speed_notes(document: dict[str, Any]) -> list[str]:
    """Return the notes below the speed table, one string for each paragraph."""
    method, machine, versions = document["method"], document["machine"], document["versions"]
    notes = [
        f"Median (quartiles) of {method['rounds']} rounds of {method['seconds']:g} s in which the entries take "
        "turns; a ratio is FuzzyArm's speed over the peer's in the same round. A step is a control step of 1 ms with "
        "observation, reward and the resets that are due, in a sweep also with the policy; a peer's step is its own. "
        f"The batch uses as many of the {method['threads']} threads as help, the others use all. "
        "The same arm in MuJoCo has no observation, reward, reset or static friction peak, which favours it. Tip "
        "error: largest distance to the event integrator in the nominal case, with computed torque in the loop.",
        f"Memory: {document['memory_per_lane']['bytes']:.0f} bytes for each further lane of the vector environment.",
    ]
    missing: dict[str, list[str]] = {}
    for row in [*document["rows"], *document["sweep"]]:
        if row["reason"]:
            missing.setdefault(row["reason"], []).append(row["name"])
    notes += [f"Not measured: {', '.join(dict.fromkeys(names))}: {reason}." for reason, names in missing.items()]
    libraries = ", ".join(f"{name} {number}" for name, number in versions.items() if number)
    notes.append(f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}; {libraries}; {document['date']}.")
    return notes


def print_speeds(document: dict[str, Any], console: Console) -> None:
    """Print the table and its notes; of the sweep over lanes, print only the measured rows."""
    headings, cells = _speed_cells([*document["rows"], *(row for row in document["sweep"] if row["steps_per_s"])])
    Sheet(headings[1:], [row[1:] for row in cells], groups=[row[0] for row in cells]).print(console)
    print_paragraphs(console, _speed_notes(document))


def _spread(values: dict[str, float], scale: float = 1.0) -> str:
    """Return "median (q1-q3)", from the entries of `values` times `scale`; the median has at least three digits."""
    scaled = [scale * values[key] for key in ("median", "q1", "q3")]
    decimals = max(0, 2 - math.floor(math.log10(scaled[0])))
    median, q1, q3 = (f"{value:.{decimals}f}" for value in scaled)
    return f"{median} ({q1}-{q3})"


def draw_throughput(document: dict[str, Any]) -> Figure:
    """Return the figure of steps per second against the number of lanes: medians and quartiles, on logarithmic axes."""
    curves: dict[str, list[tuple[int, dict[str, float]]]] = {}
    for row in document["sweep"]:
        if row["steps_per_s"]:
            curves.setdefault(f"{row['name']}, {row['dtype']}", []).append((row["lanes"], row["steps_per_s"]))
    figure = Figure(figsize=(6.6, 4.4))
    axes = figure.subplots()
    for (label, points), dashes, marker in zip(
        curves.items(), itertools.cycle(DASHES), itertools.cycle(MARKERS), strict=False
    ):
        lanes = [lanes for lanes, _ in points]
        low, median, high = ([speed[key] for _, speed in points] for key in ("q1", "median", "q3"))
        (line,) = axes.plot(lanes, median, linestyle=dashes, marker=marker, markersize=4.5, label=label)
        axes.fill_between(lanes, low, high, color=line.get_color(), alpha=0.2, linewidth=0.0)
    axes.set_xscale("log", base=4)
    axes.set_yscale("log")
    axes.set(xlabel="lanes, environments in one batch [1]", ylabel="throughput [steps/s]")
    axes.set_title("Throughput of a batch, control steps of 1 ms")
    axes.xaxis.set_major_formatter(lambda lanes, _: f"{lanes:,.0f}".replace(",", " "))
    if curves:
        machine, threads = document["machine"], document["method"]["threads"]
        title = f"{machine['cpu']}, {machine['cores']} cores, at most {threads} threads; bands: quartiles"
        figure.legend(loc="outside lower center", ncols=1, title=title)
    return figure
