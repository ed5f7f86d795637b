"""Stribeck friction of the motors with exact stick (paper section 2).

Elementwise source: every argument is a scalar, an array or a tensor of lanes, and no line branches, so the same lines
run in plain NumPy, on torch tensors and, recorded, as machine code; see `elementwise`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from fuzzyarm.envs.physics.elementwise import gaussian, positive_part, sign, smaller
from fuzzyarm.numbers.functions import apart

__all__ = [
    "DRY_TORQUES", "STRIBECK", "DryFriction", "dry_friction_of", "friction_torque", "stick_slip", "stribeck_magnitude",
]  # fmt: skip


class DryFriction(NamedTuple):
    """The parameters of the friction curve F(v) of one motor; plants, robots and control laws have these fields."""

    coulomb_friction: Any  # Γ_fc [N m]
    static_friction: Any  # Γ_fs [N m]
    stribeck_velocity: Any  # v_s [rad/s]


DRY_TORQUES = ("coulomb_friction", "static_friction")
"""The parameters that scale F(v) as a whole: a plant with twice the dry friction has twice these."""


def dry_friction_of(plant: Any, joint: int) -> DryFriction:
    """Return the friction parameters of one motor; a field of the plant is one value or a tuple of one per joint."""
    values = (getattr(plant, name) for name in DryFriction._fields)
    return DryFriction(*(value[joint] if isinstance(value, tuple) else value for value in values))


def stribeck_magnitude(velocity: Any, dry: DryFriction) -> Any:
    """Return F(v) = Γ_fc + (Γ_fs - Γ_fc) exp(-(v/v_s)²) [N m], the friction magnitude; F(0) is the static torque."""
    coulomb, static, stribeck_velocity = dry
    return coulomb + (static - coulomb) * gaussian(velocity * (1.0 / stribeck_velocity))


class _FrictionCurve(NamedTuple):
    """A friction curve F(v) falling from F(0) = Γ_fs, and properties that proofs use and check in ball arithmetic."""

    magnitude: Callable[[Any, DryFriction], Any]  # F(v) [N m] from the speed and the parameters, of any number type
    steepest: Callable[[DryFriction], Any]  # a bound on -F'(v) [N m s/rad] for these parameters
    inflection: Callable[[DryFriction], Any]  # v [rad/s] at which -F' is largest: F' falls below it and rises above it


STRIBECK = _FrictionCurve(
    stribeck_magnitude,
    steepest=lambda dry: (dry.static_friction - dry.coulomb_friction) / dry.stribeck_velocity * 0.858,  # √2 e^(-1/2)
    inflection=lambda dry: 0.5**0.5 * dry.stribeck_velocity,
)
"""The friction of the motors."""


def friction_torque(velocity: Any, net_torque: Any, dry: DryFriction) -> Any:
    """Return Γ_f [N m] of section 2: -F(v) sign v when slipping; at rest, minus the net torque, limited to ±Γ_fs.

    v = q̇_a [rad/s]; the net torque Γ - Γ_t [N m] is what friction has to balance at rest; Γ_fs = F(0).
    """
    slip = -stribeck_magnitude(velocity, dry) * sign(velocity)
    stick = -smaller(abs(net_torque), dry.static_friction) * sign(net_torque)
    return slip + 1.0 * (velocity == 0.0) * stick


@apart
def stick_slip(velocity: Any, acceleration: Any, deceleration: Any, duration: Any) -> tuple[Any, Any]:
    """Solve v̇ ∈ a - f Sgn(v) exactly over a duration [s]; return the velocity [rad/s] and the angle travelled [rad].

    a and f >= 0 [rad/s²] are constant: the other torques and the friction's magnitude, each divided by the inertia. The
    velocity v [rad/s] is linear in time until it reaches zero; then it stays zero if |a| <= f and changes sign
    otherwise. There is no smoothing: a stuck joint has velocity exactly 0.
    """
    speed, direction = abs(velocity), sign(velocity)
    along = speed + duration * (direction * acceleration - deceleration)
    # First part: until the line reaches zero (all of `duration` if it does not); second part: from rest.
    # The comparison matters only for 0/0, that is, for a joint initially at rest, whose first part is empty.
    whole = speed + positive_part(-along)
    slip_time = duration * speed / (whole + 1.0 * (whole == 0.0))
    rest_time = duration - slip_time
    slipped = direction * positive_part(along)
    restarted = rest_time * sign(acceleration) * positive_part(abs(acceleration) - deceleration)
    return slipped + restarted, 0.5 * (slip_time * (velocity + slipped) + rest_time * restarted)
