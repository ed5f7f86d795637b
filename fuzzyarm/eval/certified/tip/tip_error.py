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
    rows = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ jacobian
    links = deviations.part(LINK)
    reach = links.size(rows)
    aside = np.abs(
        np.stack([np.cos(turns), np.sin(turns)], axis=1) @ [centre(tip.x) - wanted[0], centre(tip.y) - wanted[1]]
    )
    direction = int(np.argmax(reach + aside))
    corner = (1.0 + 1e-12) / math.cos(0.5 * math.pi / DIRECTIONS)
    widest = min(offset + float(reach.max()) * corner, float((reach + aside).max() + SLACK * offset + 1e-15) * corner)
    radius = links.totals()
    lengths = [largest(arm.length1), largest(arm.length2)]
    bent = 0.5 * (lengths[0] * radius[0] ** 2 + lengths[1] * (radius[0] + radius[1]) ** 2)
    image = np.abs(rows[direction] @ links.columns)
    shares = [float(image[deviations.source == i].sum()) for i in range(len(SOURCES))]
    shares += [float(image[deviations.source < 0].sum()), float(aside[direction])]
    return (widest + float(bent)) * ROUND_UP, np.array(shares)
