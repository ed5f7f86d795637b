"""All surfaces."""

from __future__ import annotations

from . import arguments, command_line, documents, simulations
from .surface import Surface

__all__ = ["SURFACES"]

SURFACES: tuple[Surface, ...] = (*arguments.SURFACES, *simulations.SURFACES, *documents.SURFACES, *command_line.SURFACES)
