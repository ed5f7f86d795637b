"""All surfaces."""

from __future__ import annotations

from . import arguments, documents, simulations
from .surface import Surface

__all__ = ["SURFACES"]

SURFACES: tuple[Surface, ...] = (*arguments.SURFACES, *simulations.SURFACES, *documents.SURFACES)
