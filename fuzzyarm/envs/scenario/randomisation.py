"""Domain randomisation: data that describe how plants, loads, initial states and references of episodes vary.

Every quantity of an episode is drawn independently and uniformly from a range; a range of zero width
keeps the nominal value, so the default randomisation varies nothing.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.records import columns, per_joint, places, record_type, size
from fuzzyarm.envs.scenario.default_reference import reference_family
from fuzzyarm.envs.scenario.reference import Reference

__all__ = ["ALLOWED", "DomainRandomisation", "Range", "by_quantity", "draw_record", "find_randomisation"]

Range = tuple[float, float]  # lowest and highest value of a draw
_HEAVIEST = 5.0 / 24.0  # largest payload of "robust" over the mass of the links; 5 kg for the paper's arm


@functools.cache
def draw_record(joints: int) -> Any:
    """Return the record type of what one episode draws: scalars, or arrays with one value per lane.

    There are factors, one per joint, of the link's mass and inertia, of the motor's inertia, of joint stiffness and
    damping, of dry friction (the same for static and Coulomb friction) and of viscous friction. Then follow the payload
    [kg] added to that of the case, the factor of the case's tip force, the angles [rad] by which the initial state
    differs from the reference, and the index of the reference in the family (0 without a family).
    """
    factors = dict.fromkeys(
        ("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction"), per_joint(joints)
    )
    return record_type("Draw", **factors, payload=Any, force=Any, angle=per_joint(joints), reference=Any)


def _range(nominal: float, low: float, high: float, unit: str = "") -> Any:
    """Return a dataclass field for a range within [low, high]; by default, the range is the nominal value alone."""
    return dataclasses.field(default=(nominal, nominal), metadata={"allowed": (low, high, unit)})


@dataclasses.dataclass(frozen=True)
class DomainRandomisation:
    """Ranges (low, high) of the uniform distributions of an episode; the defaults vary nothing.

    Attributes:
        mass: factor on each link's mass and inertia, one draw per link.
        motor_inertia: factor on each motor's inertia.
        stiffness: factor on each joint's stiffness.
        damping: factor on each joint's damping.
        dry_friction: factor on each motor's static and Coulomb friction, one draw for both.
        viscous_friction: factor on each motor's viscous friction.
        payload: mass at the tip [kg], added to the case's own payload.
        force: factor on the case's tip force, if the case has one.
        angle: initial offset of each joint from the reference [rad].
        references: family from which each episode draws one, in place of the environment's reference; all must be for
            the arm's link lengths. Empty: no draw.

    Raises:
        TypeError: a range is not of real numbers, or the references are not `Reference` objects.
        ValueError: a range is not a pair low <= high, or exceeds its allowed range.

    Examples:
        >>> DomainRandomisation(payload=(0.0, 5.0), stiffness=(0.8, 1.2)).payload
        (0.0, 5.0)
    """

    mass: Range = _range(1.0, 0.01, 100.0)
    motor_inertia: Range = _range(1.0, 0.01, 100.0)
    stiffness: Range = _range(1.0, 0.01, 100.0)
    damping: Range = _range(1.0, 0.0, 100.0)
    dry_friction: Range = _range(1.0, 0.0, 100.0)
    viscous_friction: Range = _range(1.0, 0.0, 100.0)
    payload: Range = _range(0.0, 0.0, 1000.0, "kg")
    force: Range = _range(1.0, 0.0, 100.0)
    angle: Range = _range(0.0, -0.5, 0.5, "rad")
    references: tuple[Reference, ...] = ()

    def __post_init__(self) -> None:
        for name, (low, high, unit) in ALLOWED.items():
            given = checks.interval(f"DomainRandomisation.{name}", getattr(self, name), unit, low=low, high=high)
            checks.keep(self, name, given)
        if not isinstance(self.references, tuple | list):
            raise TypeError(
                f"DomainRandomisation.references = {checks.shown(self.references)} must be a list of references"
            )
        checks.keep(self, "references", tuple(self.references))
        for reference in self.references:
            checks.instance("DomainRandomisation.references: entry", reference, Reference)  # type: ignore[type-abstract]

    @property
    def varies(self) -> bool:
        """Whether an episode draws anything at random."""
        return bool(self.references) or any(low < high for low, high in map(self.__getattribute__, ALLOWED))

    def ranges(self, joints: int) -> np.ndarray:
        """Return rows (low, high), one per number of `draw_record`; the reference's row is (0, len(references))."""
        kind = draw_record(joints)
        table = np.empty((size(kind), 2))
        for name, where in columns(kind)._asdict().items():
            table[where] = (0.0, len(self.references)) if name == "reference" else getattr(self, name)
        return table


ALLOWED: dict[str, tuple[float, float, str]] = {
    field.name: field.metadata["allowed"] for field in dataclasses.fields(DomainRandomisation) if field.metadata
}
"""By field of `DomainRandomisation`: the lowest and the highest value allowed, and the unit."""


def by_quantity(drawn: np.ndarray, joints: int) -> dict[str, np.ndarray]:
    """Return read-only views of draws (numbers of `draw_record`, lanes) by quantity: (lanes, joints) or (lanes,)."""
    quantities = {}
    for name, place in places(draw_record(joints))._asdict().items():
        quantities[name] = drawn[slice(place[0], place[-1] + 1)].T if isinstance(place, tuple) else drawn[place]
        quantities[name].flags.writeable = False  # every step's info shows the same arrays
    return quantities


_PLANTS = DomainRandomisation(
    mass=(0.9, 1.1),
    motor_inertia=(0.9, 1.1),
    stiffness=(0.8, 1.2),
    damping=(0.5, 1.5),
    dry_friction=(0.5, 1.5),
    viscous_friction=(0.5, 1.5),
)


def _robust(arm: AnyArm) -> DomainRandomisation:
    return dataclasses.replace(
        _PLANTS,
        payload=(0.0, _HEAVIEST * float(np.sum(robot_of(arm).arrays.mass))),
        force=(0.0, 1.0),
        angle=(-0.01, 0.01),
        references=reference_family(arm),
    )


# The randomisation for an arm, by name.
_NAMED: dict[str, Callable[[AnyArm], DomainRandomisation]] = {
    "nominal": lambda arm: DomainRandomisation(),
    "plants": lambda arm: _PLANTS,
    "robust": _robust,
}


def find_randomisation(randomisation: str | DomainRandomisation, arm: AnyArm) -> DomainRandomisation:
    """Return the given randomisation, or the named one for this arm; ValueError names the choices."""
    if isinstance(randomisation, DomainRandomisation):
        return randomisation
    if not isinstance(randomisation, str) or randomisation not in _NAMED:
        raise ValueError(
            f"unknown randomisation {checks.shown(randomisation)}; choose from: {', '.join(_NAMED)}, "
            "or give a DomainRandomisation"
        )
    return _NAMED[randomisation](arm)
