"""Bounds on the difference between a motor's friction and the centre's, on the tube of one period.

A motor with the velocity v = θ̇ and the net torque N (`_defects`) obeys I_a v̇ = N + Γ_f, where Γ_f = -F(v) sgn v for
v ≠ 0 and |Γ_f| <= F(0) at v = 0 (Filippov). δv and δN are deviations from the centre y, which has the friction -P.
The torque on the deviation is w = Γ_f + P:

    v > 0     w = P - F(v);          v < 0     w = P + F(v);
    v = 0     w = -δN - I_a θ̈_y:     on the set of times with v = 0 almost everywhere v̇ = 0, so Γ_f = -N there.

*Speed.* Where v > 0, I_a v̇ = N - F(v) <= N_max - F_min, so v <= max(0, v_0 + t (N_max - F_min)/I_a); v < 0 is similar.

*Monotonicity.* v -> F(v) sgn v + L v increases, where L is the largest -F' on the tube. If -P is within η of the law's
friction at the centre's velocity, the velocities of two solutions diverge no faster than
I_a |δv|' <= |δN| + η + L |δv|, whether the motor sticks or slips.

*Hold.* If v = 0 at the start and |N| < F(0) on the tube, the motor rests during the period.

*Curve.* `check_curve` proves these properties in balls:

    F(0) = Γ_fs,      -s <= dF/dv <= 0,      d²F/dv² <= 0 below the inflection,      d²F/dv² >= 0 above it,

with s = `_Curve.steepest` and the static friction Γ_fs. At the inflection itself, in a range of relative width 2e-9,
-s <= dF/dv and d³F/dv³ >= 0. Beyond `_FAR` times the speed of inflection, the remaining decrease is too small for a
ball to decide its sign: there |dF/dv| <= 2^-40 s, and F is within 2^-40 Γ_fs of its value at the highest speed.
`_Curve.slopes` and `_Curve.strength` allow for this. The balls cover speeds up to 2^100 times the inflection's.
"""

import enum
import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_series, ctx

from fuzzyarm.envs.physics.friction import STRIBECK, DryFriction
from fuzzyarm.proof.tip._defects import PeriodMotion, Signal, dry_friction
from fuzzyarm.proof.tip.centre import Mode
from fuzzyarm.proof.tip.enclosures import ROUND_UP, SLACK, Jet, NoBound, between, largest, low_high, middle_of
from fuzzyarm.proof.tip.plant import BallPlant

__all__ = ["Friction", "Plan", "PlanFails", "Speed", "check_curve"]

_FAR, _DOUBLINGS = 8.0, 100  # multiple of the speed of inflection, and how often it is doubled
_HALVINGS = 40  # of a range of speeds on which a condition is undecided


