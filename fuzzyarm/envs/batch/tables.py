"""The tables of all episodes that a batch of lanes may be in, below each other as the kernels read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from fuzzyarm.envs.batch.schedule import Episode
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import JointReference

# A disturbance and a reference; None: a reference drawn from the randomisation's family.
Task = tuple[Disturbance, JointReference | None]


@dataclasses.dataclass(frozen=True)
class Tables:
    """Tasks and their episodes: one for a task with a reference of its own, one per member of the family for others.

    Attributes:
        references: of each episode.
        episodes: one after the other.
        starts: (episodes, 7), what `lane_kernels.begin` has to know of each.
        table: (rows, 19), the episodes' tables below each other.
        firsts: (tasks,) the first episode of each task.
    """

    references: tuple[JointReference, ...]
    episodes: tuple[Episode, ...]
    starts: np.ndarray
    table: np.ndarray
    firsts: np.ndarray

    @classmethod
    def build(cls, tasks: Sequence[Task], family: tuple[JointReference, ...], control_period: float) -> Tables:
        """Tabulate the tasks' episodes every `control_period` [s]."""
        references: list[JointReference] = []
        episodes: list[Episode] = []
        starts, firsts, row = [], [], 0
        for disturbance, reference in tasks:
            firsts.append(len(episodes))
            payload, noise = disturbance.payload, disturbance.encoder_noise
            spread = (0.0, 0.0) if noise is None else (noise.position, noise.velocity)
            for member in family if reference is None else (reference,):
                episode = Episode.build(member, disturbance, control_period)
                last, at_tip = row + episode.steps, float(payload.at == "tip")
                starts.append((row, last, payload.mass, at_tip, *spread, float(reference is None)))
                references.append(member)
                episodes.append(episode)
                row = last + 1
        table = np.concatenate([episode.table for episode in episodes])
        return cls(tuple(references), tuple(episodes), np.array(starts), table, np.array(firsts))

    def followed_by(self, other: Tables) -> Tables:
        """Return these tables with others below; the episodes of these keep their places."""
        moved = other.starts.copy()
        moved[:, :2] += len(self.table)
        return Tables(
            self.references + other.references,
            self.episodes + other.episodes,
            np.concatenate([self.starts, moved]),
            np.concatenate([self.table, other.table]),
            np.concatenate([self.firsts, other.firsts + len(self.episodes)]),
        )
