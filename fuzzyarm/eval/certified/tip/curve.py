"""What the proof takes from the friction curve of the physics, checked on balls.

    F(0) = Γ_fs,      -s <= dF/dv <= 0,      d²F/dv² <= 0 below the inflection,      d²F/dv² >= 0 above it.

At the inflection itself, in a range of relative width 2e-9, -s <= dF/dv and d³F/dv³ >= 0. Beyond `FAR` inflections no
ball tells the sign of what is left of the fall: there |dF/dv| <= 2^-40 s and |F - F(∞)| <= 2^-40 Γ_fs, which `strength`
and `rates` add. All are coefficients of the power series of the curve itself, `STRIBECK.magnitude`, about balls that
cover the speeds up to 2^100 inflections; a ball that decides nothing is halved.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

from flint import arb, arb_series, ctx

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, dry_frictions
from fuzzyarm.envs.physics.friction import STRIBECK, DryFriction
from fuzzyarm.eval.certified.tip.defects import dry_friction
from fuzzyarm.eval.certified.tip.enclosures import (
    ROUND_UP,
    SLACK,
    NoBound,
    ball,
    between,
    centre,
    largest,
    low_high,
)

__all__ = ["check_curve", "rates", "steepest_fall", "strength"]

FAR, DOUBLINGS = 8.0, 100  # inflections, and how often they are doubled
HALVINGS = 40  # of a range of speeds


def steepest_fall(joint: int, arm: Arm) -> float:
    """Return a bound of -dF/dv [N m s/rad] of a motor."""
    return largest(STRIBECK.steepest(_in_balls(joint, arm))) * ROUND_UP


def strength(slowest: float, fastest: float, joint: int, arm: Arm) -> tuple[float, float]:
    """Return the lowest and the highest F(v) [N m] in a range of speeds [rad/s]."""
    weak, strong = (low_high(dry_friction(ball(v), joint, arm)) for v in (fastest, slowest))
    left = SLACK * largest(_in_balls(joint, arm).static_friction)
    return weak[0] - left, strong[1] + left


def rates(slowest: float, fastest: float, joint: int, arm: Arm) -> tuple[float, float]:
    """Return the lowest and the highest dF/dv [N m s/rad] in a range of speeds [rad/s]: it falls, then rises."""
    (before, after), steepest = _inflection(joint, arm), steepest_fall(joint, arm)
    inside = slowest <= after and before <= fastest
    ends = (min(slowest, before), max(fastest, after)) if inside else (slowest, fastest)
    lows, highs = zip(*(low_high(_series(ball(v), joint, arm)[1]) for v in ends), strict=True)
    return (-steepest if inside else min(lows)) - SLACK * steepest, max(highs) + SLACK * steepest


def _in_balls(joint: int, arm: Arm) -> DryFriction:
    """Return the numbers of a motor's curve, in balls."""
    return DryFriction(*map(arb, dry_frictions(arm)[joint]))


def _inflection(joint: int, arm: Arm) -> tuple[float, float]:
    """Return speeds [rad/s] just below and just above the inflection."""
    turn = centre(STRIBECK.inflection(_in_balls(joint, arm)))
    return turn * (1.0 - 1e-9), turn * (1.0 + 1e-9)


def check_curve(arm: Arm) -> None:
    """Raise `NoBound` where the friction of a motor is not as the module's docstring says; precision is the caller's.

    Args:
        arm: constants in floats or in balls.
    """
    for joint in range(JOINTS):
        static, rest = _in_balls(joint, arm).static_friction, _series(arb(0), joint, arm)
        fits = rest[0].overlaps(static) and rest[1] <= 0
        if not (fits and all(_covered(span, holds, joint, arm) for span, holds in _conditions(joint, arm, static))):
            raise NoBound(f"the friction of motor {joint + 1} is not as its curve's own numbers say: {STRIBECK}")


def _conditions(joint: int, arm: Arm, static: arb) -> Iterator[tuple[tuple[float, float], Callable[[Any], bool]]]:
    """Yield ranges of speeds [rad/s], and what the series of F has to be on balls in them."""
    (before, after), steepest = _inflection(joint, arm), arb(steepest_fall(joint, arm))
    far = [FAR * after * 2.0**k for k in range(DOUBLINGS + 1)]
    limit = _series(arb(far[-1]), joint, arm)[0]
    yield (0.0, before), lambda f: f[2] <= 0
    yield (before, after), lambda f: -steepest <= f[1] <= 0 and f[3] >= 0
    yield (after, far[0]), lambda f: f[1] <= 0 and f[2] >= 0
    for span in itertools.pairwise(far):
        yield span, lambda f: abs(f[1]) <= SLACK * steepest and abs(f[0] - limit) <= SLACK * static


def _covered(span: tuple[float, float], holds: Callable[[Any], bool], joint: int, arm: Arm) -> bool:
    """Return whether a condition on the series of F holds on balls that cover a range of speeds."""
    waiting = [(*span, HALVINGS)]
    while waiting:
        low, high, left = waiting.pop()
        if holds(_series(between(low, high), joint, arm)):
            continue
        if not left:
            return False
        middle = 0.5 * (low + high)
        waiting += [(low, middle, left - 1), (middle, high, left - 1)]
    return True


def _series(speed: arb, joint: int, arm: Arm) -> Any:
    """Return F and its derivatives of order k divided by k!, k <= 3, on a ball of speeds."""
    ctx.cap = 4
    return dry_friction(arb_series([speed, 1]), joint, arm)
