"""The bound of the tip error at a sample, from the deviations of the links."""

from __future__ import annotations

import math

import numpy as np
from flint import arb

from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.envs.physics.readings import tip_point
from fuzzyarm.envs.physics.records import PerJoint
from fuzzyarm.eval.certified.tip.enclosures import ROUND_UP, SLACK, centre, largest
from fuzzyarm.eval.certified.tip.transition import LINK
from fuzzyarm.eval.certified.tip.zonotope import SOURCES, Zonotope

__all__ = ["tip_bound"]

DIRECTIONS = 48  # of the polygon around the tip's deviations; it is at most 0.06 % larger than they are
COARSE = 6  # every how many of them are looked at first


def tip_bound(state: np.ndarray, deviations: Zonotope, arm: Arm, wanted: list[float]) -> tuple[float, np.ndarray]:
    """Return a bound of the tip error [m] at a sample, and the shares of it by source: `SOURCES`, constants, centre.

    For the centre's state (8,), the deviations from it, the arm and the point (x, y) [m] that is asked for:

    |p(q) - p_r| <= |p(q_y) - p_r + J δq| + (L_1 δq_1² + L_2 (δq_1 + δq_2)²)/2. The zonotope J δq lies in the polygon
    that touches it in `DIRECTIONS` directions, and so does it with the centre's own error.
    """
    angles = PerJoint(*(arb(x) for x in state[LINK].tolist()))
    tip = tip_point(angles, arm)
    x, y = largest(tip.x - wanted[0]), largest(tip.y - wanted[1])
    offset = math.hypot(x, y) * ROUND_UP
    q12 = angles.joint1 + angles.joint2
    second = [-arm.length2 * q12.sin(), arm.length2 * q12.cos()]
    first = [-arm.length1 * angles.joint1.sin() + second[0], arm.length1 * angles.joint1.cos() + second[1]]
    jacobian = np.array([[centre(first[i]), centre(second[i])] for i in range(2)])
    turns = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    units = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    rows, links = units @ jacobian, deviations.part(LINK)
    aside = np.abs(units @ [centre(tip.x) - wanted[0], centre(tip.y) - wanted[1]])
    reach, reached = _reach(links, rows, aside)
    direction = int(np.argmax(np.where(reached, reach + aside, 0.0)))
    corner = (1.0 + 1e-12) / math.cos(0.5 * math.pi / DIRECTIONS)
    farthest = float((reach + aside)[direction])
    widest = min(offset + float(reach.max()) * corner, (farthest + SLACK * offset + 1e-15) * corner)
    radius = links.totals()
    lengths = [largest(arm.length1), largest(arm.length2)]
    bent = 0.5 * (lengths[0] * radius[0] ** 2 + lengths[1] * (radius[0] + radius[1]) ** 2)
    image = np.abs(rows[direction] @ links.columns)
    made = deviations.source >= 0
    shares = np.bincount(deviations.source[made], image[made], len(SOURCES))
    bound = (widest + float(bent)) * ROUND_UP
    return bound, np.array([*shares, image[~made].sum(), aside[direction]])


def _reach(links: Zonotope, rows: np.ndarray, aside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the reach in the directions that count, zero in the others, and which these are.

    The farthest point v of a symmetric set with reach h is seen from the nearest of the `COARSE` directions c under an
    angle of at most α = π COARSE/(2 DIRECTIONS), so h(c) >= |v| cos α >= h(c') cos α for all c'. Only around such c are
    the others needed. The two sets are that of the deviations and the one that the centre's own error makes of it.
    """
    coarse = np.arange(0, DIRECTIONS, COARSE)
    reach, reached = np.zeros(DIRECTIONS), np.zeros(DIRECTIONS, dtype=bool)
    reach[coarse], reached[coarse] = links.size(rows[coarse]), True
    least = (1.0 - 1e-9) * math.cos(0.5 * math.pi * COARSE / DIRECTIONS)
    far = [h >= least * h.max() for h in (reach[coarse], (reach + aside)[coarse])]
    around = np.add.outer(coarse[far[0] | far[1]], np.arange(-(COARSE // 2), COARSE // 2 + 1)) % DIRECTIONS
    fine = np.setdiff1d(around, coarse)
    reach[fine], reached[fine] = links.size(rows[fine]), True
    return reach, reached
