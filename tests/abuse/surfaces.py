"""All surfaces."""

from __future__ import annotations

from . import arguments, command_line, documents, processes, simulations
from .surface import Surface

__all__ = ["SURFACES"]

_MODULES = (arguments, simulations, documents, command_line, processes)
SURFACES: tuple[Surface, ...] = tuple(one for module in _MODULES for one in module.SURFACES)
