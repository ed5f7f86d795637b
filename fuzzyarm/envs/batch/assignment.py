"""Which schedule each lane of a batch is in: its own, or for an episode one that a reset asked for."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.batch.layout import CLOCK
from fuzzyarm.envs.batch.tables import Tables

__all__ = ["Assignment"]


class Assignment:
    """The schedules of the lanes, by number.

    Args:
        own: tables of the lanes' own scenarios, and by lane the schedule (lanes,) its episodes begin with and its
            payload's place (lanes,), see `tables.tabulated`.

    Attributes:
        own: those tables.
        own_places: schedule and payload's place by lane, in the lanes' own scenarios.
        tables: those of all scenarios that a lane is in; the lanes' own come first.
    """

    def __init__(self, own: tuple[Tables, np.ndarray, np.ndarray]) -> None:
        """Begin with every lane in its own scenario."""
        self.own, *self.own_places = own
        self.all_return()

    def all_return(self) -> None:
        """Put every lane into its own scenario."""
        self.tables = self.own
        self._start_of, self._place_of = self.own_places

    def back(self, lanes: np.ndarray) -> None:
        """Put these lanes (n,) into their own scenarios; their last ones keep their tables."""
        self._start_of[lanes], self._place_of[lanes] = (places[lanes] for places in self.own_places)

    def leave(self, lanes: np.ndarray, clock: np.ndarray) -> None:
        """Put these lanes (n,) into their own scenarios, and drop the tables that no lane is in any longer.

        The rows in `clock` (numbers of `Clock`, lanes) move with the tables.
        """
        if len(lanes) == len(self._start_of):
            self.all_return()
            return
        self.back(lanes)
        visiting = self.visiting()
        own, places = len(self.own.firsts), self._start_of[visiting]
        self.tables, self._start_of[visiting], moved = self.tables.keeping(own, places)
        clock[[[CLOCK.row], [CLOCK.first], [CLOCK.last]], visiting] += moved

    def visit(self, lanes: np.ndarray, scenarios: tuple[Tables, np.ndarray, np.ndarray]) -> None:
        """Put these lanes (n,) into other scenarios, given as the lanes' own ones were."""
        tables, start_of, place_of = scenarios
        if self._start_of is self.own_places[0]:
            self._start_of, self._place_of = (places.copy() for places in self.own_places)
        self._start_of[lanes], self._place_of[lanes] = start_of + len(self.tables.schedules), place_of
        self.tables = self.tables.followed_by(tables)

    def visiting(self) -> np.ndarray:
        """Return the lanes (n,) that are in another scenario than their own."""
        return np.flatnonzero(self._start_of >= len(self.own.schedules))

    def places(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return schedules (n,) and payload's places (n,) of these lanes (n,)."""
        return self._start_of[lanes], self._place_of[lanes]
