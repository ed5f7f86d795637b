"""The last lines of `fuzzyarm evaluate`: who won each case, which policies are proven, and what to type next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import RESOLUTION, is_lost, millimetres

__all__ = ["verdict"]

_FEW = 3  # policies that a line names; of more it says how many


def verdict(
    rows: Sequence[Mapping[str, Any]],
    certificates: Mapping[str, str | None],
    folder: Path,
    files: int,
    titles: Mapping[str, str] | None = None,
) -> list[str]:
    """Return a line for each case, one about certificates and one about the next command.

    A case is won by the smallest rms tip error, over several seeds the smallest median, among the policies that never
    lost the path, see `metrics.is_lost`.

    Args:
        rows: of metrics, as in `Evaluation.rows`.
        certificates: by policy, in words; None without one.
        folder: that the evaluation was written to.
        files: how many files.
        titles: by name of the case; None: those of the two-joint arm.
    """
    known = {name: case.title for name, case in CASES.items()} if titles is None else titles
    cases = dict.fromkeys(row["case"] for row in rows)
    lines = [_won([row for row in rows if row["case"] == case], known.get(case, case)) for case in cases]
    there = shlex.quote(str(folder))
    return [*lines, _proven(certificates), f"{files} files in {there}; next: fuzzyarm report {there}"]


def _won(rows: Sequence[Mapping[str, Any]], title: str) -> str:
    """Return who won a case, given its rows and title."""
    lost = {row["policy"] for row in rows if is_lost(row)}
    errors = {
        policy: median(row["tip_error_rms_mm"] for row in rows if row["policy"] == policy)
        for policy in dict.fromkeys(row["policy"] for row in rows)
        if policy not in lost
    }
    if not errors:
        return f"{title}: no policy followed the path to its end"
    best = min(errors.values())
    winners = [policy for policy, error in errors.items() if error <= max(best, RESOLUTION)]
    after = f"; {_named(sorted(lost))} lost the path" if lost else ""
    verb = "followed" if len(errors) == 1 else "won" if len(winners) == 1 else "tie"
    return f"{title}: {_named(winners)} {verb}, rms tip error {millimetres(best)} mm{after}"


def _proven(certificates: Mapping[str, str | None]) -> str:
    proven = [policy for policy, text in certificates.items() if text is not None]
    others = f"; nothing of {len(certificates) - len(proven)} others" if 0 < len(proven) < len(certificates) else ""
    return f"Proven of the rigid arm: {_named(proven) or 'nothing'}{others}"


def _named(policies: Sequence[str]) -> str:
    """Return up to `_FEW` policies by name, and how many there are beyond."""
    return ", ".join(policies[:_FEW]) + (f" and {len(policies) - _FEW} more" if len(policies) > _FEW else "")
