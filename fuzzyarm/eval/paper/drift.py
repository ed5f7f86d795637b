"""Drift: what is measured now against the stored numbers of `expected.json`.

``fuzzyarm paper --renew FILE`` writes such a file; nothing is written into the installed package. A maintainer who has
changed a number on purpose names this folder's ``expected.json`` in a checkout.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fuzzyarm.common import documents
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.paper.claim import Claim

__all__ = ["EXPECTED", "Drift", "Numbers", "find_drift", "load_expected", "store_expected"]

EXPECTED = Path(__file__).with_name("expected.json")
"""The stored numbers that come with the package."""
SCHEMA = "fuzzyarm-paper-expected/1"

Numbers = Mapping[str, Mapping[str, float]]
"""Values by the key of their claim and their label."""


@dataclasses.dataclass(frozen=True)
class Drift:
    """A number that differs from its stored value by more than `allowed`, that is new, or that no longer exists.

    Attributes:
        key: of the claim.
        label: of the value.
        unit: of both values; "-" for none.
        stored: the stored value; None for a new number.
        measured: the value measured now; None for a number that no longer exists.
        allowed: largest allowed difference.
    """

    key: str
    label: str
    unit: str
    stored: float | None
    measured: float | None
    allowed: float

    def __str__(self) -> str:
        """Return the name of the number, both values and the allowed difference."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        was, now = ("none" if value is None else f"{value:.10g}{unit}" for value in (self.stored, self.measured))
        return f"{self.key}, {self.label}: measured {now}, stored {was}, allowed: within {self.allowed:.3g}{unit}"


@dataclasses.dataclass(frozen=True)
class _ExpectedFile:
    """Content of a file of stored numbers: the numbers, and what they were measured with."""

    schema: str
    measured: dict[str, dict[str, float]]
    commit: str | None = None
    versions: dict[str, str | None] = dataclasses.field(default_factory=dict)
    machine: dict[str, Any] = dataclasses.field(default_factory=dict)


def find_drift(claims: Sequence[Claim], measured: Numbers, stored: Numbers) -> list[Drift]:
    """Return every number that left its claim's tolerance around the stored value, that is missing, or that is new."""
    found = []
    for claim in claims:
        now, then = measured[claim.key], stored.get(claim.key, {})
        for label in dict.fromkeys([*then, *now]):
            value, before = now.get(label), then.get(label)
            allowed = 0.0 if before is None else claim.tolerance.of(before)
            # "not <=" instead of ">", so that NaN counts as drift.
            if value is None or before is None or not abs(value - before) <= allowed:
                found.append(Drift(claim.key, label, claim.unit, before, value, allowed))
    known = {claim.key for claim in claims}
    gone = [(key, label, value) for key in stored if key not in known for label, value in stored[key].items()]
    return found + [Drift(key, label, "-", value, None, 0.0) for key, label, value in gone]


def load_expected(path: Path = EXPECTED) -> Numbers:
    """Return the numbers stored in a file.

    Raises:
        ValueError: the file is damaged or of another schema.
        OSError: it cannot be read.
    """
    try:
        content = documents.check_schema(documents.read_json(path), SCHEMA)
        return documents.record(content, _ExpectedFile).measured
    except ValueError as error:
        raise documents.DocumentError(
            f"{path} holds no stored numbers ({error}); write such a file with fuzzyarm paper --out DIR --renew {path}"
        ) from None


def store_expected(measured: Numbers, made_with: Mapping[str, Any], path: Path) -> None:
    """Write measured numbers, and what they were measured with, to a file that `load_expected` reads.

    Raises:
        OSError: the folder is missing or not writable.
    """
    document = {"schema": SCHEMA, **made_with, "measured": measured}
    write_atomically(path, json.dumps(document, indent=1) + "\n")
