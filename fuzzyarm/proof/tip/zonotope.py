"""The set of deviations at a sample: a zonotope and a box, in floats with an allowance for rounding.

    x = Z g + β,      |g_i| <= 1,   |β| <= box;       |r x| <= Σ_i |(r Z)_i| + |r| box   for a row r.

The first columns are those of the uncertain constants, whose g_i are the same at every instant. The others come from
the disturbances in the periods so far, each from one source. Old columns from one source are merged into a
parallelepiped that encloses them, with one column for each of the numbers in x.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.proof.tip.enclosures import ROUND_UP, SLACK

__all__ = ["SOURCES", "Zonotope", "merged", "product", "reach"]

SOURCES = ("friction", "nonlinearity", "parameter products", "force", "law and noise", "rounding", "start of the lap")
"""The sources of all columns except those of the uncertain constants."""

_BOX_EVERY = 5  # periods after which the box becomes columns; until then it grows with |Φ|
_MOST, _KEPT = 720, 360  # columns for each entry of x at which old ones are merged, and how many are not merged
_NARROW, _FEWER = 1e-6, 9  # totals below which a ninth of these numbers is enough
_FEW = 2000  # columns that remain separate in `condensed`
_WORK = 250_000  # multiplications at a time, too few for a linear algebra library to start threads


class Zonotope:
    """A zonotope of deviations x = Z g + β, |g_i| <= 1, |β| <= box; see the module."""

    def __init__(self, numbers: int, constants: int) -> None:
        """Start with x = 0, of `numbers` entries, and a zero column for each of the uncertain `constants`."""
        self.columns = np.zeros((numbers, constants))  # Z
        self.source = -1 - np.arange(constants)  # of each column, an index of `SOURCES`; -1 - i for the constant i
        self.box = np.zeros(numbers)
        self._constants, self._age = constants, 0
        self._totals: np.ndarray | None = None  # cached for a part, which does not change

    def add(self, columns: np.ndarray, source: int | np.ndarray) -> None:
        """Add columns (entries of x, n), all from one source, an index of `SOURCES`, or each from its own (n,)."""
        used = columns.any(axis=0)
        self.columns = np.hstack([self.columns, columns[:, used]])
        self.source = np.concatenate([self.source, np.broadcast_to(source, used.shape)[used]])

    def part(self, numbers: slice) -> Zonotope:
        """Return the zonotope of some entries of x; its columns are views, so it must not be changed."""
        part = Zonotope(0, self._constants)
        part.columns, part.source, part.box = self.columns[numbers], self.source, self.box[numbers]
        part._totals = part.totals()
        return part

    def totals(self) -> np.ndarray:
        """Return upper bounds on the entries of |x|, in the shape of x."""
        if self._totals is not None:
            return self._totals
        return np.asarray((np.abs(self.columns).sum(axis=1) + self.box) * ROUND_UP)

    def size(self, rows: np.ndarray, extra: np.ndarray | None = None) -> np.ndarray:
        """Return bounds (n,) on |r x| for n rows r; `extra` (n, constants) is added to the constants' part of r Z."""
        others = reach(rows, self.columns[:, self._constants :])
        constants = rows @ self.columns[:, : self._constants] + (0.0 if extra is None else extra)
        slack = np.abs(rows) @ (self.box + SLACK * self.totals())
        return np.asarray((others + np.abs(constants).sum(axis=1) + slack) * ROUND_UP)

    def tidy(self, box_source: int) -> None:
        """Turn the box into columns at each `_BOX_EVERY`-th call, and merge old columns if there are too many.

        `box_source`, an index of `SOURCES`, is the source of the columns made from the box.
        """
        self._age += 1
        if self._age % _BOX_EVERY == 0:
            self.add(np.diag(self.box), box_source)
            self.box = np.zeros_like(self.box)
        numbers, fewer = len(self.box), _FEWER if self.totals().max() < _NARROW else 1
        if self.columns.shape[1] <= _MOST * numbers // fewer:
            return
        first, last = self._constants, self.columns.shape[1] - _KEPT * numbers // fewer
        old, source = self.columns[:, first:last], self.source[first:last]
        parts, labels = [], []
        for label in np.unique(source):
            block, missed = merged(old[:, source == label])
            self.box += missed
            parts.append(block)
            labels.append(np.full(block.shape[1], label))
        self.columns = np.hstack([self.columns[:, :first], *parts, self.columns[:, last:]])
        self.source = np.concatenate([self.source[:first], *labels, self.source[last:]])

    def condensed(self) -> tuple[np.ndarray, np.ndarray]:
        """Return columns (s, n) and a box (s,) that enclose this set of x (s,); s columns replace all small ones."""
        columns, totals = self.columns, self.totals()
        box = self.box + len(self.box) * SLACK * totals
        if columns.shape[1] <= _FEW + len(columns):
            return columns, box
        order = np.argpartition((1.0 / np.where(totals > 0.0, totals, 1.0)) @ np.abs(columns), -_FEW)
        rest, missed = merged(columns[:, order[:-_FEW]])
        return np.hstack([columns[:, order[-_FEW:]], rest]), (box + missed) * ROUND_UP


def product(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return matrix (m, n) times columns (n, k), block by block."""
    made = np.empty((len(matrix), columns.shape[1]))
    for block in _blocks(len(matrix), columns):
        np.matmul(matrix, columns[:, block], out=made[:, block])
    return made


def reach(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return Σ_j |P_ij| (m,) of the product P = matrix (m, n) times columns (n, k)."""
    total = np.zeros(len(matrix))
    for block in _blocks(len(matrix), columns):
        image = matrix @ columns[:, block]
        total += np.abs(image, out=image).sum(axis=1)
    return total


def _blocks(rows: int, columns: np.ndarray) -> list[slice]:
    step = max(_WORK // max(rows * len(columns), 1), 1)
    return [slice(start, start + step) for start in range(0, columns.shape[1], step)]


def merged(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return n columns (n, n) and a box (n,) that enclose the zonotope of many columns (n, k).

    Z g = Q (Qᵀ Z) g + (Z - Q Qᵀ Z) g for any Q. The columns of Q are the principal directions of Z, in units in which
    the rows are of one size.
    """
    units = np.abs(columns).sum(axis=1)
    units[units == 0.0] = 1.0
    blocks, unit = _blocks(len(columns), columns), units[:, np.newaxis]
    turn = np.linalg.eigh(sum((part := columns[:, block] / unit) @ part.T for block in blocks))[1]
    Q, inverse = unit * turn, turn.T / units
    sizes = reach(inverse, columns) * ROUND_UP
    rounding = np.abs(Q) @ np.abs(inverse) @ np.abs(columns).sum(axis=1) + np.abs(Q) @ sizes
    missed = sum(np.abs(columns[:, block] - Q @ (inverse @ columns[:, block])).sum(axis=1) for block in blocks)
    return Q * sizes, np.asarray(missed * ROUND_UP + SLACK * rounding)
