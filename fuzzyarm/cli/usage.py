"""Bad usage: the error, the one line that it becomes, and the checks of files that commands share."""

from __future__ import annotations

import contextlib
import difflib
import tempfile
import types
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import cyclopts

from fuzzyarm.common.console import say
from fuzzyarm.common.files import locked_folder

__all__ = [
    "Allowed", "UsageError", "check_writable", "claimed_folder", "explain", "name_left_out", "output_file", "stopped",
    "whole_numbers",
]  # fmt: skip


class UsageError(Exception):
    """Bad usage; the message is the line that the user sees."""


class Allowed(str):
    """Metadata of an option, in `Annotated`: the values that it takes, for messages; the help says them itself."""


@contextlib.contextmanager
def claimed_folder(folder: Path, *, make: bool = True) -> Iterator[None]:
    """Make a folder if needed, unless `make` is false, and let no other command write to it while the block runs.

    A folder that was made and is empty at the end, since the command was refused, is removed. A folder that cannot be
    made or written to, or that another process writes to, is refused before anything is computed.
    """
    if not make and not folder.is_dir():  # what reads it has the better message
        yield
        return
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        check_writable(folder, make=True)
        with locked_folder(folder):
            yield
    finally:
        with contextlib.suppress(OSError):  # the first that is not empty
            for one in made:
                one.rmdir()


def check_writable(folder: Path, *, make: bool = False) -> None:
    """Write a nameless file to a folder, so that a command fails with UsageError before it has computed anything."""
    try:
        if make:
            folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"cannot write to {folder}: {error.strerror or error}") from None


def output_file(path: Path | None, suffix: str, option: str = "--out") -> None:
    """Check before anything is computed that a file, if one is given, ends in `suffix` and may be written."""
    if path is None:
        return
    if path.suffix != suffix or path.is_dir():
        raise UsageError(f"{option} {path} must be a file ending in {suffix}")
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: the folder {path.parent} does not exist")
    check_writable(path.parent)


def stopped(command: str, out: Path, error: BaseException) -> int:
    """Say why a command ended before its work was done and how it goes on, and return the exit code."""
    interrupted = isinstance(error, KeyboardInterrupt)
    reason = "interrupted" if interrupted else error
    say(f"fuzzyarm {command}: {reason}; what is done is kept: --resume --out {out} goes on", error=True)
    return 130 if interrupted else 1


def name_left_out(robot: Any) -> None:
    """Name on standard error, once a command, what the TOML file of a two-joint arm leaves to Table 1."""
    if isinstance(robot, str) and robot.endswith(".toml"):
        from fuzzyarm.common.documents import read_toml
        from fuzzyarm.envs.physics.parameters import ArmParameters

        with contextlib.suppress(OSError, ValueError):  # a robot by its frames
            given = read_toml(Path(robot))
            names = ", ".join(name for name in ArmParameters().to_dict() if name not in given)
            if ArmParameters.from_dict(given) and names:
                say(f"{robot} leaves out {names}: taken from Table 1 of the paper", error=True)


def whole_numbers(kind: Any, tokens: Sequence[cyclopts.Token]) -> Any:
    """Convert the words of an option to its type: 4e6 is whole, 4.5 is not; the library rounds 4.5, and refuses 4e6."""
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


def explain(error: cyclopts.CycloptsError) -> str:
    """Return one line for an error of the command line: the value, what is allowed, and where to look."""
    command = " ".join(["fuzzyarm", *(error.command_chain or ())])
    text = _explained(error)
    return f"{text} See {command} --help" if text.endswith("?") else f"{text}; see {command} --help"


def _explained(error: cyclopts.CycloptsError) -> str:
    match error:
        case cyclopts.CoercionError() if error.token is not None and not _choices(error.target_type):
            name = error.token.keyword or _name(error)
            return f"{name} {error.token.value} must be {_in_words(error.target_type)}{_allowed(error)}"
        case cyclopts.UnknownCommandError() if error.unused_tokens and error.app is not None:
            names = [name for name in error.app if not name.startswith("-")]
            nearest = difflib.get_close_matches(error.unused_tokens[0], names, n=1)
            hint = f"did you mean {nearest[0]}?" if nearest else f"choose from: {', '.join(names)}"
            return f"unknown command {error.unused_tokens[0]}; {hint}"
        case cyclopts.UnusedCliTokensError():
            return f"{' '.join(error.unused_tokens or ())} belongs to no option"
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


def _allowed(error: cyclopts.CycloptsError) -> str:
    """Return which values an option takes, if it says so."""
    hint = None if error.argument is None else error.argument.field_info.annotation
    return "".join(f"; allowed: {one}" for one in typing.get_args(hint) if isinstance(one, Allowed))


def _choices(kind: Any) -> tuple[Any, ...]:
    return typing.get_args(kind) if typing.get_origin(kind) is Literal else ()


def _in_words(kind: Any) -> str:
    """Return what a value of a type has to be."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        kinds = [one for one in typing.get_args(kind) if one is not types.NoneType]
        return " or ".join(map(_in_words, kinds))
    if _choices(kind):
        return " or ".join(f'"{choice}"' for choice in _choices(kind))
    words = {int: "a whole number", float: "a number", bool: "yes or no"}
    return words.get(kind, f"a {getattr(kind, '__name__', kind)}")
