"""The tables of all episodes that a batch of lanes may be in, below each other as the kernels read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.scenario import Scenario


@dataclasses.dataclass(frozen=True)
class Tables:
    """Scenarios and their schedules: one for a scenario with a reference, one per member of the family for others.

    Attributes:
        references: of each episode.
        schedules: one after the other.
        starts: (episodes, 7), what `lane_kernels.begin` has to know of each.
        table: (rows, 19), the episodes' tables below each other.
        firsts: (scenarios,) the first episode of each scenario.
    """

    references: tuple[JointReference, ...]
    schedules: tuple[Schedule, ...]
    starts: np.ndarray
    table: np.ndarray
    firsts: np.ndarray

    @classmethod
    def build(cls, scenarios: Sequence[Scenario], family: tuple[JointReference, ...], control_period: float) -> Tables:
        """Tabulate the scenarios' episodes every `control_period` [s]."""
        references: list[JointReference] = []
        schedules: list[Schedule] = []
        starts, firsts, row = [], [], 0
        for disturbance, reference in scenarios:
            firsts.append(len(schedules))
            payload, noise = disturbance.payload, disturbance.encoder_noise
            spread = (0.0, 0.0) if noise is None else (noise.position, noise.velocity)
            for member in family if reference is None else (reference,):
                schedule = Schedule.build(member, disturbance, control_period)
                last, at_tip = row + schedule.steps, float(payload.at == "tip")
                starts.append((row, last, payload.mass, at_tip, *spread, float(reference is None)))
                references.append(member)
                schedules.append(schedule)
                row = last + 1
        table = np.concatenate([schedule.table for schedule in schedules])
        return cls(tuple(references), tuple(schedules), np.array(starts), table, np.array(firsts))

    def followed_by(self, other: Tables) -> Tables:
        """Return these tables with others below; the episodes of these keep their places."""
        moved = other.starts.copy()
        moved[:, :2] += len(self.table)
        return Tables(
            self.references + other.references,
            self.schedules + other.schedules,
            np.concatenate([self.starts, moved]),
            np.concatenate([self.table, other.table]),
            np.concatenate([self.firsts, other.firsts + len(self.schedules)]),
        )
