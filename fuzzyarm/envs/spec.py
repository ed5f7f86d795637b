"""The environment's spec as JSON: objects among its arguments are written as data and made again, or refused."""

from __future__ import annotations

import copy
import dataclasses
import enum
import functools
import importlib
import os
from collections.abc import Callable
from typing import Any, ParamSpec

import numpy as np
from gymnasium.envs.registration import EnvSpec

from fuzzyarm.common.checks import shown

__all__ = ["Spec", "made_from_json"]

Arguments = ParamSpec("Arguments")
_KIND, _HOME = "record", "fuzzyarm.envs."  # as data, a record of the package names its class under this key


class Spec(EnvSpec):
    """A spec whose `to_json` writes what `gymnasium.make` and `make_vec` make again from `EnvSpec.from_json`."""

    def to_json(self) -> str:
        """Return the spec as JSON; ValueError for an argument that is neither data nor a record of the package."""
        plain = copy.copy(self)
        plain.kwargs = {name: _plain(name, value) for name, value in self.kwargs.items()}
        return super(Spec, plain).to_json()


def made_from_json(init: Callable[Arguments, None]) -> Callable[Arguments, None]:
    """Let an environment take arguments as `Spec.to_json` writes them."""

    @functools.wraps(init)
    def made(*given: Arguments.args, **named: Arguments.kwargs) -> None:
        init(*given, **{name: _made(value) for name, value in named.items()})

    return made


def _plain(name: str, value: Any) -> Any:
    """Return an argument as data."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple):
        return [_plain(name, entry) for entry in value]
    if isinstance(value, dict):
        return {key: _plain(name, entry) for key, entry in value.items()}
    home, kind = type(value).__module__, type(value).__qualname__
    if dataclasses.is_dataclass(value) and home.startswith(_HOME) and kind.isidentifier():
        fields = {one.name: _plain(name, getattr(value, one.name)) for one in dataclasses.fields(value) if one.init}
        return {_KIND: f"{home.removeprefix(_HOME)}.{kind}", **fields}
    if value is None or isinstance(value, str | int | float):
        return value
    raise ValueError(f"{name} = {shown(value)} cannot be written as JSON: leave it out, and give it to make again")


def _made(value: Any) -> Any:
    """Return what `_plain` was given, but for lists in the place of tuples outside of records."""
    if isinstance(value, list):
        return [_made(entry) for entry in value]
    if not isinstance(value, dict) or _KIND not in value:
        return value
    fields = {name: _tuples(_made(entry)) for name, entry in value.items() if name != _KIND}
    home, _, kind = str(value[_KIND]).rpartition(".")
    try:
        made = getattr(importlib.import_module(_HOME + home), kind)
    except (AttributeError, ImportError):
        made = None
    if not (isinstance(made, type) and dataclasses.is_dataclass(made)):
        raise ValueError(f"the package has no {_KIND} {shown(value[_KIND])}")
    return made(**fields)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
