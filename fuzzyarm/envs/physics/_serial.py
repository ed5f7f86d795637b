"""The equations of motion of a serial robot as `Physics`: the recursive algorithms on its frames, links and drives.

Robots with the same *structure*, that is, the same rotations between their frames and the same zeros, have the same
equations, which omit zero terms (see `Folded`). Constants of the arm are computed once per episode: the `Arm` contains
the numbers of the regrouped links that the equations need (see `recursion`), that is, moment1x, moment1y,
inertia1xx, ..., position1x, ..., tipx, ..., gravityx, ..., and the fields of `Motor`.
"""

import dataclasses
import functools
import hashlib
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics import _recursion as recursion
from fuzzyarm.envs.physics._recursion import (
    NOTHING,
    Body,
    Chain,
    Folded,
    Inertia,
    Vector,
    rotated,
    transposed,
    unfolded,
)
from fuzzyarm.envs.physics.dynamics import Motor, motor_friction
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import DryFriction
from fuzzyarm.envs.physics.integrator import advanced
from fuzzyarm.envs.physics.joint import DIMENSIONS, DRIVE_UNITS, as_rows
from fuzzyarm.envs.physics.records import VARIED, Physics, flat, per_joint, places, point, record_type, state_record
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.numbers.functions import zeros
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Symbol

__all__ = ["physics_of", "structure_of"]

_Rows = tuple[tuple[float, ...], ...]

_LIMITS = ("angle_low", "angle_high", "velocity_limit")
_AXES = "xyz"
_ENTRIES = Inertia._fields
_PLANAR_JOINTS = 2  # number of joints of the arm whose tip has two coordinates, the paper's
_UNTURNED = as_rows(np.eye(DIMENSIONS))
_ROUNDING = 1e-15  # of products of rotations


class Structure(NamedTuple):  # its name is part of the digests of states
    """The structure shared by robots with the same equations, see the module."""

    # of each joint frame in the frame before, after each frame has been turned so that its joint axis is z
    rotations: tuple[_Rows, ...]
    frames: tuple[_Rows, ...]  # this turn for each joint; the columns are the new axes in the old frame
    planar: bool  # whether it is an arm of two joints in a plane, whose tip has two coordinates
    numbers: tuple[str, ...]  # names of the numbers of a `Plant`, in order; all other numbers of the robot are zero


def physics_of(robot: Robot) -> Physics:
    """Return the equations of motion of a robot; robots of one structure share one object."""
    return _physics(structure_of(robot))


def structure_of(robot: Robot) -> Structure:
    """Return the structure of a robot, which is hashable and equal for robots with the same equations."""
    now = robot.arrays
    frames = [_frame(axis) for axis in now.axis]
    before = [np.eye(DIMENSIONS), *frames[:-1]]
    rotations = [a.T @ r @ b for a, r, b in zip(before, now.rotation, frames, strict=True)]
    numbers = _numbers_of(robot)
    heights = np.concatenate([now.position[:, -1], now.tip[-1:], now.gravity[-1:]])
    upright = bool((now.axis[:, -1] == 1.0).all() and (now.rotation[:, -1, -1] == 1.0).all())
    planar = len(robot) == _PLANAR_JOINTS and upright and not heights.any()
    kept = (*DRIVE_UNITS, *_LIMITS, "mass")  # even if they are zero
    names = [name for name, value in numbers.items() if value != 0.0 or name.rstrip("0123456789") in kept]
    return Structure(tuple(map(_exact, rotations)), tuple(map(_exact, frames)), planar, tuple(names))


def _numbers_of(robot: Robot) -> dict[str, float]:
    """Return every parameter of a robot by name: mass1, center1x, inertia1xy, stiffness1, ..., tipx, gravityz."""
    found: dict[str, float] = {}
    for k, joint in enumerate(robot.joints, start=1):
        found[f"mass{k}"] = joint.link.mass
        found |= _named(f"center{k}", joint.link.center)
        found |= _named(f"inertia{k}", np.array(joint.link.inertia)[np.triu_indices(DIMENSIONS)].tolist(), _ENTRIES)
        found |= _named(f"position{k}", joint.position)
        found |= {f"{name}{k}": getattr(joint.drive, name) for name in DRIVE_UNITS}
        found |= zip((f"{name}{k}" for name in _LIMITS), (*joint.angle_range, joint.velocity_limit), strict=True)
    return found | dict(_named("tip", robot.tip)) | dict(_named("gravity", robot.gravity))


