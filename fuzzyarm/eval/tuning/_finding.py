"""The result of a tuning step, kept in a file so that the tuning can be resumed; and the motion and loads of an arm.

The motion is the arm's default reference. The largest loads in a search are scaled to the arm by the rule for the
loads of the cases, see `envs.scenario.cases`.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path

from fuzzyarm.common.documents import check_schema, read_json, record
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.scenario.cases import case_for, find_case
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import MachiningForce
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, with_drives

__all__ = [
    "PERIOD", "SCHEMA", "STEPS", "Finding", "finite", "force_factor", "halving_radius", "heaviest", "periods_of",
    "read_finding", "with_stiffness", "write_finding",
]  # fmt: skip


PERIOD = 1e-3
"""Control period of everything that is tuned [s]."""


def periods_of(arm: AnyArm) -> int:
    """Return the number of control periods in the arm's default reference."""
    return round(default_reference(arm).duration / PERIOD)


def halving_radius(arm: AnyArm) -> float:
    """Return the spectral radius per control period with which deviations halve during the arm's default reference."""
    return float(0.5 ** (1.0 / periods_of(arm)))


def heaviest(arm: AnyArm) -> float:
    """Return the payload [kg] of the arm's case ``payload``, 5 kg for Table 1."""
    return case_for("payload", arm).disturbance.payload.mass


def force_factor(arm: AnyArm) -> float:
    """Return the machining force of the arm's case ``machining``, divided by that for the arm of Table 1 [1]."""
    own, papers = (case.disturbance.tip_force for case in (case_for("machining", arm), find_case("machining")))
    assert isinstance(own, MachiningForce) and isinstance(papers, MachiningForce)
    return own.base / papers.base


def with_stiffness(arm: AnyArm, factor: float) -> AnyArm:
    """Return the arm with the stiffness of all joints times `factor`."""
    return with_drives(arm, stiffness=factor * per_joint_of(arm, "stiffness"))


SCHEMA, STEPS = "fuzzyarm-tuning-step/1", "steps"
"""The schema of a step's file, and the folder of these files within the folder of the tuning."""
_LARGEST = 2**18  # bytes of such a file


@dataclasses.dataclass(frozen=True)
class Finding:
    """The outcome of one step of a tuning: the parameters found for a policy."""

    schema: str
    arm_sha256: str  # `Robot.digest`
    policy: str
    chosen: dict[str, float | None] | None  # the parameters by name, SI units; None: none were found
    measured: dict[str, float | None]  # the quantities that decided, by name
    radii: dict[str, float | None]  # spectral radius by condition of `fuzzyarm margins`; None where there is no loop
    tried: int  # candidates that were assessed
    rule: str
    notes: tuple[str, ...] = ()  # a sentence each

    @property
    def unstable(self) -> list[str]:
        """The conditions in which the loop is not stable."""
        return [name for name, radius in self.radii.items() if radius is None or radius >= 1.0]


def finite(values: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return numbers for JSON, with None in place of those that are not finite."""
    return {name: float(x) if x is not None and math.isfinite(x) else None for name, x in values.items()}


def write_finding(folder: Path, finding: Finding) -> None:
    """Write a finding into the folder of a tuning, whole or not at all."""
    path = folder / STEPS / f"{finding.policy}.json"
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, json.dumps(dataclasses.asdict(finding), indent=1, allow_nan=False) + "\n")


def read_finding(folder: Path, policy: str, arm_sha256: str) -> Finding | None:
    """Return the finding of a finished step, None if there is none; ValueError for a damaged or foreign file."""
    path = folder / STEPS / f"{policy}.json"
    if not path.is_file():
        return None
    try:
        found = record(check_schema(read_json(path, largest=_LARGEST), SCHEMA), Finding)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{error}; remove {path}, then --resume repeats this step") from None
    if (found.arm_sha256, found.policy) != (arm_sha256, policy):
        raise ValueError(f"{path} belongs to another arm or policy; choose another folder")
    return found
