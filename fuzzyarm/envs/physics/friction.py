"""Stribeck friction of the motors with exact stick (paper section 2).

Elementwise source: every argument is a scalar, an array or a tensor of lanes, and no line branches, so the same lines
run in plain NumPy, on torch tensors and, recorded, as machine code; see `elementwise`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from fuzzyarm.envs.physics.elementwise import gaussian, positive_part, sign, smaller
from fuzzyarm.numbers.functions import apart

__all__ = ["STRIBECK", "FrictionCurve", "friction_torque", "stick_slip", "stribeck_magnitude"]


def stribeck_magnitude(velocity: Any, coulomb: Any, static: Any, stribeck_velocity: Any) -> Any:
    """Return F(v) = Γ_fc + (Γ_fs - Γ_fc) exp(-(v/v_s)²) [N m], the friction magnitude; F(0) is the static torque."""
    return coulomb + (static - coulomb) * gaussian(velocity * (1.0 / stribeck_velocity))


class FrictionCurve(NamedTuple):
    """A curve F(v) of dry friction that falls from F(0) = Γ_fs, and what a proof takes from it and checks in balls.

    Attributes:
        magnitude: F(v) [N m], of the speed, Γ_fc, Γ_fs and v_s, for numbers of any type.
        steepest: a bound of -F'(v), as a share of (Γ_fs - Γ_fc)/v_s.
        inflection: v/v_s at which -F' is largest: F' falls below it and rises above it.
    """

    magnitude: Callable[[Any, Any, Any, Any], Any]
    steepest: float
    inflection: float


STRIBECK = FrictionCurve(stribeck_magnitude, steepest=0.858, inflection=0.5**0.5)  # -F' = √2 e^(-1/2) at v_s/√2
"""The friction of the motors."""


def friction_torque(velocity: Any, net_torque: Any, coulomb: Any, static: Any, stribeck_velocity: Any) -> Any:
    """Return Γ_f [N m] of section 2: -F(v) sign v when slipping, else minus the net torque up to the static one.

    Args:
        velocity: motor velocity q̇_a [rad/s].
        net_torque: Γ - Γ_t [N m], what the friction has to hold at rest.
        coulomb: Γ_fc [N m].
        static: Γ_fs [N m].
        stribeck_velocity: v_s [rad/s].
    """
    slip = -stribeck_magnitude(velocity, coulomb, static, stribeck_velocity) * sign(velocity)
    stick = -smaller(abs(net_torque), static) * sign(net_torque)
    return slip + 1.0 * (velocity == 0.0) * stick


@apart
def stick_slip(velocity: Any, acceleration: Any, deceleration: Any, duration: Any) -> tuple[Any, Any]:
    """Solve v̇ ∈ a - f Sgn(v) exactly over `duration` with constant a and f.

    The velocity falls or rises linearly; when it reaches zero it stays there if |a| <= f and leaves on the other
    side otherwise. No smoothing: a stuck joint has velocity exactly 0.

    Args:
        velocity: v at the start [rad/s].
        acceleration: a, all torques but friction over inertia [rad/s²].
        deceleration: f >= 0, friction magnitude over inertia [rad/s²].
        duration: time to advance [s].

    Returns:
        Velocity at the end [rad/s] and the angle travelled [rad].
    """
    speed, direction = abs(velocity), sign(velocity)
    along = speed + duration * (direction * acceleration - deceleration)
    # First part: until the line reaches zero (all of `duration` if it does not); second part: from rest.
    # The comparison only decides 0/0, a joint that starts at rest, for which the first part is empty.
    whole = speed + positive_part(-along)
    slip_time = duration * speed / (whole + 1.0 * (whole == 0.0))
    rest_time = duration - slip_time
    slipped = direction * positive_part(along)
    restarted = rest_time * sign(acceleration) * positive_part(abs(acceleration) - deceleration)
    return slipped + restarted, 0.5 * (slip_time * (velocity + slipped) + rest_time * restarted)
