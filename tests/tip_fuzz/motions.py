"""Motions of plants under a sampled policy, in lanes: the law of the package, all else from `arm`."""

import math
from typing import NamedTuple

import numpy as np

from fuzzyarm.policies.tip_bound import PERIOD

from .arm import Node, hold
from .sets import arm_of, policy_of, schedule_of

SUBSTEPS = 12  # of a control step


class Motion(NamedTuple):
    """The motion of one plant."""

    nodes: list[list[Node]]  # of every control step
    torques: np.ndarray  # held in each control step (steps, 2) [N m]
    tip_errors: np.ndarray  # at the end of each control step (steps,) [m]


def even_stops(steps, count=SUBSTEPS):
    """Return the ends of equal parts of each control step [s]."""
    return [[PERIOD * (i + 1) / count for i in range(count)]] * steps


def simulated(claim, samples, stops, refined=1, later=None):
    """Return the motions of plants for the first control steps of a claim, or of a later lap.

    The policy is the package's own: the proof states the laws again, so that the shipped policy is the right one to
    compare with. Reference and tip force are read from the package's schedule, as the claim is about these. `stops` are
    the times in each control step at which there is a node, with `refined` steps between two of them, see `hold`.
    """
    problem, plants, policy = later.problem if later else schedule_of(claim), claim.plants, policy_of(claim.policy)
    table, law, lanes = problem.schedule, problem.law, range(len(samples))
    arms = [arm_of(claim, sample) for sample in samples]
    if later:
        centre, (constants, columns) = np.concatenate(later.start[:3]), later.start[3:]
    else:
        centre = np.concatenate([problem.start, np.zeros(law.memory)])
        constants = columns = np.zeros((len(centre), 0))
        if claim.start is not None:
            columns = claim.start.columns(2, len(centre), law.memory)
    shares = [[s.share(plants, p.kind, p.joint) for p in problem.plant.parameters if later] for s in samples]
    begun = [
        centre + constants @ np.array(share) + columns @ sample.start[: columns.shape[1]]
        for share, sample in zip(shares, samples, strict=True)
    ]
    states = [tuple(start[:8].tolist()) for start in begun]
    nodes = [[] for _ in lanes]
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
        asked = np.array(asked, dtype=float) + np.array(problem.guest) * [sample.guest[number] for sample in samples]
        acting, waiting = asked if waiting is None or not plants.late else waiting, asked
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
            errors[i, number] = math.dist(arm.tip(*states[i][2:4]), table.targets[k + 1, :2])
    return [Motion(nodes[i], torques[i], errors[i]) for i in lanes]
