"""A law written down: its equations, its numbers with units, a state to check an implementation at, its certificate."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
from typing import Any

import numpy as np

from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.fuzzy_policy.proof.policy_certificate import PolicyCertificate

__all__ = ["LawSheet", "Quantity", "certified_numbers"]

_COLUMNS = ("quantity", "index", "unit", "value")
_DIGITS = 10  # of a number in the text; JSON and CSV have the shortest one that identifies it


@dataclasses.dataclass(frozen=True)
class Quantity:
    """An array of numbers of a law.

    Attributes:
        name: as in the equations.
        unit: of every entry, as text; "-" for none, "SI" where rows have different ones.
        meaning: in words, with the meaning of the axes.
        values: any shape, () for one number.
    """

    name: str
    unit: str
    meaning: str
    values: np.ndarray


@dataclasses.dataclass(frozen=True)
class LawSheet:
    """What an engineer needs to implement a policy.

    Attributes:
        policy: its name.
        law: what it is, in words.
        equations: one a line, in the order of computation.
        quantities: their numbers.
        check: what the implementation has to give for one observation.
        certificate: what is proven; None where nothing is.
    """

    policy: str
    law: str
    equations: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    check: tuple[Quantity, ...]
    certificate: PolicyCertificate | None

    def to_text(self) -> str:
        """Return the sheet for a person; numbers have ten digits."""
        lines = [f"{self.policy}: {self.law}", "", *(f"  {line}" for line in self.equations)]
        for heading, quantities in (("numbers", self.quantities), ("one state to check against", self.check)):
            lines += ["", f"{heading}:"]
            for quantity in quantities:
                unit = "" if quantity.unit == "-" else f" [{quantity.unit}]"
                lines += ["", f"  {quantity.name}{unit}: {quantity.meaning}", *_rows(quantity.values)]
        lines += ["", "proven of the rigid arm:", ""]
        if self.certificate is None:
            lines.append("  nothing")
        else:
            numbers = certified_numbers(self.certificate)
            lines += [f"  {name} = {value}" for name, value in numbers.items()]
            lines.append(f"  {self.certificate.text}")
        return "\n".join(lines)

    def to_csv(self) -> str:
        """Return every number as a row of CSV: quantity, index from 1, unit, value."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for quantity in (*self.quantities, *self.check):
            for index in np.ndindex(quantity.values.shape):
                place = " ".join(str(k + 1) for k in index)
                writer.writerow([quantity.name, place, quantity.unit, repr(float(quantity.values[index]))])
        return text.getvalue().rstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """Return the sheet as plain data for JSON."""
        certificate = None
        if self.certificate is not None:
            certificate = {**certified_numbers(self.certificate), "scope": self.certificate.text}
        return {
            "policy": self.policy,
            "law": self.law,
            "equations": list(self.equations),
            "quantities": {quantity.name: _plain(quantity) for quantity in self.quantities},
            "check": {quantity.name: _plain(quantity) for quantity in self.check},
            "certificate": certificate,
        }


def certified_numbers(certificate: PolicyCertificate) -> dict[str, str]:
    """Return the numbers of a certificate with their units as texts, rounded to the side on which they hold.

    They are of the controller's inequalities; ``claim`` says where the policy leaves their box along its reference.
    """
    controller = certificate.controller
    unit = {"consistent": "rad/(N m)", "paper": "SI units"}.get(getattr(controller, "form", ""), "s^2")
    numbers = {
        "alpha": f"{at_least(controller.alpha, 6)} 1/s",
        "gamma": f"{at_most(controller.gamma, 6)} {unit}",
    }
    if controller.fastest_pole is not None:
        numbers["fastest_pole"] = f"{at_most(controller.fastest_pole, 6)} 1/s"
    void = {} if certificate.bounds is not None else {"claim": "void along this reference, see the text"}
    return {**numbers, "digest": controller.digest, **void}


def _plain(quantity: Quantity) -> dict[str, Any]:
    return {"unit": quantity.unit, "meaning": quantity.meaning, "values": quantity.values.tolist()}


def _rows(values: np.ndarray) -> list[str]:
    """Return the lines of an array: a row each, with the other indices, from 1, in front."""
    table = np.atleast_2d(values)
    leading = table.shape[:-2]
    lines = []
    for index in itertools.product(*map(range, leading)):
        head = "(" + ", ".join(str(k + 1) for k in index) + ")" if index else ""
        for number, row in enumerate(table[index]):
            first = head if number == 0 else " " * len(head)
            lines.append(f"    {first} " + " ".join(f"{value:>17.{_DIGITS}g}" for value in row))
    return lines
