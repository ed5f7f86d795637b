"""The results of a sweep as arrays: the plants, and a few metrics of each episode."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from fuzzyarm.eval.sweep.quantities import plant_record

__all__ = ["METRICS", "SweepResults"]


@dataclasses.dataclass(frozen=True)
class SweepResults:
    """Some plants of a sweep, or all, and the metrics of their episodes.

    Attributes:
        plants: (n,) records of `quantities.plant_record`.
        max_mm: (policies, cases, n) largest tip error [mm].
        rms_mm: (policies, cases, n) root mean square tip error [mm].
        seconds: (policies, cases, n) duration of the episode [s].
        completed: (policies, cases, n) whether the episode lasted to the end of the reference.
    """

    plants: np.ndarray
    max_mm: np.ndarray
    rms_mm: np.ndarray
    seconds: np.ndarray
    completed: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[SweepResults]) -> SweepResults:
        """Return the results of several chunks as one."""
        arrays = {name: np.concatenate([part.arrays()[name] for part in parts], axis=-1) for name in _FIELDS}
        return cls(**arrays)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name, as they are in a file."""
        return {name: getattr(self, name) for name in _FIELDS}

    def episodes(self, policy: int, case: int) -> SweepResults:
        """Return the results of one policy in one case by their places in the sweep; every array is (n,)."""
        metrics = {name: getattr(self, name)[policy, case] for name in METRICS}
        return SweepResults(self.plants, **metrics)

    def fits(self, policies: int, cases: int, plants: int, joints: int) -> bool:
        """Return whether the arrays have the shapes and types of a sweep of this size, of arms of so many joints."""
        shape = policies, cases, plants
        return (
            self.plants.dtype == plant_record(joints)
            and self.plants.shape == (plants,)
            and all(getattr(self, name).shape == shape for name in METRICS)
            and all(getattr(self, name).dtype == (bool if name == "completed" else float) for name in METRICS)
        )

    @property
    def errors(self) -> np.ndarray:
        """Largest tip error [mm], of the shape of `max_mm`; inf where the episode ended early."""
        return np.where(self.completed, self.max_mm, np.inf)


_FIELDS = tuple(field.name for field in dataclasses.fields(SweepResults))
METRICS = tuple(name for name in _FIELDS if name != "plants")
"""Names of the metrics of an episode."""