def _named(name: str, numbers: Iterable[Any], parts: Iterable[str] = _AXES) -> Iterator[tuple[str, Any]]:
    return ((name + part, number) for part, number in zip(parts, numbers, strict=True))


class _Serial:
    """The functions of `Physics` for robots of one structure."""

    def __init__(self, structure: Structure) -> None:
        self.structure, self.joints = structure, len(structure.rotations)
        self.PerJoint, self.Point = per_joint(self.joints), point(2 if structure.planar else DIMENSIONS)
        self.State = state_record(self.joints)
        self.Plant = record_type("Plant", **dict.fromkeys(structure.numbers, Any))
        limits = dict.fromkeys(("low", "high", "velocity", "torque"), self.PerJoint)
        self.Limits = record_type("Limits", **limits)
        motors = {f"{name}{k}": kind for k in range(1, self.joints + 1) for name, kind in _MOTOR.items()}
        constants = dict.fromkeys(self._constants(zeros(places(self.Plant)), 0.0, 0.0, 0.0), Any)
        self.Arm = record_type("Arm", **constants, **motors)
        needed = self._needed()
        parts = [re.split(r"(\d+)", name, maxsplit=1) for name in structure.numbers]  # quantity, joint, component
        self._factors = [(VARIED.get(quantity), f"joint{''.join(rest[:1])}") for quantity, *rest in parts]
        self._link_constants = [name for name in constants if name in needed]
        self.Arm = record_type("Arm", **dict.fromkeys(self._link_constants, Any), **motors)

    def _needed(self) -> set[str]:
        """Return the names of the constants on which the equations depend."""
        found = set[str]()

        def record(state: Any, arm: Any, force: Any, _: Any) -> Any:
            motor, link, motor_velocity, link_velocity = state
            waiting = flat(
                (
                    self.step(state, motor, force, arm, 1.0),
                    self.tip(link, arm),
                    self.tip_velocity(link, link_velocity, arm),
                    self.inverse_dynamics(link, link_velocity, motor_velocity, arm),
                )
            )
            names, seen = {id(number): name for name, number in arm._asdict().items()}, set()
            while waiting:
                number = waiting.pop()
                if isinstance(number, Symbol) and id(number) not in seen:
                    seen.add(id(number))
                    waiting.extend(number.operands)
            found.update(names[one] for one in seen & set(names))
            return state, arm, force

        Program(record, [zeros(places(kind)) for kind in (self.State, self.Arm, self.Point)])
        return found

    def plant_of(self, robot: Robot) -> Any:
        numbers = _numbers_of(robot)
        return self.Plant(*(numbers[name] for name in self.structure.numbers))

    def constants(self, plant: Any, payload: Any, place: Any, tip_payload: Any) -> Any:
        """Return the `Arm` of a plant that carries two point masses [kg]; the arguments are as for `_bodies`."""
        numbers = self._constants(plant, payload, place, tip_payload)
        motors = (_motor(plant, k) for k in range(1, self.joints + 1))
        return self.Arm(*(numbers[name] for name in self._link_constants), *itertools.chain(*motors))

    def _constants(self, plant: Any, payload: Any, place: Any, tip_payload: Any) -> dict[str, Any]:
        """Return the constants of the links by name, without those that are zero for this structure; see `_bodies`."""
        frames = self.structure.frames
        before = enumerate([_UNTURNED, *frames[:-1]], start=1)
        positions = [rotated(transposed(frame), _vector(plant, f"position{k}")) for k, frame in before]
        tip = rotated(transposed(frames[-1]), _vector(plant, "tip"))
        bodies = self._bodies(plant, *map(Folded, (payload, place, tip_payload)))
        bodies = Chain(self.structure.rotations, positions, tip, bodies).regrouped()
        found = dict(_named("tip", tip)) | dict(_named("gravity", _vector(plant, "gravity")))
        for k, (position, body) in enumerate(zip(positions, bodies, strict=True), start=1):
            found |= _named(f"position{k}", position)
            found |= _named(f"moment{k}", body.moment)
            found |= _named(f"inertia{k}", body.inertia, _ENTRIES)
        return {name: unfolded(number) for name, number in found.items() if isinstance(number, Folded)}

    def _bodies(self, plant: Any, payload: Any, place: Any, tip_payload: Any) -> list[Body]:
        """Return the links of `plant`; the last carries masses [kg]: `tip_payload` at the tip, `payload` at `place`.

        `place` is 0 at the link's mass center and 1 at its tip.
        """
        bodies = []
        for k, frame in enumerate(self.structure.frames, start=1):
            back, center = transposed(frame), _vector(plant, f"center{k}")
            at_center = Body(_number(plant, f"mass{k}"), NOTHING, recursion.rotated_inertia(back, _inertia(plant, k)))
            bodies.append(recursion.moved(at_center, _UNTURNED, rotated(back, center)))
        tip = rotated(back, _vector(plant, "tip"))
        between = tuple(c + place * (t - c) for c, t in zip(rotated(back, center), tip, strict=True))
        for mass, at in ((payload, between), (tip_payload, tip)):
            carried = Body(mass, NOTHING, Inertia(*[0.0] * len(_ENTRIES)))
            bodies[-1] = recursion.joined(bodies[-1], recursion.moved(carried, _UNTURNED, at))
        return bodies

    def _links(self, arm: Any) -> Chain:
        """Return the frames and links of an arm as a chain without joint angles; the links are `regrouped`."""
        joints = range(1, self.joints + 1)
        positions, tip = [_vector(arm, f"position{k}") for k in joints], _vector(arm, "tip")
        bodies = [Body(0.0, _vector(arm, f"moment{k}"), _inertia(arm, k)) for k in joints]
        return Chain(self.structure.rotations, positions, tip, bodies)

    def _at(self, angles: Any, arm: Any) -> Chain:
        return _turned(self._links(arm), angles)

    def _in_space(self, force: Any) -> Vector:
        """Return a force as a vector with three components; the third one is 0 for a planar arm."""
        x, y, z = (*_folded(force), 0.0)[:DIMENSIONS]
        return x, y, z

    def step(self, state: Any, torque: Any, force: Any, arm: Any, h: Any) -> Any:
        at = self._accelerations(self._in_space(force), [0.0] * self.joints, arm)
        return advanced(state, torque, at, arm, h)

    def loaded_step(self, state: Any, torque: Any, load: Any, arm: Any, h: Any) -> Any:
        return advanced(state, torque, self._accelerations(NOTHING, _folded(load), arm), arm, h)

    def _accelerations(self, force: Vector, load: Sequence[Any], arm: Any) -> Callable[[Any], Any]:
        """Return the function `at` that `advanced` takes, for a tip force [N] and torques `load` on the links [N m]."""
        links, still, gravity = self._links(arm), [0.0] * self.joints, _vector(arm, "gravity")

        def at(link: Any) -> Callable[[Any, Any], Any]:
            now = _turned(links, link)
            solution, outside = recursion.solver(now.mass_matrix()), now.in_last_frame(force)

            def accelerations(joint: Any, rates: Any) -> Any:
                outer = now.torques(_folded(rates), still, gravity, outside)
                right = [Folded(a) - b + c for a, b, c in zip(joint, outer, load, strict=True)]
                return self.PerJoint(*map(unfolded, solution(right)))

            return accelerations

        return at

    def tip(self, angles: Any, arm: Any) -> Any:
        return self._vector(self._at(angles, arm).tip_point(), angles)

    def tip_velocity(self, angles: Any, rates: Any, arm: Any) -> Any:
        return self._vector(self._at(angles, arm).tip_velocity(_folded(rates)), angles)

    def _vector(self, vector: Vector, angles: Any) -> Any:
        return self.Point(*_like(vector[: len(self.Point._fields)], angles))

    def tip_load(self, angles: Any, force: Any, arm: Any) -> Any:
        """Return J(q)ᵀ F [N m], the joint torques that correspond to a force F [N] on the tip at joint angles q."""
        still, now = [0.0] * self.joints, self._at(angles, arm)
        held = now.torques(still, still, NOTHING, now.in_last_frame(self._in_space(force)))
        return self.PerJoint(*_like([-torque for torque in held], angles))

    def gravity(self, angles: Any, arm: Any) -> Any:
        still = [0.0] * self.joints
        found = self._at(angles, arm).torques(still, still, _vector(arm, "gravity"))
        return self.PerJoint(*_like(found, angles))

    def inverse_dynamics(self, angles: Any, rates: Any, accelerations: Any, arm: Any) -> Any:
        found = self._at(angles, arm).torques(_folded(rates), _folded(accelerations), _vector(arm, "gravity"))
        return self.PerJoint(*map(unfolded, found))

    def mass_matrix(self, angles: Any, arm: Any) -> Any:
        lower, joints = self._at(angles, arm).mass_matrix(), range(self.joints)
        return tuple(tuple(_like([lower[max(i, j)][min(i, j)] for j in joints], angles)) for i in joints)

    def stiffness(self, plant: Any) -> Any:
        return self._per_joint(plant, "stiffness")

    def limits(self, plant: Any) -> Any:
        return self.Limits(*(self._per_joint(plant, name) for name in (*_LIMITS, "torque_limit")))

    def _per_joint(self, plant: Any, name: str) -> Any:
        return self.PerJoint(*(getattr(plant, f"{name}{k}") for k in range(1, self.joints + 1)))

    def varied(self, plant: Any, draw: Any) -> Any:
        factors = (getattr(getattr(draw, name), joint) if name else None for name, joint in self._factors)
        varied = (number if one is None else number * one for number, one in zip(plant, factors, strict=True))
        return self.Plant(*varied)