class _Curve:
    """The friction curve F(v) of one motor, in balls."""

    def __init__(self, joint: int, arm: Any) -> None:
        self._joint, self._arm = joint, arm
        dry = DryFriction(*map(arb, getattr(arm, f"dry_friction{joint + 1}")))
        self.static, turn = dry.static_friction, middle_of(STRIBECK.inflection(dry))
        self.before, self.after = turn * (1.0 - 1e-9), turn * (1.0 + 1e-9)  # around the inflection [rad/s]
        self.steepest = largest(STRIBECK.steepest(dry)) * ROUND_UP  # bound on -dF/dv [N m s/rad]

    def series(self, speed: arb) -> Any:
        """Return F and its derivatives of order k divided by k!, k <= 3, on a ball of speeds."""
        ctx.cap = 4
        return dry_friction(arb_series([speed, 1]), self._joint, self._arm)

    def at(self, speed: Any) -> Any:
        """Return the friction F [N m] at a speed [rad/s]."""
        return dry_friction(speed, self._joint, self._arm)

    def strength(self, slowest: float, fastest: float) -> tuple[float, float]:
        """Return the lowest and the highest F(v) [N m] in a range of speeds [rad/s]."""
        weak, strong = (low_high(self.at(arb(v))) for v in (fastest, slowest))
        left = SLACK * largest(self.static)
        return weak[0] - left, strong[1] + left

    def slopes(self, slowest: float, fastest: float) -> tuple[float, float]:
        """Return the lowest and highest dF/dv [N m s/rad] between two speeds [rad/s]; dF/dv first falls, then rises."""
        inside = slowest <= self.after and self.before <= fastest
        ends = (min(slowest, self.before), max(fastest, self.after)) if inside else (slowest, fastest)
        lows, highs = zip(*(low_high(self.series(arb(v))[1]) for v in ends), strict=True)
        left = SLACK * self.steepest
        return (-self.steepest if inside else min(lows)) - left, max(highs) + left

    def conditions(self) -> Iterator[tuple[tuple[float, float], Callable[[Any], bool]]]:
        """Yield ranges of speeds [rad/s], each with a condition that `series` must meet on balls that cover it."""
        steepest, static = arb(self.steepest), self.static
        far = [_FAR * self.after * 2.0**k for k in range(_DOUBLINGS + 1)]
        limit = self.series(arb(far[-1]))[0]
        yield (0.0, self.before), lambda f: f[2] <= 0
        yield (self.before, self.after), lambda f: -steepest <= f[1] <= 0 and f[3] >= 0
        yield (self.after, far[0]), lambda f: f[1] <= 0 and f[2] >= 0
        for span in itertools.pairwise(far):
            yield span, lambda f: abs(f[1]) <= SLACK * steepest and abs(f[0] - limit) <= SLACK * static

    def meets(self, span: tuple[float, float], condition: Callable[[Any], bool]) -> bool:
        """Return whether `series` is proven to meet `condition` on balls that cover the speeds in `span` [rad/s]."""
        waiting = [(*span, _HALVINGS)]
        while waiting:
            low, high, left = waiting.pop()
            if condition(self.series(between(low, high))):
                continue
            if not left:
                return False
            middle = 0.5 * (low + high)
            waiting += [(low, middle, left - 1), (middle, high, left - 1)]
        return True


def check_curve(arm: Any, joints: int) -> None:
    """Raise `NoBound` unless balls, of the precision set by the caller, prove the module's *Curve* for all motors."""
    for joint in range(joints):
        curve = _Curve(joint, arm)
        rest = curve.series(arb(0))
        fits = rest[0].overlaps(curve.static) and rest[1] <= 0
        if not (fits and all(curve.meets(*each) for each in curve.conditions())):
            raise NoBound(f"motor {joint + 1}: friction is not a Stribeck curve that falls with speed")


class Plan(enum.Enum):
    """The way in which the friction of a motor is bounded in one period."""

    ANY = "any"  # the friction is any torque up to the static one
    HELD = "held"  # the motor rests, as the centre does
    SLIP = "slip"  # the motor turns in the centre's direction; the slope of F is part of the linear equation
    MONOTONE = "monotone"  # *Monotonicity* bounds the velocity separately, outside the linear equation
    MIXED = "mixed"  # rest and slip in either direction are possible, each unless it is ruled out


class Speed(NamedTuple):
    """Bounds on a motor's velocity at a sample, in addition to the tube: low <= v <= high [rad/s]."""

    low: float
    high: float


