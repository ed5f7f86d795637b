"""Numbers that depend on the deviations of a zonotope, up to some of their own.

    x - c = A ξ + W g + β,      ξ in a zonotope,   |g_i| <= 1,   |β| <= box.

A program that computes number after number is followed with small matrices A alone; the many columns of ξ are only
needed where a range is asked for, and at the end. Rounding of the products goes into the box (`enclosures.SLACK`).
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from flint import arb

from fuzzyarm.eval.certified.tip.enclosures import ROUND_UP, SLACK, centre, radius_of
from fuzzyarm.eval.certified.tip.zonotope import Zonotope, product, reach

__all__ = ["Forms"]


class Forms:
    """Numbers over a zonotope.

    Attributes:
        middle: c (n,).
        box: (n,).
    """

    def __init__(self, middle: np.ndarray, base: Zonotope) -> None:
        """Begin with the numbers of the zonotope themselves, which are counted from `middle`."""
        self._base, self._totals = base, base.totals()
        self.middle, self.box = middle, np.zeros(len(middle))
        self._map, self._own = np.eye(len(middle)), np.zeros((len(middle), 0))

    def copy(self) -> Forms:
        """Return numbers that can be extended apart from these."""
        return copy.copy(self)

    def sizes(self) -> np.ndarray:
        """Return bounds (n,) of |x - c| that are quick and wide."""
        return np.asarray(np.abs(self._map) @ self._totals + np.abs(self._own).sum(axis=1) + self.box)

    def largest(self) -> np.ndarray:
        """Return bounds (n,) of |x| that are quick and wide."""
        return np.asarray(np.abs(self.middle) + self.sizes())

    def spread(self, rows: np.ndarray) -> np.ndarray:
        """Return bounds of |r (x - c)| for rows (k, n)."""
        images = rows @ self._map
        size = reach(images, self._base.columns) + np.abs(images) @ self._base.box
        size += np.abs(rows @ self._own).sum(axis=1)
        return np.asarray((size + np.abs(rows) @ (self.box + SLACK * self.sizes())) * ROUND_UP)

    def extend(self, rows: np.ndarray, at: list[Any], rest: np.ndarray, own: np.ndarray | None = None) -> None:
        """Append numbers r x, with `rows` (k, n), up to a `rest` (k,).

        They are counted from the middles of the balls `at`. `own` (k, m) is what new numbers g in [-1, 1] add to them.
        """
        middle = np.array([centre(x) for x in at])
        missed = np.array([radius_of(x, c) for x, c in zip(at, middle.tolist(), strict=True)])
        fresh = np.zeros((len(rows), 0)) if own is None else own
        lost = np.abs(rows) @ (self.box + SLACK * self.sizes()) + rest + missed
        self.middle, self.box = np.concatenate([self.middle, middle]), np.concatenate([self.box, lost * ROUND_UP])
        self._map = np.vstack([self._map, rows @ self._map])
        above = np.zeros((len(self._own), fresh.shape[1]))
        self._own = np.block([[self._own, above], [rows @ self._own, fresh]])

    def over_base(self, which: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return A (k, numbers of the zonotope) of some numbers, and bounds (k,) of |x - c - A ξ|."""
        rest = np.abs(self._own[which]).sum(axis=1) + self.box[which] + SLACK * self.sizes()[which]
        return self._map[which].copy(), np.asarray(rest * ROUND_UP)

    def keep(self, which: slice | list[int]) -> None:
        """Forget all other numbers."""
        self.middle, self.box, self._map = self.middle[which], self.box[which], self._map[which]
        own = self._own[which]
        self._own = own[:, np.abs(own).sum(axis=0) > 0.0]

    def spelt_out(self) -> np.ndarray:
        """Return columns (n, k) that hold x - c: first those over the zonotope's, last those of the box."""
        box = self.box + np.abs(self._map) @ self._base.box + SLACK * self.sizes()
        return np.hstack([product(self._map, self._base.columns), self._own, np.diag(box * ROUND_UP)])

    def balls(self, which: slice | None = None) -> list[Any]:
        """Return c, of some of the numbers, as exact balls."""
        return [arb(x) for x in self.middle[which or slice(None)].tolist()]
