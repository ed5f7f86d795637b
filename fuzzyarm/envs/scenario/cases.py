"""Named cases: the three of the paper (section 6.2), and any others that are added.

The loads of the paper's cases are for its arm. `case_for` scales them for any other arm: the largest fraction of a
motor's torque limit that the payload or the machining force takes along its default reference is, to two digits, that
on the paper's arm along its circle; the force lasts as long as that reference. Where gravity has no leverage on the
motors, as on a horizontal arm, the payload is the same fraction of the links' mass as in the paper. `with_loads` sets
other loads.

A `Scenario` is the reference of one episode and the disturbance that acts on the arm.
"""

import dataclasses
import functools
import re
from typing import NamedTuple

import numpy as np

from fuzzyarm.common.checks import instance, shown, truth
from fuzzyarm.common.registry import Registry
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import tip_jacobian
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import Disturbance, MachiningForce
from fuzzyarm.envs.scenario.reference import Reference

__all__ = ["CASES", "PAPER_CASES", "Case", "Scenario", "add_case", "case_for", "find_case", "load_scale", "with_loads"]


class Scenario(NamedTuple):
    """A disturbance and the reference to be tracked under it."""

    disturbance: Disturbance  # what acts on the arm in addition to the controller
    # the motion to be tracked; None: each episode draws one from the domain randomisation's references
    reference: Reference | None


@dataclasses.dataclass(frozen=True)
class Case:
    """A named test case.

    Attributes:
        name: its key, as in ``gym.make(..., case=name)``.
        title: its title in tables and figures.
        disturbance: what acts on the arm.
        scales: whether the loads are those of the paper's arm, to be scaled for a robot.
    """

    name: str
    title: str
    disturbance: Disturbance
    scales: bool = False

    def __post_init__(self) -> None:
        instance("name", self.name, str)
        instance("title", self.title, str)
        instance("disturbance", self.disturbance, Disturbance)
        truth("scales", self.scales)


INSTANTS = 501  # instants of a reference at which the torques of a load are compared
_WEIGHTLESS = 1e-2  # share of the leverage of any force below which the leverage of gravity counts as 0
_SAME = 1e-6  # deviation of a factor of loads from 1 that counts as rounding

_PAPER = (
    Case("nominal", "Case 1: nominal", Disturbance()),
    Case("machining", "Case 2: machining force", Disturbance(tip_force=MachiningForce()), scales=True),
    Case("payload", "Case 3: 5 kg payload", Disturbance(payload=Payload(5.0)), scales=True),
)

PAPER_CASES: tuple[str, ...] = tuple(case.name for case in _PAPER)
"""The cases of the paper. Evaluations, training runs and comparisons use these unless other cases are named."""

CASES = Registry[Case](__name__, {case.name: case for case in _PAPER})
"""All known cases by name; `add_case` adds one."""


def add_case(case: Case) -> None:
    """Register a case by name in this process and the workers of its sweeps; ValueError if the name is taken."""
    if case.name in CASES:
        raise ValueError(f"case {case.name!r} already exists: {CASES[case.name].title}; choose another name")
    CASES[case.name] = case


def find_case(name: str) -> Case:
    """Return the case called `name`; ValueError names the choices."""
    if not isinstance(name, str) or name not in CASES:
        raise ValueError(
            f"unknown case {shown(name)}; choose from: {', '.join(CASES)}; to add a case in Python, "
            "call fuzzyarm.envs.scenario.cases.add_case in each process that uses it"
        )
    return CASES[name]


def case_for(name: str, arm: AnyArm) -> Case:
    """Return the case called `name` with the loads for an arm, see the module; ValueError names the choices."""
    case = find_case(name)
    paper, names = ArmParameters(), ("length", "torque_limit", "joint_limit", "velocity_limit")
    as_it_is = isinstance(arm, ArmParameters) and all(getattr(arm, name) == getattr(paper, name) for name in names)
    return case if as_it_is or not case.scales else _scaled(case, robot_of(arm))


def with_loads(
    case: Case, *, force: tuple[float, float] | None = None, payload: float | None = None, duration: float | None = None
) -> Case:
    """Return `case` with these loads and a title to match; None, or a load that the case lacks, changes nothing.

    `force`: smallest and largest machining force [N]; `duration`: that of the force [s]; `payload`: carried mass [kg].
    """
    loads, title = case.disturbance, case.title
    own_force, own_payload = loads.tip_force, loads.payload
    if isinstance(own_force, MachiningForce):
        base, swing = (own_force.base, own_force.swing) if force is None else (force[0], force[1] - force[0])
        lasts = own_force.duration if duration is None else duration
        own_force = MachiningForce(base, swing, lasts, own_force.fade_speed)
    if payload is not None and own_payload.mass > 0.0:
        own_payload = dataclasses.replace(own_payload, mass=payload)
        title = re.sub("[0-9.]+ kg", f"{own_payload.mass:g} kg", title)
    return dataclasses.replace(
        case, title=title, disturbance=dataclasses.replace(loads, tip_force=own_force, payload=own_payload)
    )


def load_scale(robot: Robot) -> tuple[float, float]:
    """Return the factors, to two digits, that scale the paper's tip forces and payloads to a robot; see the module."""
    force, mass = (_scaled_number(factor, 1.0) for factor in _factors(robot))
    return force, mass


@functools.lru_cache(maxsize=64)
def _scaled(case: Case, robot: Robot) -> Case:
    """Return a case with its loads scaled to a robot."""
    own, mass, (of_force, of_mass) = case.disturbance.tip_force, case.disturbance.payload.mass, _factors(robot)
    base, swing = (_scaled_number(of_force, getattr(own, part, 0.0)) for part in ("base", "swing"))
    duration = default_reference(robot).duration
    return with_loads(case, force=(base, base + swing), payload=_scaled_number(of_mass, mass), duration=duration)


@functools.lru_cache(maxsize=64)
def _factors(robot: Robot) -> tuple[float, float]:
    """Return the unrounded factors that scale the paper's tip forces (first) and payloads (second) to a robot."""
    paper = robot_of(ArmParameters())
    (along, down, _), (own_along, own_down, own_any) = _leverages(paper), _leverages(robot)
    has_weight = own_down > _WEIGHTLESS * own_any
    heavier = down / own_down if has_weight else float(np.sum(robot.arrays.mass) / np.sum(paper.arrays.mass))
    return along / own_along, heavier


def _leverages(robot: Robot) -> tuple[float, float, float]:
    """Return the largest share of a torque limit that 1 N at the tip takes.

    Three numbers: for a force along the path, along gravity, and in any direction.
    """
    reference, gravity = default_reference(robot), robot.arrays.gravity
    t = np.linspace(0.0, reference.duration, INSTANTS)
    down = np.broadcast_to(gravity if gravity.any() else np.array([0.0, 0.0, -1.0]), (len(t), 3))
    jacobian = tip_jacobian(robot, reference.sample(t).q) / robot.drive("torque_limit")
    directions = np.stack([reference.tip(t).velocity, down])
    length = np.linalg.norm(directions, axis=-1, keepdims=True)
    torque = np.einsum("tai,kta->kti", jacobian, directions / np.where(length > 0.0, length, 1.0))
    along, fallen = np.abs(torque).max(axis=(1, 2)).tolist()
    return along, fallen, float(np.max(np.linalg.norm(jacobian, axis=1)))


def _scaled_number(factor: float, number: float) -> float:
    return number if abs(factor - 1.0) < _SAME else float(f"{factor * number:.2g}")
