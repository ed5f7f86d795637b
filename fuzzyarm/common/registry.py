"""Registries of named things that the package ships or a user adds, and public names imported at their first use.

Worker processes get what was added by `Registry.additions` and `Registry.adopt`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

__all__ = ["Registry", "lazily"]

_Thing = TypeVar("_Thing")

_REGISTRIES: dict[str, Registry[Any]] = {}  # by the module that each is in


class Registry(dict[str, _Thing]):
    """Things by name; things added after the first ones, `shipped`, belong to the `additions` of this process."""

    def __init__(self, home: str, shipped: Mapping[str, _Thing]) -> None:
        super().__init__(shipped)
        self.shipped = frozenset(shipped)
        _REGISTRIES[home] = self

    def added(self) -> dict[str, _Thing]:
        """Return what was added, by name."""
        return {name: thing for name, thing in self.items() if name not in self.shipped}

    @staticmethod
    def additions() -> dict[str, dict[str, Any]]:
        """Return what was added to every registry of this process, by the registry's module, for `adopt`."""
        return {home: added for home, registry in _REGISTRIES.items() if (added := registry.added())}

    @staticmethod
    def adopt(added: Mapping[str, Mapping[str, Any]]) -> None:
        """Add the `additions` of another process; a thing of a name that was added before is replaced."""
        for home, things in added.items():
            importlib.import_module(home)
            _REGISTRIES[home].update(things)


def lazily(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package; `homes` has the module of each public name, relative to the package."""

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{package}.{homes[name]}"), name)

    return find
