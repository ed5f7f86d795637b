"""The time step of an arm with elastic joints: half drift, kick with exact stick, half drift; second order.

Over a sub-step h the positions x move half-way, the accelerations a are taken there, and the velocities v jump:

    x_m = x + h/2 v,    v_m = v + h/2 a(x_m, v),    v' = v + h a(x_m, v_m),    x' = x_m + h/2 v'.

The configuration-dependent terms (sines, mass matrix, gravity, tip force) are computed once a sub-step, at x_m; only
the velocity-dependent ones are computed twice. The motors' velocities are advanced by `stick_slip`.

`advanced` is this step for any number of joints; `step` and `loaded_step` are the step of the two-joint arm. Over a
control step (`held_of`), the torque is held and the tip force is linear in time.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.dynamics import (
    Arm,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    motors,
    solve_mass_matrix,
    tip_force_torque,
)
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.records import PerJoint, Physics, Point2, State, places, point, record_type
from fuzzyarm.numbers.functions import apart, repeat, zeros
from fuzzyarm.numbers.machine import Kernel, PortLayout
from fuzzyarm.numbers.program import Program

__all__ = ["advanced", "force_line", "held_of", "hold_of", "loaded_step", "step"]

_Accelerations = Callable[[Any, Any], Any]
"""Function of the joint torques [N m] and the links' velocities that returns the links' accelerations [rad/s²]."""


def advanced(state: Any, torque: Any, at: Callable[[Any], _Accelerations], arm: Any, h: Any) -> Any:
    """Return the state of an arm with n joints one sub-step h [s] later under motor torques [N m]; see the module.

    `at` returns the links' acceleration function at link angles [rad]; `arm` has `Motor`'s fields, numbered by joint.
    """
    half = 0.5 * h
    motor, link = _drifted(state.motor, state.motor_velocity, half), _drifted(state.link, state.link_velocity, half)
    accelerations, driven = at(link), [(own, 1.0 / own.motor_inertia) for own in motors(arm, motor)]
    middle = type(state)(motor, link, state.motor_velocity, state.link_velocity)
    motor_velocity, link_velocity, _ = _kick(state, middle, torque, accelerations, driven, arm, half)
    middle = type(state)(motor, link, motor_velocity, link_velocity)
    motor_velocity, link_velocity, travelled = _kick(state, middle, torque, accelerations, driven, arm, h)
    motor = type(motor)(*(angle + further for angle, further in zip(state.motor, travelled, strict=True)))
    return type(state)(motor, _drifted(link, link_velocity, half), motor_velocity, link_velocity)


def _drifted(angles: Any, velocities: Any, duration: Any) -> Any:
    """Return the angles [rad] after a duration [s] at constant velocities [rad/s]."""
    return type(angles)(*(angle + duration * velocity for angle, velocity in zip(angles, velocities, strict=True)))


def _kick(
    start: Any, middle: Any, torque: Any, accelerations: _Accelerations, driven: Any, arm: Any, duration: Any
) -> tuple[Any, Any, Any]:
    """Return the velocities of motors and links [rad/s] a duration [s] after `start`, and the motors' rotations [rad].

    Accelerations are those in state `middle` under motor torques [N m]. `driven`: each `Motor` and 1 / its inertia.
    """
    per_joint, joint = type(start.motor), joint_torque(middle, arm)
    links = accelerations(joint, middle.link_velocity)
    link_velocity = per_joint(*(v + duration * a for v, a in zip(start.link_velocity, links, strict=True)))
    kicked = [
        stick_slip(
            velocity,
            (given - load - own.viscous * rate) * inverse,
            stribeck_magnitude(rate, own.dry_friction) * inverse,
            duration,
        )
        for (own, inverse), given, load, velocity, rate in zip(
            driven, torque, joint, start.motor_velocity, middle.motor_velocity, strict=True
        )
    ]
    motor_velocity, travelled = (per_joint(*part) for part in zip(*kicked, strict=True))
    return motor_velocity, link_velocity, travelled


@apart
def step(state: State, torque: PerJoint, force: Point2, arm: Arm, h: Any) -> Any:
    """Return the state of the two-joint arm one sub-step h [s] later, under motor torques [N m] and a tip force [N]."""

    def at(link: PerJoint) -> _Accelerations:
        sin1, cos1 = sine_cosine(link.joint1)
        sin12, cos12 = sine_cosine(link.joint1 + link.joint2)
        sin2, cos2 = sin12 * cos1 - cos12 * sin1, cos12 * cos1 + sin12 * sin1
        force1, force2 = tip_force_torque(sin1, cos1, sin12, cos12, force.x, force.y, arm)
        gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
        return _two_links(PerJoint(force1 - gravity1, force2 - gravity2), sin2, cos2, arm)

    return advanced(state, torque, at, arm, h)


def loaded_step(state: State, torque: PerJoint, load: PerJoint, arm: Arm, h: Any) -> Any:
    """Return the state as `step` does, with torques `load` [N m] on the links instead of the tip force."""

    def at(link: PerJoint) -> _Accelerations:
        sin1, cos1 = sine_cosine(link.joint1)
        sin2, cos2 = sine_cosine(link.joint2)
        gravity1, gravity2 = gravity_torque(sin1, sin1 * cos2 + cos1 * sin2, arm)
        return _two_links(PerJoint(load.joint1 - gravity1, load.joint2 - gravity2), sin2, cos2, arm)

    return advanced(state, torque, at, arm, h)


def _two_links(outer: PerJoint, sin2: Any, cos2: Any, arm: Arm) -> _Accelerations:
    """Return the links' acceleration function; torques `outer` [N m] act besides joint and Coriolis torques."""

    def accelerations(joint: PerJoint, rates: PerJoint) -> tuple[Any, Any]:
        coriolis1, coriolis2 = coriolis_torque(sin2, rates.joint1, rates.joint2, arm)
        torque1, torque2 = joint.joint1 + outer.joint1 - coriolis1, joint.joint2 + outer.joint2 - coriolis2
        return solve_mass_matrix(cos2, torque1, torque2, arm)

    return accelerations


