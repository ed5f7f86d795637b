"""Options made from the fields of a configuration, with the types, help texts and defaults of the fields."""

import ast
import dataclasses
import functools
import inspect
import itertools
import re
import textwrap
import types
import typing
from collections.abc import Callable, Collection
from typing import Annotated, Any, TypeVar

from cyclopts import Parameter

__all__ = ["arguments_of", "chosen", "given", "named_as_option", "option_name", "shown_default", "with_fields_of"]

_Options = TypeVar("_Options")
_Config = TypeVar("_Config")

# Fields with several values; their option sets one value and may be repeated.
_NAMES = {"policies": "policy", "cases": "case", "ranges": "range"}


def option_name(field: str) -> str:
    """Return the name of the option that sets a field, without the dashes in front."""
    return _NAMES.get(field, field).replace("_", "-")


def named_as_option(message: str, config: type) -> str:
    """Return an error message about a field, such as ``seeds = 0 is ...``, with the option in place of the field."""
    fields = "|".join(field.name for field in dataclasses.fields(config))
    return re.sub(rf"^({fields})(\[\d+\])? = ", lambda found: f"--{option_name(found[1])}{found[2] or ''} ", message)


def with_fields_of(config: type, without: Collection[str] = ()) -> Callable[[type[_Options]], type[_Options]]:
    """Return a decorator that adds an option for each field of a configuration to a frozen dataclass.

    An option that is not given is None; `chosen` then keeps the value of its starting configuration.

    Args:
        config: a dataclass. The help of an option is the string after the field, or its entry under ``Attributes:`` in
            the docstring of the class.
        without: fields that get no option.
    """

    def add(options: type[_Options]) -> type[_Options]:
        hints, texts = typing.get_type_hints(config), _texts(config)
        added = [
            (field.name, _option(field, hints[field.name], texts.get(field.name, "")), dataclasses.field(default=None))
            for field in dataclasses.fields(config)
            if field.name not in without
        ]
        settings = dataclasses.make_dataclass(f"{config.__name__}Options", added, frozen=True, kw_only=True)
        # The settings precede the other options: fields of the last base come first.
        made = dataclasses.make_dataclass(options.__name__, [], bases=(options, settings), frozen=True, kw_only=True)
        made.__doc__, made.__module__ = options.__doc__, options.__module__
        return made

    return add


def given(options: object, config: type) -> dict[str, Any]:
    """Return by name the values of those fields of the dataclass `config` that were set on the command line."""
    values = {field.name: getattr(options, field.name, None) for field in dataclasses.fields(config)}
    return {name: value for name, value in values.items() if value is not None}


def chosen(options: object, start: _Config) -> _Config:
    """Return `start` with the fields that were set on the command line; ValueError if its class refuses a value."""
    changed: _Config = dataclasses.replace(start, **given(options, type(start)))  # type: ignore[type-var]
    return changed


def arguments_of(options: Any) -> str:
    """Return the positional arguments of a command's usage line, such as "NAME [FILE]", from its `Options` class."""
    hints = typing.get_type_hints(options, include_extras=True)
    fields = [field for field in dataclasses.fields(options) if not field.kw_only]
    shown = ((field, hints[field.name].__metadata__[0].metavar) for field in fields)
    return " ".join(name if field.default is dataclasses.MISSING else f"[{name}]" for field, name in shown)


def shown_default(value: Any) -> str | None:
    """Return a default as the help shows it; None for a default that the help omits."""
    if value is None or value == () or value is False:
        return None
    if value is True:
        return "on"
    if isinstance(value, tuple):
        return " ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _option(field: dataclasses.Field[Any], hint: Any, text: str) -> Any:
    """Return the annotated type of the option that sets a field, from the field's type `hint` and the help `text`."""
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    shown = "off" if default is False else shown_default(default)
    parameter = Parameter(
        help=text,
        show_default=shown or False,
        metavar=None if hint is bool else _placeholder(hint),
        negative=f"--no-{option_name(field.name)}" if hint is bool else (),
        # A list that is not empty by default may be made empty, if the configuration accepts that.
        consume_multiple=(0 if default else 1, None),
    )
    return Annotated[hint | None, parameter]


def _placeholder(hint: Any) -> str:
    """Return the placeholder in the help for values of a type, such as ``LOW HIGH`` for a named pair (low, high)."""
    given_types = [one for one in typing.get_args(hint) if one is not types.NoneType]
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return "|".join(map(_placeholder, given_types))
    if fields := getattr(hint, "_fields", None):
        return " ".join(fields).upper()
    if typing.get_origin(hint) is typing.Literal:
        return "CHOICE"
    if typing.get_origin(hint) is tuple:
        parts = typing.get_args(hint)
        if Ellipsis in parts:
            one = _placeholder(parts[0])
            return one if " " in one else f"{one}..."
        return " ".join(map(_placeholder, parts))
    return {int: "N", float: "X", str: "NAME"}.get(hint, getattr(hint, "__name__", "VALUE").upper())


@functools.cache
def _texts(config: type) -> dict[str, str]:
    """Return the description of each field of a dataclass: the string after it, or its entry under ``Attributes:``."""
    texts: dict[str, str] = {}
    for base in reversed(config.__mro__):
        if dataclasses.is_dataclass(base):
            texts |= _entries(inspect.getdoc(base) or "") | _texts_after_fields(base)
    plain = {name: " ".join(text.split()).rstrip(".") for name, text in texts.items()}
    return {name: text[:1].upper() + text[1:] for name, text in plain.items()}


def _entries(docstring: str) -> dict[str, str]:
    _, _, section = docstring.partition("Attributes:\n")
    lines = re.split(r"\n(?=\S)", section, maxsplit=1)[0]
    entries = re.split(r"^    (?=\w)", lines, flags=re.MULTILINE)[1:]
    return {name: text for name, _, text in (entry.partition(":") for entry in entries)}


def _texts_after_fields(config: type) -> dict[str, str]:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(config))).body
    texts = {}
    for field, text in itertools.pairwise(definition.body):  # type: ignore[attr-defined]
        match field, text:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                texts[name] = words
    return texts
