"""A bound on the tip error between two samples, from the bounds at both samples and on the accelerations.

For e(t) = p(q(t)) - p_r(t) and t in [0, T], linear interpolation errs by at most T²/8 sup |ë|, so that

    |e(t)| <= max(|e(0)|, |e(T)|) + T²/8 sup |ë|,

because q̇ is absolutely continuous and q̈ essentially bounded on a tube. p̈(q) and p̈_r are evaluated on balls.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import arb, arb_series, ctx

from fuzzyarm.envs.scenario.paths import Placed, Spline, TipPath
from fuzzyarm.envs.scenario.reference import PathReference, time_law
from fuzzyarm.proof.tip._defects import PeriodMotion
from fuzzyarm.proof.tip.centre import Segment
from fuzzyarm.proof.tip.enclosures import ROUND_UP, between, largest, low_high
from fuzzyarm.proof.tip.period import Closed
from fuzzyarm.proof.tip.plant import BallPlant

__all__ = ["between_samples"]

_PARTS = 4  # of a segment, each evaluated on separate balls
_CLOCK = 1e-14  # largest relative error of a sample's instant in floats


def between_samples(
    reference: PathReference,
    begin: float,
    period: float,
    segments: Sequence[Segment],
    tube: Sequence[Closed],
    plant: BallPlant,
) -> float:
    """Return a bound on T²/8 sup |ë| [m], by which |e| in a period may exceed its values at the period's ends.

    The period begins at `begin` [s]; `tube` has the tube on each of its `segments`.
    """
    sizes, now = [], begin
    for segment, closed in zip(segments, tube, strict=True):
        motion, part = PeriodMotion(segment.angles, segment.duration, plant.physics), segment.duration / _PARTS
        at = plant.layout.rows
        rows = [closed.tube[kind].tolist() for kind in (at.link, at.d_link, at.link_acceleration)]
        for i in range(_PARTS):
            s = between(2.0 * i / _PARTS - 1.0, 2.0 * (i + 1) / _PARTS - 1.0)
            q, dq, ddq = (
                [signal.at(s) + arb(0.0, radius) for signal, radius in zip(kind, radii, strict=True)]
                for kind, radii in zip(motion.links, rows, strict=True)
            )
            found, wanted = _tip_acceleration(q, dq, ddq, plant), _wanted(reference, now + i * part, part)
            sizes.append(math.hypot(*(largest(a - b) for a, b in zip(found, wanted, strict=False))))  # a plane has no z
        now += segment.duration
    return period**2 / 8.0 * max(sizes) * ROUND_UP**4


def _tip_acceleration(q: Sequence[Any], dq: Sequence[Any], ddq: Sequence[Any], plant: BallPlant) -> list[Any]:
    """Return the tip's acceleration p̈ [m/s²], twice the coefficient of t² in p(q + q̇ t + q̈ t²/2)."""
    ctx.cap = 3
    course = (arb_series([a, b, c / 2]) for a, b, c in zip(q, dq, ddq, strict=True))
    return [2 * axis[2] for axis in plant.physics.tip(plant.physics.PerJoint(*course), plant.exact)]


def _wanted(reference: PathReference, begin: float, period: float) -> list[Any]:
    """Enclose p̈_r = p'' ṡ² + p' s̈ [m/s²] by axis, in `period` from `begin` [s]; 0 before and after the motion."""
    slack = _CLOCK * (begin + period)
    low, high = ((arb(t) / arb(reference.duration)) for t in (begin - slack, begin + period + slack))
    x = between(max(low_high(low)[0], 0.0), min(max(low_high(high)[1], 0.0), 1.0))
    s, ds, dds = time_law(x, reference.duration)
    first, second = _derivatives(reference.path, s)
    return [b * ds * ds + a * dds for a, b in zip(first, second, strict=True)]


def _derivatives(path: TipPath, s: Any) -> tuple[Sequence[Any], Sequence[Any]]:
    """Return dp/ds and d²p/ds² [m] of a path on a ball of its parameter s."""
    if isinstance(path, Placed):
        first, second = (np.array(part, dtype=object) @ path.axes for part in _derivatives(path.path, s))
        return first, second
    if isinstance(path, Spline):
        knots, coefficients = path.polynomials
        low, high = low_high(s)
        first = min(max(int(np.searchsorted(knots, low)) - 1, 0), len(knots) - 2)
        pieces = range(first, max(min(int(np.searchsorted(knots, high)), len(knots) - 1), first + 1))
        found = [_on_piece(coefficients[:, i], s - knots[i]) for i in pieces]
        return tuple([_joined(parts) for parts in zip(*kind, strict=True)] for kind in zip(*found, strict=True))  # type: ignore[return-value]
    _, first, second = path.points(np.array([s], dtype=object))
    return first[0], second[0]


def _on_piece(c: np.ndarray, h: Any) -> tuple[list[Any], list[Any]]:
    """Return the first and the second derivatives at h of a cubic per axis, with coefficients c (4, axes), h³ first."""
    columns = c.T.tolist()
    return [(3 * a * h + 2 * b) * h + d for a, b, d, _ in columns], [6 * a * h + 2 * b for a, b, _, _ in columns]


def _joined(balls: Sequence[Any]) -> Any:
    joined = balls[0]
    for ball in balls[1:]:
        joined = joined.union(ball)
    return joined
