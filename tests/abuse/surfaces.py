"""All surfaces."""

from __future__ import annotations

from . import archives, arguments, command_line, documents, processes, robots, simulations, stand_ins, surroundings
from .surface import Surface

__all__ = ["SURFACES"]

_MODULES = (arguments, simulations, documents, robots, archives, stand_ins, command_line, processes, surroundings)
SURFACES: tuple[Surface, ...] = tuple(one for module in _MODULES for one in module.SURFACES)