_PLANT_NAMES = ("motor_inertia", "viscous_friction", "stiffness", "damping", *DryFriction._fields)
_MOTOR = dict.fromkeys(Motor._fields, Any) | {"dry_friction": DryFriction}


@functools.cache
def _physics(structure: Structure) -> Physics:
    own = _Serial(structure)
    same = {
        field.name: getattr(own, field.name)
        for field in dataclasses.fields(Physics)
        if field.init and hasattr(own, field.name)
    }
    return Physics(
        **same, axes=len(own.Point._fields), made_by=(_physics, (structure,)), motor_friction=motor_friction,
        digest=hashlib.sha256(repr((structure, own.Arm._fields)).encode()).hexdigest()[:16],
        payload_place=lambda payload, robot: float(payload.at == "tip"),
        angle_range=lambda limits: (limits.low, limits.high),
    )  # fmt: skip


def _motor(plant: Any, k: int) -> Motor:
    inertia, viscous, stiffness, damping, *dry = (getattr(plant, f"{name}{k}") for name in _PLANT_NAMES)
    return Motor(inertia, viscous, stiffness, damping, DryFriction(*dry))


def _folded(numbers: Iterable[Any]) -> list[Folded]:
    return [Folded(number) for number in numbers]


def _number(record: Any, name: str) -> Any:
    """Return the named constant of a plant or an arm; 0 if it does not have that constant."""
    return Folded(getattr(record, name)) if name in record._fields else 0.0


