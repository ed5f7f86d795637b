"""The command `fuzzyarm`: its commands in groups, and the exit code and one-line message of an error.

A command is a module of this package with a frozen dataclass `Options`, whose fields are its options and whose method
`run` returns the exit code. The docstring of `Options` and the texts after its fields are the help, in Markdown. Only
the module of the requested command is imported; its computational code is imported in `run`.

Exit codes: 0 success, 1 a failed result, 2 bad usage, 130 interrupted, 141 the reader of a pipe has exited.
"""

import contextlib
import difflib
import importlib
import os
import sys
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cyclopts

from fuzzyarm import __version__
from fuzzyarm.cli._options import arguments_of, option_name, shown_default
from fuzzyarm.cli._usage import UsageError
from fuzzyarm.common.console import escaped, finish_output, open_streams, output, say

__all__ = ["GROUPS", "command_line", "entry_point", "main"]

GROUPS = {
    "Run policies": {
        "evaluate": "Run policies on the elastic arm; write a table and figures.",
        "report": "Make one HTML page of an evaluation, with a replay.",
        "leaderboard": "Rank the policies of several evaluations.",
        "score": "Score policies on episodes that are never used in training.",
    },
    "Know the arm": {
        "robot": "Write a robot file from a URDF or MJCF model.",
        "identify": "Identify the parameters of an arm from logs of its motors.",
    },
    "Design controllers": {
        "tune": "Tune all model-based policies for an arm.",
        "design": "Design a fuzzy controller by linear matrix inequalities.",
        "verify": "Prove controller files and bound files again.",
        "prove": "Prove a bound on the tip error of the elastic arm.",
        "margins": "Measure how far policies are from instability.",
        "linearise": "Write matrices A to D of a policy's loop for other tools.",
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
        "bench": "Compare steps per second with other environments.",
    },
}
"""The line of each command in the help, by name, under the heading of its group."""

_NEXT = {
    "report": "open the page in a browser",
    "leaderboard": "fuzzyarm evaluate --check DIR repeats an evaluation",
    "score": "fuzzyarm evaluate --policy NAME shows where the errors of a policy are large",
    "robot": "fuzzyarm tune --robot FILE --out DIR",
    "identify": "fuzzyarm tune --robot FILE --out DIR",
    "design": "fuzzyarm evaluate --policy FILE --policy FILE-tip",
    "verify": "fuzzyarm margins --policy FILE",
    "prove": "fuzzyarm verify FILE, for a FILE written by --out",
    "margins": "fuzzyarm evaluate --policy NAME",
    "linearise": "python-control and MATLAB read the files; see the documentation",
    "show": "fuzzyarm export c NAME --out DIR",
    "export": "compile the source and run the test vectors written with it",
    "train": "fuzzyarm score --policy DIR/policy",
    "dataset": "python examples/clone_policy.py FOLDER learns from it",
    "sweep": "fuzzyarm leaderboard DIR",
    "paper": "read paper.md, which lists every number and why it differs",
    "bench": "--lanes-sweep --out DIR plots the speed over the number of arms",
}
"""The suggested next step after a command, shown on a terminal; `evaluate` and `tune` print their own."""

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
        return _fail(f"{command}: {_explain(error)}", 2)
    except BrokenPipeError:
        return 141  # the reader of the pipe, such as head, has exited; shells report this code
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{command}: {where}{error.strerror or error}", 2)
    except (UsageError, ValueError) as error:
        return _fail(f"{command}: {error}", 2)
    except KeyboardInterrupt:
        return _fail(f"{command}: interrupted; files already written are complete", 130)


def entry_point() -> None:
    """Run as the installed command, with writable streams and without the user's Matplotlib back end.

    Figures are drawn into files, and Matplotlib cannot be imported if MPLBACKEND names a back end that it lacks.
    """
    os.environ["MPLBACKEND"] = "agg"
    if not open_streams():
        sys.exit(_fail("fuzzyarm: standard output is closed; send it to a file, or to /dev/null", 2))
    sys.exit(main())


