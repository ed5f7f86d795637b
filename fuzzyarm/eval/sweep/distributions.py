"""The distributions of plants that a sweep draws from: domain randomisation, encoder noise and control delay."""

from __future__ import annotations

import dataclasses

from fuzzyarm.common.checks import interval
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, Range, find_randomisation
from fuzzyarm.eval.sweep.quantities import QUANTITIES, columns_of

__all__ = ["DISTRIBUTIONS", "Distribution", "distribution_for"]


@dataclasses.dataclass(frozen=True)
class Distribution:
    """Ranges (low, high) of independent, uniformly distributed quantities.

    The environment draws the first eight as its own domain randomisation, see `DomainRandomisation`.

    Attributes:
        mass: factor of each link's mass and inertia, a draw per link.
        motor_inertia: factor of each motor's inertia.
        stiffness: factor of each joint's stiffness.
        damping: factor of each joint's damping.
        dry_friction: factor of each motor's static and Coulomb friction, one draw for both.
        viscous_friction: factor of each motor's viscous friction.
        payload: mass at the tip [kg], added to the case's own payload.
        force: factor of the case's tip force.
        noise: factor of the encoder noise `quantities.NOISE`.
        delay: whole control periods from a command to the motors.

    Raises:
        TypeError: a range is no pair of numbers.
        ValueError: the pair is not low <= high, or exceeds what is allowed for it.
    """

    mass: Range = (1.0, 1.0)
    motor_inertia: Range = (1.0, 1.0)
    stiffness: Range = (1.0, 1.0)
    damping: Range = (1.0, 1.0)
    dry_friction: Range = (1.0, 1.0)
    viscous_friction: Range = (1.0, 1.0)
    payload: Range = (0.0, 0.0)
    force: Range = (1.0, 1.0)
    noise: Range = (0.0, 0.0)
    delay: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every range."""
        self.randomisation()
        for name, quantity in QUANTITIES.items():
            if quantity.highest is not None:
                interval(name, getattr(self, name), low=0.0, high=quantity.highest)
        if any(end != int(end) for end in self.delay):
            first, last = self.delay
            raise ValueError(f"delay from {first:g} to {last:g} must be whole control periods")

    def randomisation(self) -> DomainRandomisation:
        """Return the part that the environment draws: everything but noise and delay."""
        ranges = {name: getattr(self, name) for name, quantity in QUANTITIES.items() if quantity.highest is None}
        return DomainRandomisation(**ranges)

    def varying(self, joints: int) -> tuple[str, ...]:
        """Return the columns in which plants of so many joints differ."""
        ranges = dataclasses.asdict(self)
        different = {name for name, (low, high) in ranges.items() if low < high}
        return tuple(column.name for column in columns_of(joints).values() if column.quantity in different)


HEAVIEST = 5.0  # kg, the payload of the paper's case


def distribution_for(name: str, arm: AnyArm) -> Distribution:
    """Return the distribution called `name` for an arm: payloads up to that of its case ``payload`` [kg]."""
    found = DISTRIBUTIONS[name]
    low, high = found.payload
    scale = case_for("payload", arm).disturbance.payload.mass / HEAVIEST
    return dataclasses.replace(found, payload=(scale * low, scale * high))


def _distributions() -> dict[str, Distribution]:
    drawn = find_randomisation("plants", ArmParameters())
    plants = Distribution(**{name: getattr(drawn, name) for name, quantity in QUANTITIES.items() if quantity.per_joint})
    loads = dataclasses.replace(plants, payload=(0.0, HEAVIEST), force=(0.5, 1.5))
    return {
        "nominal": Distribution(),
        "plants": plants,
        "loads": loads,
        "all": dataclasses.replace(loads, noise=(0.0, 2.0), delay=(0.0, 2.0)),
    }


DISTRIBUTIONS = _distributions()
"""Those of the two-joint arm by name: ``nominal`` varies nothing; ``plants`` is the environment's randomisation of that
name; ``loads`` adds payload and tip force; ``all`` adds encoder noise and delay."""
