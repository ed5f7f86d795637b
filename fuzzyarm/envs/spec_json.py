"""The environment's spec as JSON: objects among its arguments are written as data and rebuilt, or refused."""

import dataclasses
import enum
import functools
import importlib
import json
import os
from collections.abc import Callable
from typing import Any, ParamSpec

import numpy as np
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from fuzzyarm.common.checks import shown

__all__ = ["Spec", "made_from_json"]

_Arguments = ParamSpec("_Arguments")
_KIND, _HOME = "record", "fuzzyarm.envs."  # key that names the class in the data of a record of the package


class Spec(EnvSpec):
    """A Gymnasium spec whose JSON `gymnasium.make` and `make_vec` can rebuild through `EnvSpec.from_json`."""

    def to_json(self) -> str:
        """Return the spec as JSON; ValueError for an argument that is neither data nor a record of the package."""
        return json.dumps(_fields(self), default=_plain)


def made_from_json(init: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
    """Wrap the `__init__` of an environment so that it also accepts arguments as written by `Spec.to_json`."""

    @functools.wraps(init)
    def made(*given: _Arguments.args, **named: _Arguments.kwargs) -> None:
        init(*given, **{name: _made(value) for name, value in named.items()})

    return made


def _fields(one: Any) -> dict[str, Any]:
    return {field.name: getattr(one, field.name) for field in dataclasses.fields(one) if field.init}


def _plain(value: Any) -> Any:
    """Convert a value to a type that JSON supports."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, WrapperSpec):
        return _fields(value)
    home, kind = type(value).__module__, type(value).__qualname__
    if dataclasses.is_dataclass(value) and home.startswith(_HOME) and kind.isidentifier():
        return {_KIND: f"{home.removeprefix(_HOME)}.{kind}", **_fields(value)}
    raise ValueError(
        f"{shown(value)} cannot be written as JSON: leave it out of the spec, and pass it to gymnasium.make"
    )


def _made(value: Any, inside: bool = False) -> Any:
    """Rebuild a value from the result of `_plain`; a list becomes a tuple if it is `inside` a record."""
    if isinstance(value, list):
        return (tuple if inside else list)(_made(entry, inside) for entry in value)
    if not isinstance(value, dict) or _KIND not in value:
        return value
    home, _, kind = str(value[_KIND]).rpartition(".")
    try:
        made = getattr(importlib.import_module(_HOME + home), kind)
    except (AttributeError, ImportError):
        made = None
    if not (isinstance(made, type) and dataclasses.is_dataclass(made)):
        raise ValueError(f"{_KIND} = {shown(value[_KIND])} does not name a data class of fuzzyarm")
    return made(**{name: _made(entry, inside=True) for name, entry in value.items() if name != _KIND})
