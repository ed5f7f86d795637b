"""The tables of an evaluation, and its certificates in lines."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib import resources
from statistics import median
from typing import TYPE_CHECKING, Any

from rich.console import Console

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.common.console import Sheet, print_paragraphs
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.declarations import ROW, declared_cells
from fuzzyarm.eval.episodes.metrics import RESOLUTION, Metric, columns, is_lost, millimetres
from fuzzyarm.policies.declared import Declared

if TYPE_CHECKING:
    from fuzzyarm.eval.evaluation.run import Evaluation

__all__ = [
    "by_case_and_policy", "certificate_lines", "declared_rows", "print_passes", "print_results", "table_rows",
]  # fmt: skip

_Row = Mapping[str, Any]  # of metrics


def by_case_and_policy(rows: Sequence[_Row]) -> dict[str, dict[str, list[_Row]]]:
    """Return the rows by case and by policy; each list has a row for each seed."""
    groups: dict[str, dict[str, list[_Row]]] = {}
    for row in rows:
        groups.setdefault(row["case"], {}).setdefault(row["policy"], []).append(row)
    return groups


def table_rows(rows: Sequence[_Row]) -> list[tuple[str, str, list[str]]]:
    """Return (case, policy, cells) for each policy in each case; with several seeds, cells are medians with ranges."""
    result = []
    for case, group in by_case_and_policy(rows).items():
        for policy, runs in group.items():
            ended = sum(not run["completed"] for run in runs)
            note = f" (ended early in {ended} of {len(runs)})" if ended else ""
            result.append((case, policy + note, [_cell(runs, metrics) for metrics in columns().values()]))
    return result


def _cell(runs: Sequence[_Row], metrics: Sequence[Metric]) -> str:
    """Return the cell of `metrics` under one heading; with several seeds, medians with ranges.

    For a metric of one joint, the cell has the numbers of all joints, as in [0.1, 0.2].
    """
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


def print_results(evaluation: Evaluation, console: Console) -> None:
    """Print a line for each policy: rms and largest tip error in each case, and the bound for nearby arms, if known.

    Over several seeds these are medians. The smallest rms error of a case is marked, except below `RESOLUTION` or if
    the policy lost the path.
    """
    config, near = evaluation.config, _near_bounds(evaluation)
    groups = {case: _errors(group) for case, group in by_case_and_policy(evaluation.rows).items()}
    headings = ["policy", *(config.titles[case].replace(": ", ":\n") for case in groups)]
    rows = [[policy, *(group[policy] for group in groups.values())] for policy in evaluation.certificates]
    if near:
        headings.append("proven\n(near)")
        rows = [[*row, near.get(row[0], "")] for row in rows]
    several = f", medians of {config.seeds} seeds" if config.seeds > 1 else ""
    Sheet(headings, rows).print(console)
    lines = [f"Tip error, rms / largest [mm]{several}; * smallest rms error of a case."]
    if near:
        bound = "bound on the tip error [mm], Case 1 repeated for ever, every arm near Table 1"
        lines.append(f"proven (near): {bound}; see fuzzyarm prove --set near --laps ever")
    print_paragraphs(console, ["\n".join(lines)])


def _errors(group: Mapping[str, Sequence[_Row]]) -> dict[str, str]:
    """Return each policy's cell with its rms and largest tip error in one case; `group` has the rows by policy."""
    lost = {policy: sum(map(is_lost, runs)) for policy, runs in group.items()}
    rms, largest = (
        {policy: float(median(run[f"tip_error_{kind}_mm"] for run in runs)) for policy, runs in group.items()}
        for kind in ("rms", "max")
    )
    best = min((rms[policy] for policy in group if not lost[policy]), default=0.0)

    def cell(policy: str) -> str:
        if lost[policy]:
            return f"lost {lost[policy]} of {len(group[policy])}"
        texts = [millimetres(value, "{:#.3g}".format) for value in (rms[policy], largest[policy])]
        return " / ".join(texts) + "*" * (rms[policy] == best >= RESOLUTION and len(group) > 1)

    return {policy: cell(policy) for policy in group}


def _near_bounds(evaluation: Evaluation) -> dict[str, str]:
    """Return, by policy, the tip bound [mm] that was proven for the same policy files, if there is one.

    {} unless arm, path and control period are those of the proof.
    """
    config, files = evaluation.config, evaluation.made_with["policy_files"]
    if config.arm != ArmParameters() or (config.path, config.points, config.control_period) != ("circle", None, 1e-3):
        return {}
    stored = json.loads(resources.files("fuzzyarm.eval.evaluation").joinpath("near_bounds.json").read_text("utf-8"))
    bounds = {policy: at_most(one["bound_mm"], 3) for policy, one in stored["bounds"].items()}
    return {name: text for name, text in bounds.items() if files.get(name) == stored["bounds"][name]["files"]}


def certificate_lines(certificates: Mapping[str, str | None], bounds: Mapping[str, dict[str, Any] | None]) -> list[str]:
    """Return a line for each policy with a certificate, with the command to show it, then one on the policies without.

    If a policy's entry of `bounds` is None, its certificate is void along the path.
    """
    lines = []
    for policy, numbers in bounds.items():
        if numbers is not None:
            rates = f"alpha = {at_least(numbers['alpha'], 3)} 1/s, gamma = {at_most(numbers['gamma'], 3)}"
            lines.append(f"{policy}: proven for the rigid arm: {rates}; see fuzzyarm show {policy}")
        elif certificates[policy] is not None:
            lines.append(f"{policy}: its certificate is void along this path; see fuzzyarm show {policy}")
    others = [policy for policy, text in certificates.items() if text is None]
    return [*lines, *([f"nothing is proven for the rigid arm: {', '.join(others)}"] if others else [])]


def print_passes(rows: Sequence[_Row], passes: int, console: Console) -> None:
    """Print the largest tip error of each pass, in one line per case and policy; with several seeds, the median."""
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
    """Return the headings, then each policy's declaration and what is proven; both arguments are keyed by label."""
    return [(*ROW, "proven for the rigid arm")] + [
        (label, *declared_cells(own), "nothing" if certificates[label] is None else "decay and L2 gain in the box")
        for label, own in declared.items()
    ]
