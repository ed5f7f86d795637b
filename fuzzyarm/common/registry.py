"""Registries of named objects that the package ships or a user adds, and lazy imports of public names.

`Registry.additions` and `Registry.adopt` pass added objects to worker processes.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

__all__ = ["Registry", "lazily"]

_Thing = TypeVar("_Thing")

_REGISTRIES: dict[str, Registry[Any]] = {}  # by the module that defines each


class Registry(dict[str, _Thing]):
    """Objects by name: those of the package, named in `shipped`, and those added later in this process."""

    def __init__(self, home: str, shipped: Mapping[str, _Thing]) -> None:
        super().__init__(shipped)
        self.shipped = frozenset(shipped)
        _REGISTRIES[home] = self

    def added(self) -> dict[str, _Thing]:
        """Return the added objects by name."""
        return {name: thing for name, thing in self.items() if name not in self.shipped}

    @staticmethod
    def additions() -> dict[str, dict[str, Any]]:
        """Return the objects added in this process, for `adopt`, by the registry's module and the object's name."""
        return {home: added for home, registry in _REGISTRIES.items() if (added := registry.added())}

    @staticmethod
    def adopt(added: Mapping[str, Mapping[str, Any]]) -> None:
        """Add the `additions` of another process; earlier additions with the same name are replaced."""
        for home, things in added.items():
            importlib.import_module(home)
            _REGISTRIES[home].update(things)


def lazily(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package; `homes` maps public names to their modules, relative to the package."""

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{package}.{homes[name]}"), name)

    return find