def _vector(record: Any, name: str) -> Vector:
    x, y, z = (_number(record, name + axis) for axis in _AXES)
    return x, y, z


def _inertia(record: Any, k: int) -> Inertia:
    return Inertia(*(_number(record, f"inertia{k}{entry}") for entry in _ENTRIES))


def _turned(links: Chain, angles: Any) -> Chain:
    return links._replace(turns=[(Folded(sine), Folded(cosine)) for sine, cosine in map(sine_cosine, angles)])


def _like(numbers: Iterable[Any], angles: Any) -> list[Any]:
    """Return the numbers, even constant ones, as floats or arrays with the shape of one joint's angle."""
    return [unfolded(number) + 0.0 * angles[0] for number in numbers]


def _frame(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is the unit vector `axis`; if that is x, y or z, all entries are 0 or ±1."""
    along = int(np.abs(axis).argmax())
    first = np.eye(DIMENSIONS)[(along + (1 if axis[along] > 0.0 else 2)) % DIMENSIONS]
    first = first - (first @ axis) * axis
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=-1)


def _exact(rotation: np.ndarray) -> _Rows:
    """Return a rotation as rows in which each entry within rounding of 0, 1 or -1 is replaced by that number."""
    near = np.rint(rotation)
    return as_rows(np.where(np.abs(rotation - near) <= _ROUNDING, near, rotation) + 0.0)
