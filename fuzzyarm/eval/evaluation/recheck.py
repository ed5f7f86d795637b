"""An evaluation run again from its ``results.json``, and every number of it compared."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fuzzyarm.eval.evaluation.results_file import Results
from fuzzyarm.eval.evaluation.run import evaluate
from fuzzyarm.policies import Kind, resolve, resolve_all

RELATIVE, ABSOLUTE = 1e-6, 1e-9
"""Numbers agree if they differ by at most the larger of 1e-6 of the larger one and 1e-9, in the unit of the number."""

CLOCK = ("predict_us",)
"""Not compared: the one kind of number that differs from run to run."""

SHOWN = 20  # differences in the table


@dataclasses.dataclass(frozen=True)
class Difference:
    """A value that is not what it was; None where there is no such value.

    Attributes:
        place: the episode, or the policy whose certificate it is.
        name: of the metric.
        recorded: in the file.
        measured: now.
    """

    place: str
    name: str
    recorded: Any
    measured: Any


@dataclasses.dataclass(frozen=True)
class Check:
    """The outcome: how many numbers of how many rows were compared, what differs, and what it was made with then."""

    numbers: int
    rows: int
    differences: list[Difference]
    notes: list[str]


def check(results: Results, code: Sequence[str] = (), progress: Callable[[], None] | None = None) -> Check:
    """Run an evaluation again and compare.

    Args:
        results: as `read_results` returns them.
        code: policies of the form ``package.module:factory`` that the user wants to be imported and run. A results file
            alone never makes that happen.
        progress: called after each episode.

    Raises:
        ValueError: the results name code that is not in `code` or the other way round, an unknown policy, or one whose
            file is not the one that was measured.
        OSError: the file of a policy cannot be read.
    """
    _check_consent(results, code)
    _check_files(results)
    fresh = evaluate(results.config, progress)
    old = _flat(results.rows, results.bounds or {})
    new = _flat(fresh.rows, {} if results.bounds is None else fresh.bounds)
    return Check(
        numbers=sum(not isinstance(value, str | bool) for value in old.values()),
        rows=len(results.rows),
        differences=[
            Difference(*key, old.get(key), new.get(key))
            for key in dict.fromkeys([*old, *new])
            if not _same(old.get(key), new.get(key))
        ],
        notes=_notes(results, fresh.made_with),
    )


def _check_consent(results: Results, code: Sequence[str]) -> None:
    """See that the user has named exactly the code that would be run."""
    needed = [name for name in results.config.policies if resolve(name).kind is Kind.CODE]
    unasked = [name for name in needed if name not in code]
    if unasked:
        flags = " ".join(f"--policy {name}" for name in unasked)
        raise ValueError(
            f"{results.path} holds results of code that is not part of fuzzyarm, which a file alone does not get run; "
            f"if you trust it, add {flags}"
        )
    others = [name for name in code if name not in needed]
    if others:
        raise ValueError(
            f"--policy {' '.join(others)}: beside --check it only permits code, package.module:factory, that the file "
            f"names; {results.path} names {', '.join(needed) or 'none'}"
        )


def _check_files(results: Results) -> None:
    """See that every policy is made from the files that were measured."""
    if results.policy_files is None:
        return
    for label, spec in resolve_all(results.config.policies, run_code=True).items():
        then, now = results.policy_files[label], spec.files()
        changed = sorted(file for file in then.keys() | now.keys() if then.get(file) != now.get(file))
        if changed and now:  # an unknown policy has no files; `evaluate` says more of it
            raise ValueError(
                f"policy {spec.name} is not the one that was measured: {', '.join(changed)} has another content "
                f"(SHA-256) than {results.path} records; put the old file back, or evaluate anew"
            )


def _flat(
    rows: Sequence[Mapping[str, Any]], bounds: Mapping[str, Mapping[str, Any] | None]
) -> dict[tuple[str, str], Any]:
    """Return everything that is compared by (place, name)."""
    flat: dict[tuple[str, str], Any] = {}
    for row in rows:
        place = f"{row['policy']}, {row['case']}, seed {row['seed']}"
        flat |= {(place, k): v for k, v in row.items() if k not in ("case", "policy", "seed", *CLOCK)}
    for policy, claimed in bounds.items():
        flat |= {(f"{policy}, certificate", k): v for k, v in (claimed or {}).items()}
    return flat


def _same(then: Any, now: Any) -> bool:
    if isinstance(then, int | float) and isinstance(now, int | float):
        return math.isclose(then, now, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
    return bool(then == now)


def _notes(then: Results, now: Mapping[str, Any]) -> list[str]:
    """Say what was another thing when the file was made; that alone is no difference."""
    made = {
        "commit": (then.commit, now["commit"]),
        "processor": (then.processor, now["machine"]["cpu"]),
        **{name: (then.versions.get(name), version) for name, version in now["versions"].items()},
    }
    notes = [f"{name}: {old} when measured, {new} now" for name, (old, new) in made.items() if old != new]
    if then.policy_files is None:
        notes.append("the file is older than digests of policies: whether their files are the same was not compared")
    return notes


def print_check(found: Check, console: Console) -> None:
    """Print what agrees or what differs, then the notes."""
    if found.differences:
        table = Table(box=box.SIMPLE_HEAD if console.is_terminal else None, pad_edge=False, padding=(0, 1, 0, 0))
        for heading in ("policy, case, seed", "number"):
            table.add_column(heading, no_wrap=True)
        for heading in ("recorded", "now", "relative"):
            table.add_column(heading, no_wrap=True, justify="right")
        for difference in found.differences[:SHOWN]:
            cells = (difference.place, difference.name, *map(_cell, (difference.recorded, difference.measured)))
            table.add_row(*map(Text, (*cells, _relative(difference))))
        console.print(table)
        left = len(found.differences) - SHOWN
        if left > 0:
            console.print(f"and {left} more", highlight=False)
        console.print(f"{len(found.differences)} values of {found.rows} rows differ", highlight=False)
    else:
        console.print(f"{found.numbers} numbers of {found.rows} rows agree", highlight=False)
    for note in found.notes:
        console.print(Text(f"note: {note}"))


def _cell(value: Any) -> str:
    return "-" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)[:40]


def _relative(difference: Difference) -> str:
    then, now = difference.recorded, difference.measured
    return f"{abs(now - then) / abs(then):.1g}" if isinstance(then, float) and isinstance(now, float) and then else ""
