"""Laws for loops that are compiled as a whole, with the plant: no step goes through Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["CompiledLaw", "compiled_law", "spread_of"]

_LOOPED = {"predict", "command", "act"}


class CompiledLaw(NamedTuple):
    """What `Policy.act` does, as a function for compiled code.

    Attributes:
        name: tells its code from that of other laws for arms with the same equations.
        act: ``act(observation, memory, torque, arguments)``, with the arrays of `Policy.act` for some lanes.
        arguments: what it needs beside them.
    """

    name: str
    act: Any
    arguments: tuple[Any, ...]


def spread_of(kernel: Any) -> Any:
    """Return ``act(observation, memory, torque, arguments)`` of a kernel that takes the arguments one by one."""

    @register_jitable
    def act(observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, arguments: Any) -> None:
        kernel(observation, memory, torque, *arguments)

    return act


def compiled_law(policy: Policy) -> CompiledLaw | None:
    """Return the compiled law of a policy; None where it has none, or where a subclass acts otherwise."""
    for kind in type(policy).__mro__:
        if _LOOPED & vars(kind).keys():
            return policy.compiled() if "compiled" in vars(kind) else None
    return None