class Friction:
    """The friction of one motor in one period."""

    def __init__(
        self, joint: int, plan: Plan, mode: Mode, motion: PeriodMotion, torque: float, plant: BallPlant, known: Speed
    ) -> None:
        """Prepare the bounds; `torque` [N m] is held, and `known` bounds v at the start of the period."""
        arm, velocity, acceleration = plant.exact, motion.velocity[joint], motion.acceleration[joint]
        self.joint, self.plan, self.known = joint, plan, known
        self.share, self._curve = plant.share[joint], _Curve(joint, arm)
        self._uncertain = max(self.share[1] - 1.0, 1.0 - self.share[0])  # largest change of the friction factor
        self.speed, self._duration = velocity.ends(), motion.duration
        self._speed = between(*self.speed)
        net, self._needed = motion.net_torque(joint, torque, arm)
        self._net, self._needed_size = between(*net.ends()), self._needed.size()
        inertia = getattr(arm, f"motor_inertia{joint + 1}")
        self._inertia, self._inertial = low_high(inertia)[0], largest(inertia * acceleration.range())
        self.static, self._steepest = low_high(self._curve.at(arb(0.0))), self._curve.steepest
        self._rests = all(a.is_zero() for a in velocity.coefficients)
        self.side = int(mode) if mode in (Mode.FORWARD, Mode.BACKWARD) else 0
        self.drag = 0.0  # middle of the possible friction torques under the plan MIXED [N m], set by `bound`
        self._slip: Signal | None = None
        self._missed = 0.0
        if self.side:
            self._slip = motion.slip(joint, self.side, arm)
            self._missed = (self._needed + -self.side * self._slip).size()
        self.slope = 0.0  # change of the friction with the velocity that is part of the linear equation [N m s/rad]
        if plan is Plan.SLIP:
            slope = self._curve.at(Jet.variable(arb(abs(middle_of(self._speed))), 0)).slope(0)
            self.slope = -middle_of(slope)

    def torque(self) -> Signal | None:
        """Return the centre's friction torque, to be scaled by the friction factor; None unless the plan is SLIP."""
        if self.plan is not Plan.SLIP or self._slip is None:
            return None
        return -self.side * self._slip

    def parted(self, start: float, duration: float, torque: float) -> float:
        """Return a bound on |δv| [rad/s] during a segment of `duration` [s], under the plan MONOTONE.

        `start` [rad/s] bounds |δv| at the segment's start, and `torque` [N m] bounds |δN| + η during it, see `driving`.
        """
        # If a slipping centre's velocity slightly overshoots zero, it is shifted by `aside` for the comparison.
        aside = max(0.0, -self.speed[0] if self.side > 0 else self.speed[1]) if self.side else 0.0
        rate = self._steepest * self.share[1] / self._inertia
        grown = start + aside + duration * (torque / self._inertia + rate * aside)
        return grown * float(np.exp(rate * duration)) * (1.0 + SLACK) + aside

    def driving(self, tube_net: float, constants: float, products: float) -> float:
        """Return a bound on |δN| + η [N m] for the plan MONOTONE; arguments as for `bound`.

        η, the distance of the centre from the friction law, includes the effect of the friction factor's range.
        """
        static = self.static[1]
        eta = self._missed
        if not self.side:
            eta = max(0.0, self._needed_size - static) if self._rests else self._needed_size + static
        eta += self._uncertain * static
        return (tube_net + eta + constants + products) * (1.0 + SLACK)

    def pull(self, tube_net: float, constants: float, products: float) -> float:
        """Return a bound on |I_a δθ̈| [N m] for any friction torque up to static friction; arguments as for `bound`."""
        static = self.static[1]
        return (tube_net + self._needed_size + self.share[1] * static + constants + products) * (1.0 + SLACK)

    def bound(self, tube_speed: float, tube_net: float, constants: float, products: float) -> float:
        """Return a bound on |w| + `products` [N m]; `PlanFails` if the tube contradicts the plan.

        The bound omits the error of the friction factor times the result of `torque`. In the tube, |δv| <= `tube_speed`
        [rad/s] and |δN| <= `tube_net` [N m]. `products` [N m] bounds the errors of inertia and viscous friction times
        the deviations of acceleration and velocity, `constants` [N m] all other torques due to errors of constants.
        """
        low, high = low_high(self._speed + arb(0.0, tube_speed))
        if self.plan is Plan.ANY:
            return (self._needed_size + self.share[1] * self.static[1]) * (1 + SLACK) + products
        if self.plan is Plan.MONOTONE:
            return 0.0
        if self.plan is Plan.HELD:
            limit = self.share[0] * self.static[0]
            known = self.known == (0.0, 0.0) and self._rests
            if not (known and largest(self._net) + tube_net + constants + products < limit * (1.0 - 1e-9)):
                raise PlanFails(self.joint)
            return 0.0
        if self.plan is Plan.SLIP:
            if not (self.side * (low if self.side > 0 else high) > 0.0):
                raise PlanFails(self.joint)
            slowest, fastest = sorted((abs(low), abs(high)))
            falling, rising = self._curve.slopes(slowest, fastest)
            uncertain = self._uncertain * max(-falling, rising)
            rest = max(abs(falling + self.slope), abs(rising + self.slope)) + uncertain
            return (self._missed + rest * tube_speed) * (1.0 + SLACK) + products
        return self._mixed(low, high, tube_speed, tube_net, constants, products)

    def _mixed(
        self, low: float, high: float, tube_speed: float, tube_net: float, constants: float, products: float
    ) -> float:
        low, high = self._during(low, high, tube_net + constants + products)
        needed_low, needed_high = self._needed.ends()
        ends: list[float] = []
        for side, fastest in ((1, high), (-1, -low)):
            if fastest <= 0.0:
                continue
            slowest = max(0.0, low if side > 0 else -high)
            if side == self.side and self._slip is not None:
                uncertain = self._uncertain * self._curve.strength(slowest, fastest)[1]
                reach = self._missed + (self._steepest * tube_speed + uncertain) * (1 + SLACK)
                ends += [-reach, reach]
                continue
            weak, strong = self._curve.strength(slowest, fastest)
            pull = [side * self.share[0] * weak, side * self.share[1] * strong]
            ends += [needed_low - max(pull), needed_high - min(pull)]
        if low <= 0.0 <= high:
            static = self.share[1] * self.static[1]
            rest = (tube_net + self._inertial + constants + products) * (1 + SLACK)
            net_low, net_high = low_high(self._net + arb(0.0, (tube_net + constants + products) * (1 + SLACK)))
            if max(net_low, -static) <= min(net_high, static):  # otherwise the motor cannot rest
                ends += [max(-rest, needed_low - min(net_high, static)), min(rest, needed_high - max(net_low, -static))]
        if ends:
            self.drag = 0.5 * (min(ends) + max(ends)) - 0.5 * (needed_low + needed_high)
        return max(map(abs, ends), default=0.0) * (1 + SLACK) + products

    def _rates(self, low: float, high: float, spread: float) -> tuple[float, float]:
        """Return the least v̇ [rad/s²] for low <= v < 0 and the largest for 0 < v <= high, if |δN| <= `spread` [N m]."""
        net_low, net_high = low_high(self._net)
        backward = self.share[0] * self._curve.strength(0.0, max(-low, 0.0))[0]
        forward = self.share[0] * self._curve.strength(0.0, max(high, 0.0))[0]
        slack = SLACK * (abs(net_low) + abs(net_high) + spread + backward + forward)
        return (
            (net_low - spread + backward - slack) / self._inertia,
            (net_high + spread - forward + slack) / self._inertia,
        )

    def _during(self, low: float, high: float, spread: float) -> Speed:
        """Return bounds on v [rad/s] in the segment, from those of the tube, low <= v <= high [rad/s].

        The result is narrower if v cannot reach all of these speeds with |δN| <= `spread` [N m].
        """
        falling, rising = self._rates(low, high, spread)
        least = min(self.known.low, 0.0) + min(falling, 0.0) * self._duration * (1.0 + SLACK)
        most = max(self.known.high, 0.0) + max(rising, 0.0) * self._duration * (1.0 + SLACK)
        return Speed(max(low, least), min(high, most))

    def after(self, tube_speed: float, spread: float, end: tuple[float, float]) -> Speed:
        """Return bounds on v [rad/s] at the segment's end; those of the tube at the end are `end` = (low, high).

        During the segment, |δv| <= `tube_speed` [rad/s] and |δN| <= `spread` [N m].
        """
        if self.plan is Plan.ANY:
            return Speed(-math.inf, math.inf)
        if self.plan is Plan.HELD:
            return Speed(0.0, 0.0)
        low, high = low_high(self._speed + arb(0.0, tube_speed))
        falling, rising = self._rates(low, high, spread)
        least = min(0.0, min(self.known.low, 0.0) + falling * self._duration * (1.0 - SLACK * np.sign(falling)))
        most = max(0.0, max(self.known.high, 0.0) + rising * self._duration * (1.0 + SLACK * np.sign(rising)))
        return Speed(max(end[0], least), min(end[1], most))


class PlanFails(ValueError):
    """The tube contradicts the `Plan` that bounds the friction of the motor `joint`."""

    def __init__(self, joint: int) -> None:
        super().__init__(f"the tube contradicts the friction plan of motor {joint + 1}")
        self.joint = joint
