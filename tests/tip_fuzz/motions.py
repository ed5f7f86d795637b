"""Motions of plants under a sampled policy, in lanes: the law of the package, all else from `arm`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fuzzyarm.policies.tip_bound import PERIOD, TipClaim

from .arm import Node, hold
from .sets import Later, Sample, arm_of, policy_of, schedule_of

SUBSTEPS = 12  # of a control step


class Motion(NamedTuple):
    """The motion of one plant."""

    nodes: list[list[Node]]  # of every control step
    torques: np.ndarray  # held in each control step (steps, 2) [N m]
    tip_errors: np.ndarray  # at the end of each control step (steps,) [m]


def even_stops(steps: int, count: int = SUBSTEPS) -> list[list[float]]:
    """Return the ends of equal parts of each control step [s]."""
    return [[PERIOD * (i + 1) / count for i in range(count)]] * steps


def simulated(
    claim: TipClaim,
    samples: list[Sample],
    stops: Sequence[Sequence[float]],
    refined: int = 1,
    later: Later | None = None,
) -> list[Motion]:
    """Return the motions of plants for the first control steps of a claim, or of a later lap.

    The policy is the package's own: the proof states the laws again, so that the shipped policy is the right one to
    compare with. Reference and tip force are read from the package's schedule, as the claim is about these. `stops` are
    the times in each control step at which there is a node, with `refined` steps between two of them, see `hold`.
    """
    problem, plants, policy = later.problem if later else schedule_of(claim), claim.plants, policy_of(claim.policy)
    table, law, lanes = problem.schedule, problem.law, range(len(samples))
    arms = [arm_of(claim, sample) for sample in samples]
    if later:
        shares = [[s.share(plants, p.kind, p.joint) for p in problem.plant.parameters] for s in samples]
        centre, (constants, columns) = np.concatenate(later.start[:3]), later.start[3:]
        begun = [
            centre + constants @ np.array(share) + columns @ sample.start[: columns.shape[1]]
            for share, sample in zip(shares, samples, strict=True)
        ]
    else:
        centre = np.concatenate([problem.start, np.zeros(law.memory)])
        box = np.zeros((len(centre), 0)) if claim.start is None else claim.start.columns(2, len(centre), law.memory)
        begun = [centre + box @ sample.start[: box.shape[1]] for sample in samples]
    states = [tuple(start[:8].tolist()) for start in begun]
    nodes: list[list[list[Node]]] = [[] for _ in lanes]
    torques, errors = np.zeros((len(samples), len(stops), 2)), np.zeros((len(samples), len(stops)))
    memory = np.repeat(law._held[[table.steps if later else 0], 0], len(samples), axis=0)
    memory[:, law.remembered] = [start[8 : 8 + law.memory] for start in begun]
    waiting = np.array([start[8 + law.memory :] for start in begun]) if later and plants.late else None
    spread = np.repeat(plants.noise, 2)
    for number, times in enumerate(stops):
        k = number % table.steps  # the motion is repeated
        measured = np.array(states)[:, [0, 1, 4, 5]] + spread * np.array([sample.noise[number] for sample in samples])
        seen = np.hstack([measured, np.repeat(table.references[k : k + 1], len(samples), axis=0)])
        asked, memory = policy.predict(seen, memory)
        asked = np.array(asked, dtype=float) + np.array(problem.guest) * np.array(
            [sample.guest[number] for sample in samples]
        )
        acting = asked if waiting is None or not plants.late else waiting
        waiting = asked
        for i in lanes:
            sample, arm = samples[i], arms[i]
            factor = sample.force + plants.force_swing * sample.swing[number]
            x, y, dx, dy = (factor * table.forces[k]).tolist()
            beside = plants.force_course * sample.course[number]
            line = x - 0.5 * dx + beside[0], y - 0.5 * dy + beside[1], dx / PERIOD, dy / PERIOD
            given = (sample.friction[number] * arm.static).tolist()
            found = list(hold(arm, states[i], acting[i].tolist(), line, times, refined, given))
            nodes[i].append(found)
            states[i], torques[i, number] = found[-1].state, acting[i]
            tip, wanted = arm.tip(*states[i][2:4]), table.targets[k + 1, :2]
            errors[i, number] = np.hypot(tip[0] - wanted[0], tip[1] - wanted[1])
    return [Motion(nodes[i], torques[i], errors[i]) for i in lanes]
