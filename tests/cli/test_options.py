"""Options made from the fields of a configuration."""

import dataclasses
from typing import Literal, NamedTuple

from cyclopts import App

from fuzzyarm.cli.application import command_line
from fuzzyarm.cli.options import chosen, given, with_fields_of


class Axis(NamedTuple):
    """A quantity and its range."""

    quantity: str
    low: float


@dataclasses.dataclass(frozen=True)
class Base:
    """A base.

    Attributes:
        policies: names of policies, in
            two lines.
        smooth: whether it is smooth.

    Raises:
        ValueError: never.
    """

    policies: tuple[str, ...] = ("a", "b")
    smooth: bool = True


@dataclasses.dataclass(frozen=True)
class Settings(Base):
    """What is set."""

    count: int = 3
    """Number of things [1]."""
    axes: tuple[Axis, ...] = ()
    """Quantities."""
    kind: Literal["x", "y"] = "x"
    """The kind."""
    secret: object = None
    """No option."""

    def __post_init__(self) -> None:
        """Check the number."""
        if self.count < 1:
            raise ValueError(f"count = {self.count} is out of range")


@with_fields_of(Settings, without=("secret",))
@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Do it."""

    out: str = "here"
    """Folder of results"""


def parsed(*words):
    root = command_line([])
    root.command(App(name="do"))
    root["do"].default(Options)
    command, bound, _ = root.parse_args(["do", *words])
    return command(*bound.args, **bound.kwargs)


def help_of_options():
    return {a.name: a.parameter for a in App(default_command=Options).assemble_argument_collection()}


def test_help_default_and_placeholder_come_from_the_field():
    parameters = help_of_options()
    assert parameters["--policies"].help == "Names of policies, in two lines"
    assert parameters["--policies"].show_default == "a b"
    assert parameters["--smooth"].help == "Whether it is smooth" and parameters["--smooth"].show_default == "on"
    assert parameters["--count"].help == "Number of things [1]"
    assert parameters["--axes"].metavar == "QUANTITY LOW" and parameters["--axes"].show_default is False
    assert parameters["--kind"].metavar == "CHOICE"


def test_what_is_not_given_stays_as_it_was():
    start = Settings(count=7)
    assert given(parsed(), Settings) == {} and chosen(parsed(), start) == start
    options = parsed("--policy", "c", "--policy", "d", "--no-smooth", "--axes", "mass", "2", "--kind", "y")
    assert given(options, Settings) == {
        "policies": ("c", "d"), "smooth": False, "axes": (Axis("mass", 2.0),), "kind": "y",
    }  # fmt: skip
    assert chosen(options, start) == Settings(("c", "d"), False, 7, (Axis("mass", 2.0),), "y")
    assert options.out == "here"


def test_a_list_may_be_emptied_where_it_is_not_empty_by_default():
    assert chosen(parsed("--policy"), Settings()).policies == ()