def command_line(words: Sequence[str] | None = None) -> cyclopts.App:
    """Return the command-line parser.

    Args:
        words: arguments of the command line; only the modules that they need are imported. None imports all modules.
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
            converter=_whole_numbers,
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
                made.command(f"fuzzyarm.cli._commands.{name}:Options", name=name, **listed)
    made.register_install_completion_command(help="Install completion for bash, zsh or fish.", group=flags)
    for flag in ("--help", "--version"):
        made[flag].group = flags
    if words is None or "train" in words[:1]:
        importlib.import_module("fuzzyarm.cli._commands.train").add_algorithms(made["train"])
    elif words and words[0] in _modules():  # the command shows the docstring of its options, and its arguments
        command = made[words[0]]
        command.help = None  # replaces the line for the list of all commands
        if arguments := arguments_of(command.default_command):
            command.usage = f"Usage: fuzzyarm {words[0]} [OPTIONS] {arguments}"
    return made


def _version() -> str:
    """Return the version in the first line, then the versions of installed packages, for bug reports."""
    from fuzzyarm.eval.provenance import installed

    return "\n".join([f"fuzzyarm {__version__}", *(f"{name} {version}" for name, version in installed().items())])


def _modules() -> list[str]:
    return [name for commands in GROUPS.values() for name in commands]


def _run(words: Sequence[str]) -> int:
    everything = "--install-completion" in words[:1]
    command, bound, _ = command_line(None if everything else words).parse_args(words)
    if isinstance(command, type):
        options: Any = command(*bound.args, **bound.kwargs)
        code: int = options.run()
        _name_left_out(getattr(options, "robot", None))  # last: an error of usage must remain a single line
        plain = getattr(options, "json", False) or getattr(options, "csv", False)
        if code == 0 and not plain and words[0] in _NEXT and sys.stdout.isatty():
            say(f"next: {_NEXT[words[0]]}")
        return code
    if words and not set(words) & set(_FLAGS):  # as in `fuzzyarm train`, where the library would show help and succeed
        raise UsageError(f"a command is missing; see {' '.join(['fuzzyarm', *words])} --help")
    command(*bound.args, **bound.kwargs)
    return 0


def _fail(message: str, code: int) -> int:
    say(escaped(" ".join(message.split())), error=True)
    return code


def _name_left_out(robot: Any) -> None:
    """Print on standard error which parameters the TOML file of a two-joint arm omits; Table 1 provides them."""
    if isinstance(robot, str) and robot.endswith(".toml"):
        from fuzzyarm.common.documents import read_toml
        from fuzzyarm.envs.physics.parameters import ArmParameters

        with contextlib.suppress(OSError, ValueError):  # the file of a robot with frames
            given = {name: value for name, value in read_toml(Path(robot)).items() if name != "ranges"}
            names = ", ".join(name for name in ArmParameters().to_dict() if name not in given)
            if ArmParameters.from_dict(given) and names:
                say(f"{robot} does not set {names}: the values are taken from Table 1 of the paper", error=True)


def _whole_numbers(kind: Any, tokens: Sequence[cyclopts.Token]) -> Any:
    """Convert the arguments of an option; 4e6 is an integer, 4.5 is not (cyclopts would round 4.5 and refuse 4e6)."""
    return cyclopts.convert(kind, tokens, converter=_converted)


def _converted(kind: Any, text: str) -> Any:
    if kind is not int:
        return cyclopts.convert(kind, [text])
    try:
        return int(text)
    except ValueError:
        number = float(text)
        if not number.is_integer():
            raise
        return int(number)


def _explain(error: cyclopts.CycloptsError) -> str:
    """Return one line for an error of the command line: the value, the allowed values, and the command's help."""
    command = " ".join(["fuzzyarm", *(error.command_chain or ())])
    text = _explained(error)
    return f"{text} See {command} --help" if text.endswith("?") else f"{text}; see {command} --help"


def _explained(error: cyclopts.CycloptsError) -> str:
    match error:
        case cyclopts.CoercionError() if error.token is not None and not _choices(error.target_type):
            name = error.token.keyword or _name(error)
            return f"{name} {error.token.value} must be {_in_words(error.target_type)}"
        case cyclopts.UnknownCommandError() if error.unused_tokens and error.app is not None:
            names = [name for name in error.app if not name.startswith("-")]
            nearest = difflib.get_close_matches(error.unused_tokens[0], names, n=1)
            hint = f"did you mean {nearest[0]}?" if nearest else f"choose from: {', '.join(names)}"
            return f"unknown command {error.unused_tokens[0]}; {hint}"
        case cyclopts.UnusedCliTokensError():
            return f"unexpected argument {' '.join(error.unused_tokens or ())}"
        case cyclopts.MissingArgumentError() if error.argument is not None:
            if error.keyword is None and not error.tokens_so_far:
                return f"{_name(error)} is missing"
            count, _ = error.argument.token_count()
            given = " ".join([error.keyword or _name(error), *error.tokens_so_far])
            return f"{given} needs {f'{count} values' if count > 1 else 'a value'}"
        case cyclopts.RepeatArgumentError():
            return f"{error.token.keyword} {error.token.value} is given twice; leave out one"
    text = str(error).rstrip(".")
    return text[:1].lower() + text[1:]


def _name(error: cyclopts.CycloptsError) -> str:
    if error.argument is None:
        return "a value"
    return error.argument.name or error.argument.parameter.metavar or "an argument"


def _choices(kind: Any) -> tuple[Any, ...]:
    return typing.get_args(kind) if typing.get_origin(kind) is Literal else ()


def _in_words(kind: Any) -> str:
    """Return a phrase for the values of a type, such as "a whole number"."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        kinds = [one for one in typing.get_args(kind) if one is not types.NoneType]
        return " or ".join(map(_in_words, kinds))
    if _choices(kind):
        return " or ".join(f'"{choice}"' for choice in _choices(kind))
    words = {int: "a whole number", float: "a number", bool: "yes or no"}
    return words.get(kind, f"a {getattr(kind, '__name__', kind)}")
