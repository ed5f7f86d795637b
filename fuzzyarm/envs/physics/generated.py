"""Equations of motion generated from the description of a robot: flat elementwise source for every number type.

`source_of` takes what `symbolic` records and writes it down as Python, an operation a line, for every kind of number.
What depends on the arm only, and not on its state, is not part of the step: `constants` computes it once an episode
from the `Plant`, the numbers of the robot, and the step finds it in the `Arm`.

The source holds names made in this package and numbers; no text of a robot's file gets into it.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import DryFriction, friction_torque, stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.physics import VARIED, Physics
from fuzzyarm.envs.physics.records import per_joint, point, record_type, state_record
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.physics.structure import Structure, numbers_of, structure_of
from fuzzyarm.envs.physics.symbolic import FUNCTIONS, LOADS, Model
from fuzzyarm.envs.physics.tracer import Expression, assignments, fixed_part

__all__ = ["Source", "physics_of", "source_of"]

CALLED: dict[str, Any] = {
    "sine_cosine": sine_cosine,
    "stick_slip": stick_slip,
    "stribeck_magnitude": lambda velocity, *dry: stribeck_magnitude(velocity, DryFriction(*dry)),
    "friction_torque": lambda velocity, net, *dry: friction_torque(velocity, net, DryFriction(*dry)),
}
"""What the source calls, of numbers one after the other."""


class Source(NamedTuple):
    """The generated source of one structure.

    Attributes:
        functions: by name, the source of a function.
        constants: names of the numbers of an `Arm`.
        operations: by name, how many lines a function has, calls included.
    """

    functions: dict[str, str]
    constants: tuple[str, ...]
    operations: dict[str, int]


@functools.cache
def source_of(structure: Structure) -> Source:
    """Return the source of the equations of motion of robots of one structure."""
    model = Model(structure)
    results = {
        name: [model.tracer.expression(number) for number in trace(model)] for name, (_, trace) in FUNCTIONS.items()
    }
    constants = fixed_part([expression for found in results.values() for expression in found])
    names = _constant_names(model, constants)
    known = {constant.place: f"arm.{name}" for constant, name in zip(constants, names, strict=True)}
    functions, operations = {}, {}
    for name, (arguments, _) in FUNCTIONS.items():
        lines, values = assignments(results[name], known)
        # What does not depend on the state has the shape of what does.
        like = f" + 0.0 * {arguments.split(',')[0]}{'.motor' if arguments.startswith('state') else ''}.joint1"
        values = [value + like * result.fixed for value, result in zip(values, results[name], strict=True)]
        functions[name] = _function(name, arguments, lines, _record(name, values, structure))
        operations[name] = len(lines)
    lines, values = assignments(constants, {})
    functions["constants"] = _function("constants", ", ".join(("plant", *LOADS)), lines, f"Arm({', '.join(values)})")
    functions |= _readings(structure)
    return Source(functions, names, operations | {"constants": len(lines)})


def physics_of(robot: Robot) -> Physics:
    """Return the equations of motion of a robot; robots of one structure have the same object."""
    return _physics(structure_of(robot))


@functools.cache
def _physics(structure: Structure) -> Physics:
    source, joints = source_of(structure), len(structure.rotations)
    PerJoint = per_joint(joints)
    limits = dict.fromkeys(("low", "high", "velocity", "torque"), PerJoint)
    records = {
        "PerJoint": PerJoint,
        "Point": point(2 if structure.planar else 3),
        "State": state_record(joints),
        "Plant": record_type("Plant", **dict.fromkeys(structure.numbers, Any)),
        "Arm": record_type("Arm", **dict.fromkeys(source.constants, Any)),
        "Limits": record_type("Limits", **limits),
    }
    functions = {name: _defined(text, records) for name, text in source.functions.items()}
    plant = records["Plant"]
    return Physics(
        joints=joints,
        axes=len(records["Point"]._fields),
        digest=hashlib.sha256("".join(source.functions.values()).encode()).hexdigest()[:16],
        made_by=(_physics, (structure,)),
        plant_of=lambda robot: plant(*(numbers_of(robot)[name] for name in structure.numbers)),
        payload_place=lambda payload, robot: float(payload.at == "tip"),
        Plant=plant,
        Arm=records["Arm"],
        Limits=records["Limits"],
        **functions,
    )


def _constant_names(model: Model, constants: Sequence[Expression]) -> tuple[str, ...]:
    """Return the names of the numbers of an `Arm`: the plant's for what is passed on, c0, c1, ... for the rest."""
    passed = {symbol.place: name for name, symbol in model.plant.items()}
    return tuple(passed.get(constant.place, f"c{k}") for k, constant in enumerate(constants))


def _record(name: str, values: Sequence[str], structure: Structure) -> str:
    """Return the source of what a function returns: a point, a `PerJoint`, or several of them as rows."""
    joints = len(structure.rotations)
    if name in ("tip", "tip_velocity"):
        return f"Point({', '.join(values)})"
    parts = [f"PerJoint({', '.join(values[k : k + joints])},)" for k in range(0, len(values), joints)]
    if name == "mass_matrix":
        return f"({', '.join(parts)},)".replace("PerJoint", "")
    return f"State({', '.join(parts)})" if len(parts) > 1 else parts[0]


def _function(name: str, arguments: str, lines: Sequence[str], result: str) -> str:
    return "\n    ".join([f"def {name}({arguments}):", *lines, f"return {result}"]) + "\n"


def _readings(structure: Structure) -> dict[str, str]:
    """Return the source of the functions that only take a `Plant` or its limits apart."""
    joints = structure.joints

    def per_joint_of(record: str, name: str) -> str:
        return f"PerJoint({', '.join(f'{record}.{name}{k}' for k in joints)},)"

    limits = ", ".join(
        per_joint_of("plant", name) for name in ("angle_low", "angle_high", "velocity_limit", "torque_limit")
    )
    varied = []
    for name in structure.numbers:
        parts = re.match(r"([a-z_]+)(\d+)", name)  # quantity and joint; tip and gravity have no joint
        factor = VARIED.get(parts[1]) if parts else None
        varied.append(f"plant.{name}" + (f" * draw.{factor}.joint{parts[2]}" if parts and factor else ""))
    return {
        "stiffness": _function("stiffness", "plant", [], per_joint_of("plant", "stiffness")),
        "limits": _function("limits", "plant", [], f"Limits({limits})"),
        "angle_range": _function("angle_range", "limits", [], "(limits.low, limits.high)"),
        "varied": _function("varied", "plant, draw", [], f"Plant({', '.join(varied)})"),
    }


def _defined(source: str, records: dict[str, Any]) -> Any:
    """Return the one function that a source defines, for use in compiled code."""
    defined: dict[str, Any] = {}
    exec(source, CALLED | records, defined)
    (function,) = defined.values()
    return function
