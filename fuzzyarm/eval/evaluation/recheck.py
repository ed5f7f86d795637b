"""Rerun of an evaluation from its ``results.json``, with a comparison of every number."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from rich.console import Console
from rich.text import Text

from fuzzyarm.common.checks import listed
from fuzzyarm.common.console import Sheet
from fuzzyarm.eval.declarations import unrelated
from fuzzyarm.eval.episodes.metrics import METRICS
from fuzzyarm.eval.evaluation.results_file import Results, same
from fuzzyarm.eval.evaluation.run import Evaluation, evaluate
from fuzzyarm.policies import found_again, resolve_all

__all__ = ["print_comparison", "recheck_results"]

_SHOWN = 20  # differences in the table
_WIDEST = 40  # characters of a text in the table


class _Difference(NamedTuple):
    """A value that differs from the recorded one; None where a value is missing."""

    place: str  # the episode, or the policy whose certificate it is
    name: str  # of the metric
    recorded: Any  # in the file
    measured: Any  # now


@dataclasses.dataclass(frozen=True)
class _Comparison:
    """The outcome of a recheck."""

    numbers: int  # how many numbers were compared
    rows: int  # in how many episodes
    differences: list[_Difference]
    notes: list[str]  # in words: commit, processor and versions that differ now; they do not count as differences


def recheck_results(
    results: Results, code: Sequence[str] = (), progress: Callable[[], None] = lambda: None
) -> _Comparison:
    """Run an evaluation again and compare; `progress` is called after each episode.

    A results file alone runs no code: `code` lists the permitted policies ``package.module:factory`` and the new paths
    of moved policy files.

    ValueError names code that only `code` or only the file lists, and a policy that is unknown or has changed since.
    """
    if others := unrelated(f"{results.path} contains results of code", results.config.policies, code):
        raise ValueError(
            f"--policy {' '.join(others)}: with --check, --policy only permits code (package.module:factory) that the "
            "results name, or gives the new path of a policy's file; the policies of "
            f"{results.path} are {', '.join(results.config.policies)}"
        )
    names = found_again(results.config.policies, results.made_with["policy_files"], code, results.path.parent)
    _check_files(results, names)
    fresh = evaluate(dataclasses.replace(results.config, policies=names), progress)
    old, new = _flat(results), _flat(fresh)
    return _Comparison(
        numbers=sum(not isinstance(value, str | bool) for value in old.values()),
        rows=len(results.rows),
        differences=[
            _Difference(*key, old.get(key), new.get(key))
            for key in dict.fromkeys([*old, *new])
            if not same(old.get(key), new.get(key), relative=1e-6, absolute=1e-9)
        ],
        notes=_notes(results.made_with, fresh.made_with),
    )


def _check_files(results: Results, names: Sequence[str]) -> None:
    """Raise ValueError if the files of a policy are no longer those that were evaluated."""
    for label, spec in resolve_all(names, run_code=True).items():
        then, now = results.made_with["policy_files"][label], spec.files()
        changed = {file for file in then.keys() | now.keys() if then.get(file) != now.get(file)}
        if changed and now:  # an unknown policy has no files; the error of `evaluate` says more
            raise ValueError(
                f"policy {spec.name} has changed since it was measured: the SHA-256 of {listed(changed)} differs from "
                f"that in {results.path}. Restore the file, give its path with --policy PATH, or evaluate again"
            )


def _flat(evaluation: Evaluation) -> dict[tuple[str, str], Any]:
    """Return the values of an evaluation that are compared, by place and name as in `_Difference`."""
    flat: dict[tuple[str, str], Any] = {}
    not_compared = {"case", "policy", "seed", *(name for name, metric in METRICS.items() if not metric.reproducible)}
    for row in evaluation.rows:
        place = f"{row['policy']}, {row['case']}, seed {row['seed']}"
        flat |= {(place, name): value for name, value in row.items() if name not in not_compared}
    for policy, claimed in evaluation.bounds.items():
        flat |= {(f"{policy}, certificate", k): v for k, v in (claimed or {}).items()}
    return flat


def _notes(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return a note on each of commit, processor and versions that differs between the file and this process."""
    made = {
        "commit": (then["commit"], now["commit"]),
        "processor": (then["machine"]["cpu"], now["machine"]["cpu"]),
        **{name: (then["versions"].get(name), version) for name, version in now["versions"].items()},
    }
    return [f"{name}: {old} when measured, {new} now" for name, (old, new) in made.items() if old != new]


def print_comparison(found: _Comparison, console: Console) -> None:
    """Print the result of the comparison, then the notes."""
    lines = [f"{found.numbers} numbers agree (rows: {found.rows})"]
    if found.differences:
        headings = ["policy, case, seed", "number", "recorded", "now", "relative"]
        cells = [
            (*one[:2], _cell(one.recorded), _cell(one.measured), _relative(one)) for one in found.differences[:_SHOWN]
        ]
        Sheet(headings, cells, left=(0, 1)).print(console)
        left = len(found.differences) - _SHOWN
        lines = [f"and {left} more"] if left > 0 else []
        lines.append(f"{len(found.differences)} values differ (rows: {found.rows})")
    for line in [*lines, *(f"note: {note}" for note in found.notes)]:
        console.print(Text(line))


def _cell(value: Any) -> str:
    return "-" if value is None else f"{value:.10g}" if isinstance(value, float) else str(value)[:_WIDEST]


def _relative(difference: _Difference) -> str:
    then, now = difference.recorded, difference.measured
    return f"{abs(now - then) / abs(then):.1g}" if isinstance(then, float) and isinstance(now, float) and then else ""
