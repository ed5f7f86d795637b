"""Stribeck friction of the motors with exact stick (paper section 2).

Elementwise source: every argument is a scalar or an array of lanes, every operation a NumPy ufunc, so the same
lines run in plain NumPy and, compiled by Numba, inside the step kernel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable


@register_jitable
def stribeck_magnitude(velocity: Any, coulomb: Any, static: Any, stribeck_velocity: Any) -> Any:
    """Return F(v) = Γ_fc + (Γ_fs - Γ_fc) exp(-(v/v_s)²) [N m], the friction magnitude; F(0) is the static torque."""
    ratio = velocity / stribeck_velocity
    return coulomb + (static - coulomb) * np.exp(-ratio * ratio)


@register_jitable
def friction_torque(velocity: Any, net_torque: Any, coulomb: Any, static: Any, stribeck_velocity: Any) -> Any:
    """Return Γ_f [N m] of section 2: -F(v) sign v when slipping, else minus the net torque up to the static one.

    Args:
        velocity: motor velocity q̇_a [rad/s].
        net_torque: Γ - Γ_t [N m], what the friction has to hold at rest.
        coulomb: Γ_fc [N m].
        static: Γ_fs [N m].
        stribeck_velocity: v_s [rad/s].
    """
    slip = -stribeck_magnitude(velocity, coulomb, static, stribeck_velocity) * np.sign(velocity)
    stick = -np.minimum(np.abs(net_torque), static) * np.sign(net_torque)
    return slip + (velocity == 0.0) * stick


@register_jitable
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
    speed, direction = np.abs(velocity), np.sign(velocity)
    along = speed + duration * (direction * acceleration - deceleration)
    # First part: until the line reaches zero (all of `duration` if it does not); second part: from rest.
    # The comparison only decides 0/0, a joint that starts at rest, for which the first part is empty.
    whole = speed + np.maximum(-along, 0.0)
    slip_time = duration * speed / (whole + (whole == 0.0))
    rest_time = duration - slip_time
    slipped = direction * np.maximum(along, 0.0)
    restarted = rest_time * np.sign(acceleration) * np.maximum(np.abs(acceleration) - deceleration, 0.0)
    return slipped + restarted, 0.5 * (slip_time * (velocity + slipped) + rest_time * restarted)
