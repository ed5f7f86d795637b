"""What a policy believes of load and arm while it acts, sample by sample, with deviations.

A policy has beliefs if it has a method ``beliefs(state)``. Of what that returns these attributes are kept, each of
which may be missing, and each only with its standard deviation, ``force_deviation`` and so on: ``force`` (..., axes)
[N], ``payload`` (...) [kg], ``offset`` (..., n) [N m], ``lateness`` (...) [s], and ``factors``, by name (..., n).

It may also have ``diverged``, whether the estimate is given up; ``at_end``, by name whether an estimate stands at an
end of its range; and ``other_path``, whether this pass has left the path of the pass before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["DEVIATION", "NO_BELIEFS", "Believing"]

NO_BELIEFS = np.empty((0, 0))  # those of a policy that says nothing
DEVIATION = "_deviation"  # ending of the name of a standard deviation
_KEPT = ("force", "payload", "offset", "lateness")
_SINGLE = ("payload", "lateness")  # of the tip or the arm; the others are of axes or joints


def _columns_of(part: str, count: int) -> list[str]:
    """Return the names of the `count` numbers of a part: ``payload``, ``force_x``, ``stiffness_1``, ..."""
    if part in _SINGLE:
        return [part]
    return [f"{part}_{end}" for end in ("xyz"[:count] if part == "force" else range(1, count + 1))]


class Believing:
    """Notes what a policy believes after each of its actions."""

    def __init__(self, policy: Predictor) -> None:
        """Look for the policy's beliefs."""
        self.names: tuple[str, ...] = ()  # of the columns of `rows`; empty before the first action, or without beliefs
        self._beliefs = getattr(policy, "beliefs", None)
        self._rows: list[np.ndarray] = []
        self._diverged: int | None = None
        self._other_path: int | None = None
        self._ends: dict[str, int] = {}  # the first sample of each estimate that stood at an end
        self._at_last: list[str] = []

    def note(self, control_period: float) -> str:
        """Return in words: another path than before, estimates at an end of their range, divergence; or nothing."""
        said = []

        def at(sample: int) -> str:
            return f"{sample * control_period:.3f} s"

        if self._other_path is not None:
            said.append(
                f"its path differs from that of the pass before from {at(self._other_path)} on, "
                "and it no longer expects the forces of that"
            )
        if self._diverged is not None:
            said.append(
                f"its filter diverged, or its torques swung, at {at(self._diverged)}, and its fallback acted since"
            )
        if self._ends:
            ends = [
                f"{name.replace('_', ' ')} (first at {at(sample)}{', and at last' if name in self._at_last else ''})"
                for name, sample in self._ends.items()
            ]
            said.append(f"estimates that stood at an end of their range: {', '.join(ends)}")
        return "; ".join(said)

    def rows(self) -> np.ndarray:
        """Return what was noted, (samples, `names`); `NO_BELIEFS` of a policy that says nothing.

        A number that is not finite is nan, and every number from the sample on at which the filter diverged.
        """
        return np.array(self._rows) if self.names else NO_BELIEFS

    def add(self, memory: Any) -> None:
        """Note what the policy believes after it acted, given its state."""
        if self._beliefs is None:
            return
        beliefs = self._beliefs(memory)
        sample, parts = len(self._rows), _parts(beliefs)
        if not self._rows:
            columns = [_columns_of(name, value.size) for name, value, _ in parts]
            self.names = tuple(name for part in columns for name in (*part, *(one + DEVIATION for one in part)))
        if self._other_path is None and np.any(getattr(beliefs, "other_path", False)):
            self._other_path = sample
        if self._diverged is None and np.any(getattr(beliefs, "diverged", False)):
            self._diverged = sample
        row = np.concatenate([np.empty(0), *(numbers for _, *both in parts for numbers in both)])
        if self._diverged is None:
            self._at_last = [name for name, ended in getattr(beliefs, "at_end", {}).items() if np.any(ended)]
            for name in self._at_last:
                self._ends.setdefault(name, sample)
            row[~np.isfinite(row)] = np.nan
        else:
            row[:] = np.nan
        self._rows.append(row)


def _parts(beliefs: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return name, numbers and deviations of each part that is kept and there."""
    deviations = getattr(beliefs, f"factors{DEVIATION}", {})
    found = [(name, getattr(beliefs, name, None), getattr(beliefs, name + DEVIATION, None)) for name in _KEPT]
    found += [(name, value, deviations.get(name)) for name, value in getattr(beliefs, "factors", {}).items()]
    return [(name, np.ravel(a), np.ravel(b)) for name, a, b in found if a is not None and b is not None]
