"""Have our numbers moved? What is measured against `expected.json`, which ``fuzzyarm paper --renew`` writes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.paper.claim import Claim

EXPECTED = Path(__file__).with_name("expected.json")
SCHEMA = "fuzzyarm-paper-expected/1"
Numbers = Mapping[str, Mapping[str, float]]


@dataclasses.dataclass(frozen=True)
class Drift:
    """One number that is not what it was; None where there is no such number any more, or was none."""

    key: str
    label: str
    unit: str
    stored: float | None
    measured: float | None
    allowed: float

    def __str__(self) -> str:
        """Return the number, both values and how far it may move."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        was, now = ("none" if value is None else f"{value:.10g}{unit}" for value in (self.stored, self.measured))
        return f"{self.key}, {self.label}: measured {now}, stored {was}, allowed: within {self.allowed:.3g}{unit}"


def find_drift(claims: Sequence[Claim], measured: Numbers, stored: Numbers) -> list[Drift]:
    """Return every number farther from the stored one than its claim's tolerance, missing, or new."""
    found = []
    for claim in claims:
        now, then = measured[claim.key], stored.get(claim.key, {})
        for label in dict.fromkeys([*then, *now]):
            value, before = now.get(label), then.get(label)
            allowed = 0.0 if before is None else claim.tolerance.of(before)
            # "not <=" and not ">": NaN is drift.
            if value is None or before is None or not abs(value - before) <= allowed:
                found.append(Drift(claim.key, label, claim.unit, before, value, allowed))
    known = {claim.key for claim in claims}
    gone = [(key, label, value) for key in stored if key not in known for label, value in stored[key].items()]
    return found + [Drift(key, label, "-", value, None, 0.0) for key, label, value in gone]


def load_expected(path: Path | None = None) -> Numbers:
    """Return the numbers stored in a file, default `EXPECTED`.

    Raises:
        ValueError: the file is not what `store_expected` writes.
        OSError: it cannot be read.
    """
    path = path or EXPECTED
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}, this version reads {SCHEMA!r}")
        return {
            key: {label: float(value) for label, value in values.items()}
            for key, values in document["measured"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({error!r}); make it anew: fuzzyarm paper --renew --out DIR") from None


def store_expected(measured: Numbers, made_with: Mapping[str, Any], path: Path | None = None) -> None:
    """Write what was measured as what is expected from now on, with what it was made with; default `EXPECTED`."""
    document = {"schema": SCHEMA, **made_with, "measured": measured}
    write_atomically(path or EXPECTED, json.dumps(document, indent=1) + "\n")
