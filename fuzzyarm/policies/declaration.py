"""The declaration of a policy: what its numbers were chosen for and on what, what it knows, sees and remembers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from fuzzyarm.common.checks import listed, shown

__all__ = ["ELASTIC", "HEADINGS", "INTEGRAL", "LEARNED_OBSERVER", "RIGID", "SEES", "Declared", "stated"]

HEADINGS = ("objective", "tuned on", "knows of the arm", "sees", "remembers")
"""Of the columns, one for each field of `Declared`."""

SEES = "motor angles and velocities; reference with two derivatives, no preview"
INTEGRAL = "integral of the joint error"
RIGID, ELASTIC = "rigid model, no friction", "elastic model with friction"


class Declared(NamedTuple):
    """The declaration of a policy, in words.

    Attributes:
        objective: what its numbers make small.
        tuned_on: the motions, plants and loads on which they were chosen.
        knows: what it is told of the arm.
        sees: what its observation holds.
        remembers: what it keeps from one sample to the next.
    """

    objective: str
    tuned_on: str
    knows: str
    sees: str
    remembers: str


LEARNED_OBSERVER = Declared(
    "distance to the torque of a teacher who knows plant, load and lateness",
    "random plants, forces, payloads, delays, noise and references",
    f"{ELASTIC}, as a first guess; how far it may be off",
    SEES,
    "what elastic-observer and adaptive-observer remember; the state of a network",
)
"""Of every learned observer: its training has no other tasks."""


def stated(given: Any) -> Declared:
    """Return the declaration that a mapping, or an object by its attributes, states.

    Raises:
        ValueError: a field is missing, unknown or no text of one line; the message names it and the fields.
    """
    fields = Declared._fields
    of_object = {field: getattr(given, field) for field in fields if hasattr(given, field)}
    found = given if isinstance(given, Mapping) else of_object
    allowed = f"needed: {', '.join(fields)}, each a text of one line"
    if unknown := [name for name in found if name not in fields]:
        raise ValueError(f"declared has the unknown field {listed(unknown)}; {allowed}")
    if missing := [name for name in fields if name not in found]:
        raise ValueError(f"declared lacks {', '.join(missing)}; {allowed}")
    for name in fields:
        text = found[name]
        if not isinstance(text, str) or not text.strip() or not text.isprintable():
            raise ValueError(f"declared: {name} = {shown(text)} is none; {allowed}")
    return Declared(**{name: str(found[name]) for name in fields})
