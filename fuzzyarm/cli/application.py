"""The command `fuzzyarm`: its commands in groups, and the exit code and the one line that an error becomes.

A command is a module of this package with a frozen dataclass `Options`, whose fields are its options, and a function
`run(options)` that returns the exit code. The docstrings of `Options` and the texts after its fields are the help, in
Markdown. Only the module of the command that was asked for is imported, and what it computes with is imported in `run`.

Exit codes: 0 fine, 1 a result that fails, 2 bad usage, 130 interrupted, 141 the reader of a pipe has left.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import cyclopts

from fuzzyarm import __version__
from fuzzyarm.cli.options import arguments_of, option_name, shown_default
from fuzzyarm.cli.usage import UsageError, explain, name_left_out, whole_numbers
from fuzzyarm.common.console import STANDARD_OUTPUT, discard_output, escaped, finish_output, open_streams, output, say

__all__ = ["GROUPS", "command_line", "entry_point", "main"]

GROUPS = {
    "Run policies": {
        "evaluate": "Run policies on the elastic arm; write a table and figures.",
        "report": "Make one HTML page of an evaluation, with a replay.",
        "leaderboard": "Rank the policies of several evaluations.",
        "score": "Score policies on episodes that no training draws.",
    },
    "Know the arm": {
        "identify": "Find the parameters of an arm in a log of its motors.",
    },
    "Design controllers": {
        "tune": "Find the numbers of all model-based policies for an arm.",
        "design": "Design a fuzzy controller by linear matrix inequalities.",
        "verify": "Prove controller files, and files of bounds, again.",
        "prove": "Prove a bound of the tip error on the elastic arm.",
        "margins": "Measure how far policies are from instability.",
        "show": "Print the law of a policy and its gains, as numbers.",
        "export": "Write a policy as C source for a controller board.",
    },
    "Learn policies": {
        "train": "Train a policy by reinforcement learning.",
        "dataset": "Write episodes of policies as a data set for learners.",
    },
    "Study": {
        "sweep": "Run policies on thousands of different plants.",
        "paper": "Reproduce the paper's figures and numbers.",
        "bench": "Measure steps per second beside other environments.",
    },
}
"""The line of each command in the help, by name, under the heading of its group."""

_FLAGS = ("--help", "-h", "--version", "--install-completion")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    command = next((f"fuzzyarm {name}" for name in words[:1] if name in _modules()), "fuzzyarm")
    try:
        code = _run(words)
        finish_output()
        return code
    except cyclopts.CycloptsError as error:
        return _fail(f"{command}: {explain(error)}", 2)
    except BrokenPipeError:
        discard_output()  # the reader, such as head, has left
        return 141  # what a shell reports for it
    except OSError as error:
        if error.filename == STANDARD_OUTPUT:
            discard_output()
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{command}: {where}{error.strerror or error}", 2)
    except (UsageError, ValueError) as error:
        return _fail(f"{command}: {error}", 2)
    except KeyboardInterrupt:
        return _fail(f"{command}: interrupted; files already written are whole", 130)


def entry_point() -> None:
    """Run as the installed command: with streams that can be written, and without the user's drawing back end.

    The figures are drawn into files, and Matplotlib refuses to be imported if MPLBACKEND names a back end it lacks.
    """
    os.environ["MPLBACKEND"] = "agg"
    if not open_streams():
        sys.exit(_fail("fuzzyarm: standard output is closed; send it to a file, or to /dev/null", 2))
    sys.exit(main())


def command_line(words: Sequence[str] | None = None) -> cyclopts.App:
    """Return the parser of the command line.

    Args:
        words: of the command line. Only what these words need is imported; None: everything.
    """
    flags = cyclopts.Group("Options", sort_key=0)
    made = cyclopts.App(
        name="fuzzyarm",
        help="Tracking control of a two-joint robot arm with elastic joints.",
        version=_version,
        version_format="plaintext",
        help_format="markdown",
        group_parameters=cyclopts.Group("Options", sort_key=1),
        group_arguments=cyclopts.Group("Arguments", sort_key=0),
        default_parameter=cyclopts.Parameter(
            negative=(),
            consume_multiple=(1, None),
            name_transform=option_name,
            converter=whole_numbers,
            show_default=shown_default,
        ),
        console=output(piped_width=None),
        exit_on_error=False,
        print_error=False,
    )
    for order, (heading, commands) in enumerate(GROUPS.items(), start=1):
        group = cyclopts.Group(heading, sort_key=order)
        for place, (name, line) in enumerate(commands.items()):
            listed: dict[str, Any] = {"help": line, "group": group, "sort_key": place}
            if name == "train":
                made.command(cyclopts.App(name=name, **listed))
            else:
                made.command(f"fuzzyarm.cli.{name}:Options", name=name, **listed)
    made.register_install_completion_command(help="Install completion for bash, zsh or fish.", group=flags)
    for flag in ("--help", "--version"):
        made[flag].group = flags
    if words is None or "train" in words[:1]:
        importlib.import_module("fuzzyarm.cli.train").add_algorithms(made["train"])
    elif words and words[0] in _modules():  # the command shows the docstring of its options, and its arguments
        command = made[words[0]]
        command.help = None  # so far the line for the list of all commands
        if arguments := arguments_of(command.default_command):
            command.usage = f"Usage: fuzzyarm {words[0]} [OPTIONS] {arguments}"
    return made


def _version() -> str:
    """Return the version in the first line, then what else a report of a bug needs."""
    from fuzzyarm.eval.provenance import installed

    return "\n".join([f"fuzzyarm {__version__}", *(f"{name} {version}" for name, version in installed().items())])


def _modules() -> list[str]:
    return [name for commands in GROUPS.values() for name in commands]


def _run(words: Sequence[str]) -> int:
    """Parse the words and run the command that they name."""
    everything = "--install-completion" in words[:1]
    command, bound, _ = command_line(None if everything else words).parse_args(words)
    if isinstance(command, type):
        module = importlib.import_module(command.__module__)
        options = command(*bound.args, **bound.kwargs)
        code: int = module.run(options)
        name_left_out(getattr(options, "robot", None))  # after it: bad usage is one line
        return code
    if not set(words) & set(_FLAGS):  # without a command the library would show the help and succeed
        name = " ".join(["fuzzyarm", *words])
        choices = "; choose from: " + ", ".join(_modules()) if not words else ""
        raise UsageError(f"a command is missing{choices}; see {name} --help")
    command(*bound.args, **bound.kwargs)
    return 0


def _fail(message: str, code: int) -> int:
    say(escaped(" ".join(message.split())), error=True)
    return code
