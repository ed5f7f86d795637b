"""The tracking task at one instant: tip position, tip error, reward, and whether the episode terminates.

Elementwise source, see `physics.elementwise`: the same code assesses one arm, a batch of arms, and tensors.
"""

import enum
import functools
import operator
from collections.abc import Iterable
from typing import Any, NamedTuple

from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.records import Physics, point, record_type

__all__ = ["Termination", "assess", "clipped", "finite", "reason_of", "target_record"]


class Termination(enum.IntEnum):
    """Reason for a termination; `text` is the value of ``info["reason"]``.

    `NONE` means that an episode continues or was truncated. If several reasons apply, `NOT_FINITE` comes
    before `ANGLE`, and `ANGLE` before `VELOCITY`. `LOST` occurs only in ``FuzzyArmLearn-v0`` and comes last.
    """

    NONE = 0
    ANGLE = 1
    VELOCITY = 2
    NOT_FINITE = 3
    LOST = 4

    @property
    def text(self) -> str:
        """The reason in one line of text; empty for `NONE`."""
        return _TEXTS[self]


_TEXTS = {
    Termination.NONE: "",
    Termination.ANGLE: "a joint angle left the domain (25)",
    Termination.VELOCITY: "a joint velocity left the domain (25)",
    Termination.NOT_FINITE: "the state is not finite",
    Termination.LOST: "the tip lost its reference",
}

# Plain floats, because the functions below also run on tensors, which do not support enumerations.
_ANGLE, _VELOCITY, _NOT_FINITE = map(float, (Termination.ANGLE, Termination.VELOCITY, Termination.NOT_FINITE))


def reason_of(finite: Any, angles_inside: Any, velocities_inside: Any) -> Any:
    """Return the number of the `Termination` as an exact float, elementwise, from three flags that are 0.0 or 1.0."""
    inside = angles_inside * (1.0 - velocities_inside) * _VELOCITY + (1.0 - angles_inside) * _ANGLE
    return finite * inside + (1.0 - finite) * _NOT_FINITE


_TRACKING_LENGTH = 0.005  # m; the tip error at which the tracking reward is one half [a choice, no source]
_BEYOND_MEASURE = 1e13  # rad, rad/s; above roughly this size, `sine_cosine` is meaningless and products overflow
_EFFORT_WEIGHT = 0.1  # share by which full torque reduces the reward [a choice, no source]


@functools.cache
def target_record(axes: int) -> Any:
    """Return the record type of a target: tip [m], the curve's unit normal, center and radius [m] (0: not a circle)."""
    kind = point(axes)
    return record_type("Target", position=kind, normal=kind, center=kind, radius=Any)


class _Assessment(NamedTuple):
    """The result of `assess`; lengths in m, torques in N m, flags 0.0 or 1.0."""

    tip: Any
    friction_torque: Any
    tip_error: Any
    circularity_error: Any
    circularity_error_motor: Any
    reward_tracking: Any
    reward_effort: Any
    reward: Any
    angles_inside: Any
    velocities_inside: Any


def assess(physics: Physics, state: Any, torque: Any, bias: Any, arm: Any, limits: Any, target: Any) -> _Assessment:
    """Return the `_Assessment` of an arm in `state` under clipped motor torques Γ and added torque biases [N m].

    reward = tracking (1 - 0.1 effort), tracking = 1 / (1 + |tip - reference| / 5 mm), effort = mean of (Γ/Γ_max)².
    """
    tip = physics.tip(state.link, arm)
    error = _distance(tip, target.position)
    shares = (u / most for u, most in zip(torque, limits.torque, strict=True))
    effort = 1.0 / physics.joints * _total(one * one for one in shares)
    tracking = 1.0 / (1.0 + error / _TRACKING_LENGTH)
    low, high = physics.angle_range(limits)
    return _Assessment(
        tip,
        physics.motor_friction(state, torque, bias, arm),
        error,
        _deviation(tip, target),
        _deviation(physics.tip(state.motor, arm), target),
        tracking,
        effort,
        tracking * (1.0 - _EFFORT_WEIGHT * effort),
        1.0 * (_inside(state.motor, low, high) & _inside(state.link, low, high)),
        1.0 * (_slow(state.motor_velocity, limits.velocity) & _slow(state.link_velocity, limits.velocity)),
    )


def clipped(torque: Any, limit: Any) -> Any:
    """Return a torque clipped to [-limit, limit]; a torque within these limits is returned exactly."""
    return torque * (abs(torque) <= limit) + limit * (torque > limit) - limit * (torque < -limit)


def finite(state: Any) -> Any:
    """Return 1.0 if a state is finite and small enough that everything computed from it is finite, else 0.0."""
    sizes = [_total(map(abs, part)) for part in state]
    motors, links = sizes[0] + sizes[2], sizes[1] + sizes[3]
    return 1.0 * (motors + links < _BEYOND_MEASURE)


def _distance(a: Any, b: Any) -> Any:
    return root(_total((x - y) * (x - y) for x, y in zip(a, b, strict=True)))


def _deviation(tip: Any, target: Any) -> Any:
    """Return the signed distance [m] of a tip from the reference curve.

    It is positive outwards for a circle, else measured from the target along the normal.
    """
    is_circle = 1.0 * (target.radius > 0.0)
    outwards = _distance(tip, target.center) - target.radius
    sideways = _total((x - y) * n for x, y, n in zip(tip, target.position, target.normal, strict=True))
    return is_circle * outwards + (1.0 - is_circle) * sideways


def _total(numbers: Iterable[Any]) -> Any:
    """Return the sum of the numbers, added in order from the first to the last."""
    return functools.reduce(operator.add, numbers)


def _inside(angles: Any, low: Any, high: Any) -> Any:
    pairs = zip(angles, low, high, strict=True)
    return functools.reduce(operator.and_, ((q >= least) & (q <= most) for q, least, most in pairs))


def _slow(velocities: Any, limits: Any) -> Any:
    pairs = zip(velocities, limits, strict=True)
    return functools.reduce(operator.and_, (abs(dq) <= most for dq, most in pairs))
