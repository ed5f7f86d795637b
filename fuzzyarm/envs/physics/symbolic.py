"""The equations of motion of a robot in symbols: the recursive algorithms, and the time step, run on expressions.

The step is that of `integrator`: half drift, two kicks with the accelerations at the middle, half drift, and the
motors with exact stick. `generated` turns what is recorded here into functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fuzzyarm.envs.physics.friction import DryFriction
from fuzzyarm.envs.physics.recursion import (
    NOTHING,
    Turn,
    composite_bodies,
    factors,
    newton_euler,
    point_of_tip,
    regrouped,
    solution,
    velocity_of_tip,
)
from fuzzyarm.envs.physics.structure import Structure, bodies_of, chain_of, gravity_of
from fuzzyarm.envs.physics.tracer import Expression, Tracer

__all__ = ["FUNCTIONS", "LOADS", "Model"]

LOADS = ("payload", "place", "tip_payload")
"""Arguments beside the plant that the constants of an arm are computed from."""

STATE = ("motor", "link", "motor_velocity", "link_velocity")


class Model:
    """The robot in symbols: its frames and links, and its equations as functions of symbols."""

    def __init__(self, structure: Structure) -> None:
        self.tracer, self.structure = Tracer(), structure
        self.plant = {name: self.tracer.input(f"plant.{name}", fixed=True) for name in structure.numbers}
        loads = [self.tracer.input(name, fixed=True) for name in LOADS]
        self.chain = chain_of(structure, self.number)
        self.bodies = regrouped(self.chain, bodies_of(structure, self.number, *loads))
        self.gravity = gravity_of(self.number)

    def number(self, name: str) -> Any:
        """Return the symbol for a number of the robot, or 0."""
        return self.plant.get(name, 0.0)

    def per_joint(self, name: str) -> list[Any]:
        """Return the symbols for a quantity of each joint."""
        return [self.number(f"{name}{k}") for k in self.structure.joints]

    def inputs(self, name: str) -> list[Expression]:
        """Return the symbols for an argument that is a `PerJoint`."""
        return [self.tracer.input(f"{name}.joint{k}") for k in self.structure.joints]

    def force(self) -> tuple[Any, Any, Any]:
        """Return the symbols for the argument `force`, a `Point`."""
        x, y = self.tracer.input("force.x"), self.tracer.input("force.y")
        return (x, y, 0.0) if self.structure.planar else (x, y, self.tracer.input("force.z"))

    def turns(self, angles: Sequence[Expression]) -> list[Turn]:
        """Return sine and cosine of each angle."""
        pairs = [self.tracer.call("sine_cosine", [angle], 2) for angle in angles]
        return [(sine, cosine) for sine, cosine in pairs]

    def torques(self, turns: Sequence[Turn], rates: Any, accelerations: Any, force: Any = (0.0, 0.0, 0.0)) -> list[Any]:
        """Return M(q) q̈ + C(q, q̇) q̇ + g(q) - J(q)ᵀ F."""
        return newton_euler(self.chain, self.bodies, turns, rates, accelerations, self.gravity, force)

    def spring(self, motor: Any, link: Any, motor_velocity: Any, link_velocity: Any) -> list[Any]:
        """Return Γ_t = k_t (q_a - q_b) + b_t (q̇_a - q̇_b)."""
        drives = zip(self.per_joint("stiffness"), self.per_joint("damping"), strict=True)
        return [
            k * (motor[i] - link[i]) + b * (motor_velocity[i] - link_velocity[i]) for i, (k, b) in enumerate(drives)
        ]


def _step(model: Model) -> list[Any]:
    """Return the state a sub-step later under a tip force."""
    return _advanced(model, model.force(), [0.0] * len(model.structure.rotations))


def _loaded_step(model: Model) -> list[Any]:
    """Return the state a sub-step later under torques on the links."""
    return _advanced(model, (0.0, 0.0, 0.0), model.inputs("load"))


def _advanced(model: Model, force: tuple[Any, Any, Any], load: Sequence[Any]) -> list[Any]:
    """Return the state a sub-step later: motor and link angles, motor and link velocities."""
    motor, link, motor_velocity, link_velocity = (model.inputs(f"state.{name}") for name in STATE)
    torque, h = model.inputs("torque"), model.tracer.input("h")
    half = 0.5 * h
    motor_middle = [q + half * v for q, v in zip(motor, motor_velocity, strict=True)]
    middle = [q + half * v for q, v in zip(link, link_velocity, strict=True)]
    turns = model.turns(middle)
    below, inverse = factors(composite_bodies(model.chain, model.bodies, turns))
    still = [0.0] * len(link)

    def kick(motor_rate: Any, link_rate: Any, duration: Expression) -> tuple[list[Any], list[Any], list[Any]]:
        """Return the velocities a duration after the start, and the angles the motors travelled."""
        spring = model.spring(motor_middle, middle, motor_rate, link_rate)
        outer = model.torques(turns, link_rate, still, force)
        acceleration = solution(below, inverse, [a - b + c for a, b, c in zip(spring, outer, load, strict=True)])
        moved = [
            _motor_kick(model, k, v, rate, torque[i] - spring[i], duration)
            for i, (k, v, rate) in enumerate(zip(model.structure.joints, motor_velocity, motor_rate, strict=True))
        ]
        links = [v + duration * a for v, a in zip(link_velocity, acceleration, strict=True)]
        return [v for v, _ in moved], links, [angle for _, angle in moved]

    motor_rate, link_rate, _ = kick(motor_velocity, link_velocity, half)
    motor_rate, link_rate, travelled = kick(motor_rate, link_rate, h)
    motor = [q + angle for q, angle in zip(motor, travelled, strict=True)]
    link = [q + half * v for q, v in zip(middle, link_rate, strict=True)]
    return [*motor, *link, *motor_rate, *link_rate]


def _motor_kick(model: Model, k: int, start: Any, rate: Any, net: Any, duration: Any) -> tuple[Expression, ...]:
    """Return velocity and travelled angle of motor k after a duration, with the torques at a velocity `rate`."""
    inverse = 1.0 / model.number(f"motor_inertia{k}")
    dry = [model.number(f"{name}{k}") for name in DryFriction._fields]
    (magnitude,) = model.tracer.call("stribeck_magnitude", [rate, *dry], 1)
    acceleration = (net - model.number(f"viscous_friction{k}") * rate) * inverse
    return model.tracer.call("stick_slip", [start, acceleration, magnitude * inverse, duration], 2)


def _motor_friction(model: Model) -> list[Any]:
    """Return Γ_f of the motors."""
    motor, link, motor_velocity, link_velocity = (model.inputs(f"state.{name}") for name in STATE)
    spring, friction = model.spring(motor, link, motor_velocity, link_velocity), list[Any]()
    for k, v, torque, bias, load in zip(
        model.structure.joints, motor_velocity, model.inputs("torque"), model.inputs("bias"), spring, strict=True
    ):
        numbers = [model.number(f"{name}{k}") for name in DryFriction._fields]
        friction.extend(model.tracer.call("friction_torque", [v, torque + bias - load, *numbers], 1))
    return friction


def _tip(model: Model) -> list[Any]:
    point = point_of_tip(model.chain, model.turns(model.inputs("angles")))
    return list(point[:2] if model.structure.planar else point)


def _tip_velocity(model: Model) -> list[Any]:
    velocity = velocity_of_tip(model.chain, model.turns(model.inputs("angles")), model.inputs("rates"))
    return list(velocity[:2] if model.structure.planar else velocity)


def _tip_load(model: Model) -> list[Any]:
    """Return J(q)ᵀ F: less the torque that holds an arm at rest, without gravity, under the force."""
    still, turns = [0.0] * len(model.structure.rotations), model.turns(model.inputs("angles"))
    held = newton_euler(model.chain, model.bodies, turns, still, still, NOTHING, model.force())
    return [0.0 - torque for torque in held]


def _gravity(model: Model) -> list[Any]:
    still = [0.0] * len(model.structure.rotations)
    return model.torques(model.turns(model.inputs("angles")), still, still)


def _inverse_dynamics(model: Model) -> list[Any]:
    turns = model.turns(model.inputs("angles"))
    return model.torques(turns, model.inputs("rates"), model.inputs("accelerations"))


def _mass_matrix(model: Model) -> list[Any]:
    lower = composite_bodies(model.chain, model.bodies, model.turns(model.inputs("angles")))
    joints = range(len(lower))
    return [lower[max(i, j)][min(i, j)] for i in joints for j in joints]


FUNCTIONS: dict[str, tuple[str, Callable[[Model], list[Any]]]] = {
    "step": ("state, torque, force, arm, h", _step),
    "loaded_step": ("state, torque, load, arm, h", _loaded_step),
    "tip": ("angles, arm", _tip),
    "tip_velocity": ("angles, rates, arm", _tip_velocity),
    "tip_load": ("angles, force, arm", _tip_load),
    "gravity": ("angles, arm", _gravity),
    "inverse_dynamics": ("angles, rates, accelerations, arm", _inverse_dynamics),
    "mass_matrix": ("angles, arm", _mass_matrix),
    "motor_friction": ("state, torque, bias, arm", _motor_friction),
}
"""By the name of a function of `Physics`: its arguments, and the numbers it returns, as expressions."""
