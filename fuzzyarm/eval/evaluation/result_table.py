"""The table of results, remarks on policies at a torque limit, and the last lines of `fuzzyarm evaluate`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console

from fuzzyarm.common.console import Sheet, print_paragraphs
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.eval.declarations import ROW, declared_cells
from fuzzyarm.eval.episodes.metrics import RESOLUTION, Metric, columns, is_lost, millimetres
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.stability.linearisation import largest_radius, linearise_path
from fuzzyarm.policies.declared import Declared

__all__ = [
    "by_case_and_policy", "declared_rows", "print_passes", "print_results", "saturation", "table_rows", "verdict",
    "winners",
]  # fmt: skip

_LONG = 0.01  # share of an evaluation's steps with a motor at its limit, above which a remark says so


def saturation(rollouts: Sequence[Rollout], policies: Mapping[str, Any], arm: AnyArm, period: float) -> tuple[str, ...]:
    """Return a remark on each policy that is at a torque limit for long, with the stability of its loop.

    The loop is linearised as in `linearisation`: at rest, in postures of the arm's default path, with a control period
    [s].
    """
    limit, lines = bounds_of(arm).torque, []
    for name, policy in policies.items():
        reached = [(np.abs(run.torque) >= limit).any(axis=1) for run in rollouts if run.policy == name]
        share = float(np.concatenate(reached).mean())
        if share > _LONG:
            text = f"{name}: a motor is at its torque limit in {100.0 * share:.0f} % of the steps; "
            lines.append(text + _stability(policy, arm, period))
    return tuple(lines)


def _stability(policy: Any, arm: AnyArm, period: float) -> str:
    try:
        if policy.action_period != period:
            raise ValueError("it holds its action for several control periods; see fuzzyarm margins")
        radius = largest_radius(linearise_path(policy, arm, period))
    except (AttributeError, TypeError, ValueError) as error:
        return f"whether its loop is stable on this arm was not found: {' '.join(str(error).split())}"
    measured = f"spectral radius {radius:.3g} at rest, see fuzzyarm margins"
    if radius > 1.0:
        return f"its loop is unstable on this arm ({measured})"
    return f"its loop is stable ({measured}), the motion asks for more torque than there is"


_FEW = 3  # policies that a line names; of the others it gives the number
_Row = Mapping[str, Any]  # of metrics


def by_case_and_policy(rows: Sequence[_Row]) -> dict[str, dict[str, list[_Row]]]:
    """Return the rows of each case by policy, one for each seed."""
    groups: dict[str, dict[str, list[_Row]]] = {}
    for row in rows:
        groups.setdefault(row["case"], {}).setdefault(row["policy"], []).append(row)
    return groups


def verdict(
    rows: Sequence[_Row], certificates: Mapping[str, str | None], folder: Path, files: int, titles: Mapping[str, str]
) -> list[str]:
    """Return the lines of `winners`, one about certificates and one about the next command.

    `files` is how many files were written to the folder.
    """
    proven = [policy for policy, text in certificates.items() if text is not None]
    others = f"; nothing of {len(certificates) - len(proven)} others" if 0 < len(proven) < len(certificates) else ""
    there = shlex.quote(str(folder))
    return [
        *winners(rows, titles),
        f"Proven of the rigid arm: {_named(proven) or 'nothing'}{others}",
        f"{files} files in {there}; next: fuzzyarm report {there}",
    ]


def winners(rows: Sequence[_Row], titles: Mapping[str, str]) -> list[str]:
    """Return a line for each case: which policies won it, and which lost the path, see `metrics.is_lost`.

    A case is won by the smallest rms tip error, over several seeds the smallest median, among the policies that never
    lost the path.
    """
    return [_won(group, titles[case]) for case, group in by_case_and_policy(rows).items()]


def _won(group: Mapping[str, Sequence[_Row]], title: str) -> str:
    lost = sorted(policy for policy, runs in group.items() if any(map(is_lost, runs)))
    held = {policy: runs for policy, runs in group.items() if policy not in lost}
    if not held:
        return f"{title}: no policy followed the path to its end"
    errors = {policy: median(row["tip_error_rms_mm"] for row in runs) for policy, runs in held.items()}
    best = min(errors.values())
    winners = [policy for policy, error in errors.items() if error <= max(best, RESOLUTION)]
    after = f"; {_named(lost)} lost the path" if lost else ""
    verb = "followed" if len(errors) == 1 else "won" if len(winners) == 1 else "tie"
    return f"{title}: {_named(winners)} {verb}, rms tip error {millimetres(best)} mm{after}"


def _named(policies: Sequence[str]) -> str:
    """Return up to `_FEW` policies by name, and the number of the others."""
    return ", ".join(policies[:_FEW]) + (f" and {len(policies) - _FEW} more" if len(policies) > _FEW else "")


def table_rows(rows: Sequence[_Row]) -> list[tuple[str, str, list[str]]]:
    """Return (case, policy, cells) for each policy in each case; over several seeds medians with ranges."""
    result = []
    for case, group in by_case_and_policy(rows).items():
        for policy, runs in group.items():
            ended = sum(not run["completed"] for run in runs)
            note = f" (ended early in {ended} of {len(runs)})" if ended else ""
            result.append((case, policy + note, [_cell(runs, metrics) for metrics in columns().values()]))
    return result


def _cell(runs: Sequence[_Row], metrics: Sequence[Metric]) -> str:
    """Return the numbers of some metrics; for the metrics of a joint, those of all joints of the arm."""
    parts = []
    stem = metrics[0].name.removesuffix(str(metrics[0].joint))
    names = [name for name in runs[0] if name.startswith(stem)] if metrics[0].joint else [one.name for one in metrics]
    for name in names:
        values = [run[name] for run in runs]
        text = metrics[0].text(median(values))
        if len(values) > 1:
            text += f" ({metrics[0].text(min(values))} to {metrics[0].text(max(values))})"
        parts.append(text)
    return parts[0] if len(parts) == 1 else f"[{', '.join(parts)}]"


def print_results(rows: Sequence[_Row], console: Console, titles: Mapping[str, str]) -> None:
    """Print the table, the policies of each case below its title, and name the columns that did not fit."""
    found, headings = table_rows(rows), list(columns())
    sheet = Sheet(
        ["policy", *headings],
        [(policy, *cells) for _, policy, cells in found],
        groups=[titles[case] for case, _, _ in found],
        dispensable=[at for at, metrics in enumerate(columns().values(), start=1) if metrics[0].swept is None][::-1],
    )
    if left_out := sheet.print(console):
        names = ", ".join(headings[column - 1] for column in sorted(left_out))
        print_paragraphs(console, [f"Left out on {console.width} columns: {names}; results.csv has all."])


def print_passes(rows: Sequence[_Row], passes: int, console: Console) -> None:
    """Print the largest tip error of each pass, a line for each case and policy; over several seeds the median."""
    numbers = range(1, passes + 1)
    cells = [
        [
            f"{case}, {policy}",
            *(millimetres(median(run[f"pass_{number}_max_mm"] for run in runs)) for number in numbers),
        ]
        for case, group in by_case_and_policy(rows).items()
        for policy, runs in group.items()
    ]
    Sheet(["largest tip error [mm], pass", *map(str, numbers)], cells, dispensable=range(2, passes)).print(console)


def declared_rows(
    declared: Mapping[str, Declared | None], certificates: Mapping[str, str | None]
) -> list[tuple[str, ...]]:
    """Return headings and, for each policy, the cells below; declarations and certificates in words are by label."""
    return [(*ROW, "proven of the rigid arm")] + [
        (label, *declared_cells(own), "nothing" if certificates[label] is None else "decay and L2 gain in the box")
        for label, own in declared.items()
    ]
