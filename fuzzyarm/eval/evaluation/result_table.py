"""The table of results, for the terminal and as Markdown for the README."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any

from rich.console import Console
from rich.text import Text

from fuzzyarm.common.console import print_paragraphs, print_table
from fuzzyarm.common.console import table as new_table
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.declarations import ROW, declared_cells
from fuzzyarm.eval.episodes.metrics import millimetres
from fuzzyarm.policies.declared import Declared

__all__ = ["COLUMNS", "DECLARED", "declared_rows", "print_passes", "print_results", "table_rows"]

_DISPENSABLE = (7, 6, 5, 4, 2)
"""Columns of the table, with the policy as number 0, that a narrow terminal does without, in this order."""
_PEAKS = ("torque_peak_1", "torque_peak_2")
"""Stands for those of all joints."""
COLUMNS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("tip error max [mm]", ("tip_error_max_mm",), "{:#.3g}"),
    ("max but for 0.1 s at the ends [mm]", ("tip_error_max_mid_mm",), "{:#.3g}"),
    ("rms [mm]", ("tip_error_rms_mm",), "{:#.3g}"),
    ("tip circularity [mm]", ("circularity_link_min_mm", "circularity_link_max_mm"), "{:+#.3g}"),
    ("peak torque [N m]", _PEAKS, "{:.0f}"),
    ("work [J]", ("energy",), "{:.0f}"),
    ("predict [µs]", ("predict_us",), "{:.1f}"),
)
"""Heading, the metrics shown in one cell, and their format. Metrics of the motor side are left out: they do not say
where the tip is."""
DECLARED = (*ROW, "proven of the rigid arm")
"""Headings of the table of what policies declare."""


def table_rows(
    rows: Sequence[dict[str, Any]], titles: Mapping[str, str] | None = None
) -> list[tuple[str, str, list[str]]]:
    """Return (case title, policy, cells) for each policy in each case; over several seeds medians with ranges.

    `titles` by name of the case; None: those of the two-joint arm.
    """
    known = {name: case.title for name, case in CASES.items()} if titles is None else titles
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["case"], row["policy"]), []).append(row)
    result = []
    for (case, policy), runs in groups.items():
        ended = sum(not run["completed"] for run in runs)
        note = f" (ended early in {ended} of {len(runs)})" if ended else ""
        result.append((known[case], policy + note, [_cell(runs, keys, form) for _, keys, form in COLUMNS]))
    return result


def _cell(runs: Sequence[dict[str, Any]], keys: tuple[str, ...], form: str) -> str:
    parts = []
    if keys == _PEAKS:
        keys = tuple(key for key in runs[0] if key.startswith("torque_peak_"))
    for key in keys:
        values = [run[key] for run in runs]
        shown = partial(millimetres, form=form.format) if key.endswith("_mm") else form.format
        text = shown(median(values))
        if len(values) > 1:
            text += f" ({shown(min(values))} to {shown(max(values))})"
        parts.append(text)
    return parts[0] if len(parts) == 1 else f"[{', '.join(parts)}]"


def print_results(rows: Sequence[dict[str, Any]], console: Console, titles: Mapping[str, str] | None = None) -> None:
    """Print the table, the policies of each case below its title, and what a narrow terminal leaves out of it."""
    table = new_table(["policy", *(heading for heading, _, _ in COLUMNS)], console=console)
    last = None
    for case, policy, cells in table_rows(rows, titles):
        if case != last:
            table.add_section()
            table.add_row(Text(case, style="bold"))
            last = case
        table.add_row(*map(Text, (policy, *cells)))
    if left_out := print_table(table, console, dispensable=_DISPENSABLE):
        names = ", ".join(COLUMNS[column - 1][0] for column in sorted(left_out))
        print_paragraphs(console, [f"Left out on {console.width} columns: {names}; results.csv has all."])


def print_passes(rows: Sequence[dict[str, Any]], passes: int, console: Console) -> None:
    """Print the largest tip error of each pass, a line for each case and policy; over several seeds the median."""
    table = new_table(["largest tip error [mm], pass", *map(str, range(1, passes + 1))], console=console)
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["case"], row["policy"]), []).append(row)
    for (case, policy), runs in groups.items():
        errors = (median(run[f"pass_{number}_max_mm"] for run in runs) for number in range(1, passes + 1))
        table.add_row(Text(f"{case}, {policy}"), *(millimetres(error) for error in errors))
    print_table(table, console, dispensable=tuple(range(2, passes)))


def declared_rows(
    declared: Mapping[str, Declared | None], certificates: Mapping[str, str | None]
) -> list[tuple[str, ...]]:
    """Return the cells below `DECLARED` of each policy, given declarations and certificates in words by label."""
    return [
        (label, *declared_cells(own), "nothing" if certificates[label] is None else "decay and L2 gain in the box")
        for label, own in declared.items()
    ]