@functools.cache
def force_line(axes: int) -> Any:
    """Return the record type of a tip force that is linear over a control step: its mean and its change [N]."""
    return record_type("ForceLine", mean=point(axes), change=point(axes))


@functools.cache
def held_of(physics: Physics) -> Callable[..., Any]:
    """Return ``held(state, torque, mean, change, arm, h, substeps)``, the state one control step later.

    The torques [N m] are held. The tip force is linear in time, with a mean and a change over the step [N]; each
    of the `substeps` sub-steps of h [s] uses the force at its own middle.
    """
    Point = physics.Point

    def held(state: Any, torque: Any, mean: Any, change: Any, arm: Any, h: Any, substeps: Any) -> Any:
        def sub_step(carried: Any) -> Any:
            number, state = carried
            share = (number + 0.5) / substeps - 0.5
            force = Point(*(m + share * c for m, c in zip(mean, change, strict=True)))
            return number + 1.0, physics.step(state, torque, force, arm, h)

        return repeat(substeps, sub_step, (0.0, state))[1]

    return held


@functools.cache
def hold_of(physics: Physics) -> Callable[..., None]:
    """Return ``hold(state, torque, force, arm, h, substeps)``, which advances lanes by one control step.

    Arrays (entries, lanes) are the state, which is changed in place, the motor torques [N m], the tip force as a
    `force_line` [N] and the constants `arm`; h is the sub-step [s]. ValueError if an array has another shape.
    """
    ForceLine, advance = force_line(physics.axes), held_of(physics)
    kinds = physics.State, physics.PerJoint, ForceLine, physics.Arm

    def step(state: Any, torque: Any, force: Any, arm: Any, given: Any) -> tuple[Any, ...]:
        return advance(state, torque, *force, arm, *given), torque, force, arm

    program = Program(step, [zeros(places(kind)) for kind in kinds], (0.0, 0.0))
    kernel = Kernel(program, [PortLayout.COLUMNS] * len(kinds))

    def hold(
        state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int
    ) -> None:
        kernel((state, torque, force, arm), np.array([h, substeps], dtype=np.float64))

    return hold
