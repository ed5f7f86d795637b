"""What a step of a tuning found: the numbers of one policy, and why; kept in the folder, so that a run can go on."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path

from fuzzyarm.common.checks import choice, instance, real, texts, whole
from fuzzyarm.common.documents import check_schema, read_json, record
from fuzzyarm.common.files import write_atomically

__all__ = ["SCHEMA", "STEPS", "Finding", "finite", "read_finding", "write_finding"]

SCHEMA = "fuzzyarm-tuning-step/1"
"""Of the file of a step."""
STEPS = "steps"
"""The folder, in that of the tuning, with a file for each step."""
_LARGEST = 2**18  # bytes of such a file


@dataclasses.dataclass(frozen=True)
class Finding:
    """The outcome of one step.

    Attributes:
        schema: `SCHEMA`.
        arm_sha256: digest of the arm, `Robot.digest`.
        policy: name of the policy, which is that of the step.
        chosen: its numbers by name, SI units; None: nothing was found.
        measured: what decided, by name.
        radii: spectral radius by condition of `fuzzyarm margins`; None where there is none.
        tried: candidates that were assessed.
        rule: how was chosen.
        notes: what else is to be said, a sentence each.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a number is not finite or out of range.
    """

    schema: str
    arm_sha256: str
    policy: str
    chosen: dict[str, float | None] | None
    measured: dict[str, float | None]
    radii: dict[str, float | None]
    tried: int
    rule: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the numbers and texts."""
        choice("schema", self.schema, (SCHEMA,))
        for name in ("arm_sha256", "policy", "rule"):
            instance(name, getattr(self, name), str)
        whole("tried", self.tried, low=0)
        texts("notes", self.notes)
        for group in (self.chosen or {}, self.measured, self.radii):
            for name, value in group.items():
                if value is not None:
                    real(name, value)

    @property
    def unstable(self) -> list[str]:
        """The conditions in which the loop is not stable."""
        return [name for name, radius in self.radii.items() if radius is None or radius >= 1.0]


def finite(values: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return numbers with None for those that are not finite, as JSON can hold them."""
    return {name: float(x) if x is not None and math.isfinite(x) else None for name, x in values.items()}


def write_finding(folder: Path, finding: Finding) -> None:
    """Write a finding into the folder of a tuning, whole or not at all."""
    path = folder / STEPS / f"{finding.policy}.json"
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, json.dumps(dataclasses.asdict(finding), indent=1, allow_nan=False) + "\n")


def read_finding(folder: Path, policy: str, arm_sha256: str) -> Finding | None:
    """Return the finding of a step that is finished; None if there is none.

    Raises:
        ValueError: its file is damaged, or of another arm.
        OSError: the file cannot be read.
    """
    path = folder / STEPS / f"{policy}.json"
    if not path.is_file():
        return None
    try:
        found = record(check_schema(read_json(path, largest=_LARGEST), SCHEMA), Finding)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}; remove the file, and --resume takes this step again") from None
    if (found.arm_sha256, found.policy) != (arm_sha256, policy):
        raise ValueError(f"{path} is of another arm or policy; choose another folder")
    return found
