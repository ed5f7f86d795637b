"""The uncertain parameters of an arm: the table `[ranges]` of its file, and the arms at the ends of the ranges.

    [ranges]
    motor_inertia = [[0.002, 0.06], [0.004, 0.004]]    # lowest and highest of each joint [kg m²]
    stiffness = [[400.0, 1e5], [200.0, 5e4]]           # [N m/rad]

For an arm that hardly bends, a log of the motors reveals only the sum of the rotor and link inertias about each joint's
axis, and no stiffness. The author of its file therefore gives both ranges; the arm's own values must lie within them.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

from fuzzyarm.common import checks
from fuzzyarm.common.documents import record

__all__ = ["Ranges"]

_SMALLEST, _LARGEST = 1e-12, 1e12  # allowed ends of a range, in its unit
_UNITS = {"motor_inertia": "kg m^2", "stiffness": "N m/rad"}

_Intervals = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Ranges:
    """Ranges (low, high) of an arm's rotor inertias [kg m²] and stiffnesses [N m/rad], one per joint; (): none."""

    motor_inertia: _Intervals = ()
    stiffness: _Intervals = ()

    @classmethod
    def taken(cls, content: dict[str, Any]) -> Ranges:
        """Remove the table `[ranges]` from the content of a file and return it; empty if the file has no such table.

        Raises:
            ValueError: the table has an unknown field, or an entry that is not a range.
        """
        found = record(content.pop("ranges", {}), cls)
        for name, unit in _UNITS.items():
            for joint, ends in enumerate(getattr(found, name)):
                checks.interval(f"ranges: {name}[{joint}]", ends, unit, low=_SMALLEST, high=_LARGEST)
        return found

    def corners(self, arm: Any) -> dict[str, Any]:
        """Return, by description, the arms at the ends of the ranges: each quantity low or high, alike in all joints.

        If a rotor's inertia changes, the link's inertia changes by the opposite amount, see `with_drives` of both kinds
        of arm. The mapping is empty if no range is given.

        Args:
            arm: `ArmParameters` or `Robot`.

        Raises:
            ValueError: the ranges do not fit the joints of this arm, do not contain its values, or leave a link
                without positive inertia.
        """
        given = {name: getattr(self, name) for name in _UNITS if getattr(self, name)}
        for name, ranges in given.items():
            values = arm.drive(name).tolist()
            if len(ranges) != len(values):
                raise ValueError(f"ranges: {name} needs one range for each of {len(values)} joints, not {len(ranges)}")
            for joint, ((low, high), value) in enumerate(zip(ranges, values, strict=True)):
                checks.real(f"ranges: {name}[{joint}] of the arm", value, _UNITS[name], low=low, high=high)
        found = {}
        for ends in itertools.product((0, 1), repeat=len(given)) if given else ():
            words = ", ".join(f"{name} {('low', 'high')[end]}" for name, end in zip(given, ends, strict=True))
            drives = {
                name: tuple(pair[end] for pair in ranges)
                for (name, ranges), end in zip(given.items(), ends, strict=True)
            }
            try:
                found[words] = arm.with_drives(**drives)
            except ValueError as error:
                raise ValueError(
                    f"ranges: the arm at these ends of the ranges ({words}) is impossible: {error}"
                ) from None
        return found

    def to_toml(self) -> str:
        """Return the table as TOML, to be appended to the arm's TOML; empty if no range is given."""
        lines = [
            f"{name} = {[list(pair) for pair in getattr(self, name)]}  # lowest and highest of each joint, {unit}"
            for name, unit in _UNITS.items()
            if getattr(self, name)
        ]
        return "\n".join(["", "[ranges]", *lines]) + "\n" if lines else ""
