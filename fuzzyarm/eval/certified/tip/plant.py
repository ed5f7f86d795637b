"""The arm of a set in numbers: its middle, and what each uncertain constant adds.

    p = p_0 + Δp π_p,  |π_p| <= 1;      R(·; p) = R(·; p_0) + Σ Δp π_p R_p,      R_p: R with the constants ∂c/∂p,

because the constants c1..c5 of (3) are affine in the factors of the masses and in the payload, and R is linear in them.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from flint import arb

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, Plant, loaded, lump, plant_of
from fuzzyarm.envs.physics.friction import DRY_TORQUES
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, filled, flat
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.eval.certified.tip.enclosures import ball, between, centre
from fuzzyarm.eval.certified.tip.plant_set import BY_JOINT, PlantSet

__all__ = ["BallPlant", "Parameter", "ball_plant"]

_LUMPED = ("c1", "c2", "c3", "c4", "c5")
_ROUNDED = 2.0**-46  # relative: the environment computes c1..c5 in floats


@dataclasses.dataclass(frozen=True)
class Parameter:
    """An uncertain constant: p_0 ± `half`.

    Attributes:
        kind: "mass", "payload", "force", "stiffness", "damping", "motor_inertia", "viscous_friction", "dry_friction".
        joint: whose constant it is; 0 for the payload and the force.
        half: half the width of its range, in its unit; relative to the middle for dry friction and the force.
        arm: constants ∂c/∂p times `half`, for a mass or the payload.
    """

    kind: str
    joint: int
    half: float
    arm: Arm | None = None

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return self.kind if self.kind in ("payload", "force") else f"{self.kind} {self.joint + 1}"


@dataclasses.dataclass(frozen=True)
class BallPlant:
    """All arms of a set.

    Attributes:
        middle: constants in floats, of the arm in the middle.
        exact: the same in balls that hold the exact constants of that arm.
        parameters: what is uncertain.
        share: lowest and highest factor of the dry friction of each motor, relative to the middle.
    """

    middle: Arm
    exact: Arm
    parameters: tuple[Parameter, ...]
    share: tuple[tuple[float, float], ...]

    def half(self, kind: str) -> list[float]:
        """Return half the width of a constant's range by joint, 0 where it is certain."""
        widths = [0.0] * JOINTS
        for parameter in self.parameters:
            if parameter.kind == kind:
                widths[parameter.joint] = parameter.half
        return widths


def ball_plant(parameters: ArmParameters, disturbance: Disturbance, plants: PlantSet) -> BallPlant:
    """Return the arms of a set of plants around the given parameters, with the payload of a disturbance."""
    nominal = plant_of(parameters)
    middles = {name: [0.5 * sum(plants.of_joint(name, joint)) for joint in range(JOINTS)] for name in BY_JOINT}
    scaled: dict[str, Any] = {
        field: PerJoint(*(middle * x for middle, x in zip(middles[name], getattr(nominal, field), strict=True)))
        for name, fields in _FACTORS.items()
        for field in fields
    }
    plant = nominal._replace(**scaled)
    payload = disturbance.payload.mass, disturbance.payload.radius(parameters)
    extra = 0.5 * sum(plants.payload)
    uncertain = [
        Parameter(name, joint, half * getattr(nominal, fields[0])[joint])
        for name, fields in _FACTORS.items() if name not in ("mass", "dry_friction")
        for joint in range(JOINTS) if (half := _half(plants.of_joint(name, joint)))
    ]  # fmt: skip
    share = tuple(_share(plants.of_joint("dry_friction", joint)) for joint in range(JOINTS))
    uncertain += [
        Parameter("dry_friction", joint, max(1.0 - low, high - 1.0))
        for joint, (low, high) in enumerate(share)
        if low < high
    ]
    exact = _arm(_in_balls(plant), [payload, (extra, parameters.length[0 + 1])], ball(parameters.gravity))
    units = _mass_units(_in_balls(nominal), plants, parameters)
    if _half(plants.force) and disturbance.tip_force is not None:
        nothing = PerJoint(arb(0), arb(0))
        massless = lump(_in_balls(nominal)._replace(mass=nothing, inertia=nothing))
        units.append(Parameter("force", 0, _half(plants.force) / (0.5 * sum(plants.force)), massless))
    uncertain += units
    middle = filled(Arm, (centre(x) for x in flat(exact)))
    return BallPlant(middle, exact, tuple(uncertain), share)


_FACTORS = {
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "viscous_friction": ("viscous_friction",),
    "dry_friction": DRY_TORQUES,
}
"""The fields of `Plant` that a factor of the set scales, as in `randomisation.varied`."""


def _share(bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the lowest and the highest factor of the dry friction, relative to the middle."""
    middle = 0.5 * sum(bounds)
    low, high = (x / middle if middle else 1.0 for x in bounds)
    return (low - 2.0**-50, high + 2.0**-50 * high) if low < high else (low, high)


def _half(bounds: tuple[float, float]) -> float:
    return 0.5 * (bounds[1] - bounds[0]) + 2.0**-50 * max(1.0, bounds[1]) if bounds[0] < bounds[1] else 0.0


def _in_balls(plant: Any) -> Any:
    balls: list[Any] = [PerJoint(*map(arb, x)) if isinstance(x, tuple) else arb(x) for x in plant]
    return Plant(*balls)


def _arm(plant: Any, payloads: list[tuple[float, float]], gravity: Any) -> Arm:
    """Return the constants of a plant with payloads (mass [kg], distance from joint 2 [m]), in balls."""
    arm: Arm = lump(plant)
    for mass, radius in payloads:
        arm = loaded(arm, arb(mass), arb(radius), gravity)
    return arm._replace(**{name: getattr(arm, name) * between(1.0 - _ROUNDED, 1.0 + _ROUNDED) for name in _LUMPED})


def _mass_units(plant: Any, plants: PlantSet, parameters: ArmParameters) -> list[Parameter]:
    """Return the masses and the payload, where they are uncertain, with the constants that half their range makes."""
    found = []
    for joint in range(JOINTS):
        half = _half(plants.of_joint("mass", joint))
        if not half:
            continue
        scale = [arb(half) if j == joint else arb(0) for j in range(JOINTS)]
        part = plant._replace(
            mass=PerJoint(*(m * x for m, x in zip(plant.mass, scale, strict=True))),
            inertia=PerJoint(*(i * x for i, x in zip(plant.inertia, scale, strict=True))),
        )
        found.append(Parameter("mass", joint, half, lump(part)))
    if _half(plants.payload):
        nothing = PerJoint(arb(0), arb(0))
        empty = lump(plant._replace(mass=nothing, inertia=nothing))
        arm = loaded(empty, arb(_half(plants.payload)), arb(parameters.length[-1]), plant.gravity)
        found.append(Parameter("payload", 0, _half(plants.payload), arm))
    return found
