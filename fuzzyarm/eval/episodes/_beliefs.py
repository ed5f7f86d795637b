"""A policy's estimates of load and arm while it acts, sample by sample, with standard deviations.

A policy has beliefs if it has a method ``beliefs(state)``. Each of these attributes of the returned object is optional,
and is kept only with its standard deviation, ``force_deviation`` and so on: ``force`` (..., axes) [N], ``payload``
(...) [kg], ``offset`` (..., n) [N m], the delay ``lateness`` (...) [s], and ``factors``, which maps names
of parameters to factors (..., n) on their values.

It may also have ``diverged``, true once the estimate has diverged; ``at_end``, which maps the name of an estimate to
whether it is at a limit of its range; and ``other_path``, true once the path deviates from that of the previous pass.
"""

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["DEVIATION", "NO_BELIEFS", "Believing"]

NO_BELIEFS = np.empty((0, 0))  # the rows of a policy without beliefs
DEVIATION = "_deviation"  # suffix of the name of a standard deviation
_KEPT = ("force", "payload", "offset", "lateness")
_SINGLE = ("payload", "lateness")  # scalars; the others have one entry per axis or joint
_EVENTS = {
    "other_path": (
        "from {} on, its path differs from that of the previous pass, and it no longer expects the forces of that pass"
    ),
    "diverged": "at {}, its filter diverged or its torques oscillated, and its fallback has acted since",
}


class Believing:
    """A recorder of a policy's estimates after each of its actions."""

    def __init__(self, policy: Predictor) -> None:
        """Prepare to record the estimates of this policy."""
        self.names: tuple[str, ...] = ()  # of the columns of `rows`; empty before the first action or without beliefs
        self._beliefs = getattr(policy, "beliefs", None)
        self._rows: list[np.ndarray] = []
        self._first: dict[str, int] = {}  # the first sample of each of `_EVENTS`
        self._ends: dict[str, int] = {}  # the first sample of each estimate at an end of its range
        self._at_last: list[str] = []  # the estimates at an end of their range in the last sample before a divergence

    def note(self, control_period: float) -> str:
        """Return text on the events so far: a path unlike the last pass, a divergence, estimates that reached a limit.

        Their times are in s, as is the control period.
        """
        at = {name: f"{sample * control_period:.3f} s" for name, sample in (self._first | self._ends).items()}
        said = [text.format(at[name]) for name, text in _EVENTS.items() if name in self._first]
        ends = [
            f"{name.replace('_', ' ')} (first at {at[name]}{', and at the end' if name in self._at_last else ''})"
            for name in self._ends
        ]
        if ends:
            said.append(f"estimates that reached an end of their range: {', '.join(ends)}")
        return "; ".join(said)

    def rows(self) -> np.ndarray:
        """Return the recorded values (samples, columns `names`), or `NO_BELIEFS` for a policy without beliefs.

        A value that is not finite is replaced by nan, and so is every value after the filter diverges.
        """
        return np.array(self._rows) if self.names else NO_BELIEFS

    def add(self, memory: Any) -> None:
        """Record the policy's estimates from the state that it returned with its action."""
        if self._beliefs is None:
            return
        beliefs = self._beliefs(memory)
        sample, parts = len(self._rows), _parts(beliefs)
        if not self._rows:
            columns = [_columns_of(name, value.size) for name, value, _ in parts]
            self.names = tuple(name for part in columns for name in (*part, *(one + DEVIATION for one in part)))
        for name in _EVENTS:
            if np.any(getattr(beliefs, name, False)):
                self._first.setdefault(name, sample)
        row = np.concatenate([np.empty(0), *(numbers for _, *both in parts for numbers in both)])
        if "diverged" in self._first:
            row[:] = np.nan
        else:
            row[~np.isfinite(row)] = np.nan
            self._at_last = [name for name, ended in getattr(beliefs, "at_end", {}).items() if np.any(ended)]
            for name in self._at_last:
                self._ends.setdefault(name, sample)
        self._rows.append(row)


def _columns_of(part: str, count: int) -> list[str]:
    """Return the column names of an estimate with `count` entries: ``payload``, ``force_x``, ``stiffness_1``, ..."""
    if part in _SINGLE:
        return [part]
    return [f"{part}_{end}" for end in ("xyz"[:count] if part == "force" else range(1, count + 1))]


def _parts(beliefs: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return the name, value and standard deviation of each estimate that has both."""
    deviations = getattr(beliefs, f"factors{DEVIATION}", {})
    found = [(name, getattr(beliefs, name, None), getattr(beliefs, name + DEVIATION, None)) for name in _KEPT]
    found += [(name, value, deviations.get(name)) for name, value in getattr(beliefs, "factors", {}).items()]
    return [(name, np.ravel(a), np.ravel(b)) for name, a, b in found if a is not None and b is not None]
