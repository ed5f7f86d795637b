"""Output to the terminal: width, tables and progress bars of all commands.

On a terminal a table has rules, and each word of a heading is on a line of its own. Digits are never cut: a table that
is too wide is printed as several tables, one below the other, that repeat the first columns. In a pipe a table is plain
columns of text. Progress is shown on standard error: a bar on a terminal, otherwise plain lines, the first after two
seconds, then at growing intervals of up to a minute.

Names of files and policies are untrusted: everything is printed by `output` and `say`, which escape control characters.
"""

from __future__ import annotations

import codecs
import contextlib
import dataclasses
import datetime
import io
import json
import os
import re
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.segment import Segment
    from rich.table import Table

__all__ = [
    "Sheet", "escaped", "finish_output", "open_streams", "output", "print_paragraphs", "progress", "say", "say_json",
    "status",
]  # fmt: skip

_PIPED_WIDTH = 1000  # columns; wide enough for every table
_NARROWEST = 40  # columns; rich takes minutes and gigabytes to fold a help text to one
_BETWEEN_WORDS = re.compile(r" (?![^\[]*\])")  # spaces, except those within the brackets of a unit such as [N m]

# Control characters except the line feed, marks of writing direction, line separators, and surrogates.
_OBEYED = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")

_SPELLING = {"µ": "u", "×": "x", "·": "*", "²": "^2", "≤": "<=", "≥": ">=", "…": "...", "\N{NO-BREAK SPACE}": " "}
_SPELLED_OUT = "fuzzyarm.spelled-out"
"""Handler of encoding errors, for `str.encode`: µ becomes u where the encoding has no µ, and so on."""


def open_streams() -> bool:
    """Make every standard stream writable; return whether standard output was open.

    A closed stream is opened on the null device; otherwise the next opened file would get its descriptor, and with it
    the printed text. Characters that the encoding of a stream lacks are escaped.
    """
    closed = []
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            closed.append(number)
    for _ in closed:
        os.open(os.devnull, os.O_RDWR)  # gets the smallest free descriptor
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_SPELLED_OUT)
    return sys.stdout is not None and 1 not in closed


def finish_output() -> None:
    """Flush standard output; OSError if that fails."""
    with _naming_output():
        sys.stdout.flush()


def _spelled_out(error: UnicodeError) -> tuple[str, int]:
    """Return a replacement for characters that an encoding lacks, and the index after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    return "".join(_SPELLING.get(one) or one.encode("unicode_escape").decode() for one in letters), error.end


codecs.register_error(_SPELLED_OUT, _spelled_out)


def escaped(text: str, *, lines: bool = False) -> str:
    r"""Return text with control characters escaped, such as ``\x1b``; `lines` keeps line feeds."""
    visible = _OBEYED.sub(lambda found: found[0].encode("unicode_escape").decode(), text)
    return visible if lines else visible.replace("\n", "\\n")


def say(text: str, *, error: bool = False) -> None:
    """Print `text` to standard output, wrapped at spaces on a terminal; if `error`, to standard error."""
    if error:
        with contextlib.suppress(OSError):
            print(escaped(text, lines=True), file=sys.stderr)
        return
    with _naming_output():
        lines = escaped(text, lines=True).split("\n")
        print("\n".join(map(_wrapped, lines) if sys.stdout.isatty() else lines))


def _wrapped(line: str) -> str:
    """Return a line wrapped at spaces for the terminal, with continuation lines indented by two more spaces."""
    width = max(shutil.get_terminal_size().columns, _NARROWEST)
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    options: Any = dict.fromkeys(("break_long_words", "break_on_hyphens", "replace_whitespace"), False)
    return line if len(line) <= width else textwrap.fill(line, width, subsequent_indent=indent, **options)


def say_json(document: Any) -> None:
    """Print plain data as JSON; errors as for `say`."""
    say(json.dumps(document, indent=1))


@contextlib.contextmanager
def _naming_output() -> Iterator[None]:
    """Add the name "standard output" to errors of output in the block; `BrokenPipeError` passes through.

    Buffered output that cannot be written is discarded; otherwise Python would report it again at exit.
    """
    try:
        yield
    except OSError as error:
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise OSError(error.errno, error.strerror or str(error), "standard output") from None


def output(piped_width: int | None = _PIPED_WIDTH) -> Console:
    """Return the console of standard output; in a pipe it is `piped_width` columns wide, unless that is None."""
    console = _console()
    return console if console.is_terminal or piped_width is None else _console(width=piped_width)


def _console(**settings: Any) -> Console:
    """Return a console that escapes control characters."""
    from rich.console import Console

    class Output(Console):
        """A console that raises BrokenPipeError if its output pipe is closed; rich itself would exit with code 1."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

        def render(self, *renderable: Any, **options: Any) -> Iterable[Segment]:
            for segment in super().render(*renderable, **options):
                text = segment.text if segment.control else escaped(segment.text, lines=True)
                yield segment if text == segment.text else segment._replace(text=text)

        def print(self, *objects: Any, **options: Any) -> None:
            with _naming_output():
                super().print(*objects, **options)

    made = Output(**settings)
    if made.width < _NARROWEST:
        made.width = _NARROWEST  # the terminal breaks the lines
    return made


@dataclasses.dataclass(frozen=True)
class Sheet:
    """A table of strings, for a terminal, a pipe or Markdown."""

    headings: Sequence[str]  # of the columns
    rows: Sequence[Sequence[str]]  # of cells
    left: Sequence[int] = (0,)  # indices of the columns that are aligned left; the others are aligned right
    groups: Sequence[str] = ()  # for each row, the title of its group on a console; empty: no titles
    title: str | None = None  # above the table on a console
    fold: bool = False  # whether the columns in `left` are text that may be folded on a terminal
    keys: int = 1  # number of left columns, repeated in each part of a table that is wider than the terminal
    dispensable: Sequence[int] = ()  # indices of columns that are left out, in this order, before a table is split
    alarm: str = ""  # cells with this word are red

    def print(self, console: Console) -> tuple[int, ...]:
        """Print the table, on a narrow terminal in parts; return the indices of the columns that were left out."""
        columns, left_out = list(range(len(self.headings))), 0
        if not console.is_terminal:
            console.print(self._table(columns, console))
            return ()
        while left_out < len(self.dispensable) and _least_width(self._table(columns, console), console) > console.width:
            columns.remove(self.dispensable[left_out])
            left_out += 1
        for number, part in enumerate(self._parts(columns, console)):
            made = self._table(part, console)
            made.title = None if number else self.title
            if (least := _least_width(made, console)) > console.width:
                made.width = least  # one column does not fit: the terminal breaks the lines, and no digit is lost
            console.print(made, crop=False)
        return tuple(self.dispensable[:left_out])

    def _parts(self, columns: list[int], console: Console) -> Iterator[list[int]]:
        """Yield groups of columns that fit the terminal if possible, each led by the key columns."""
        part = columns[: self.keys + 1]
        for column in columns[self.keys + 1 :]:
            if _least_width(self._table([*part, column], console), console) > console.width:
                yield part
                part = columns[: self.keys]
            part = [*part, column]
        yield part

    def _table(self, columns: Sequence[int], console: Console) -> Table:
        """Return the table of some of the columns; columns keep their width unless their text may be folded."""
        from rich import box
        from rich.cells import cell_len
        from rich.table import Table
        from rich.text import Text

        terminal = console.is_terminal
        lines = box.SIMPLE_HEAD if terminal else None
        made = Table(title=self.title, title_justify="left", box=lines, pad_edge=False, padding=(0, 1, 0, 0))
        for column in columns:
            heading, left = self.headings[column], column in self.left
            # A heading that has several lines already keeps them.
            text = _BETWEEN_WORDS.sub("\n", heading) if terminal and "\n" not in heading else heading
            cells = [*text.split("\n"), *(row[column] for row in self.rows), *(self.groups if column == 0 else ())]
            fold = terminal and self.fold and left
            width = None if fold else max(map(cell_len, cells))
            made.add_column(Text(text), justify="left" if left else "right", no_wrap=not fold, min_width=width)
        for number, row in enumerate(self.rows):
            if self.groups and self.groups[number] not in self.groups[max(number - 1, 0) : number]:
                made.add_section()
                made.add_row(Text(self.groups[number], style="bold"))
            shown = (row[column] for column in columns)
            made.add_row(*(Text(cell, style="red" if self.alarm and self.alarm in cell else "") for cell in shown))
        return made

    def markdown(self) -> str:
        """Return the table as Markdown."""
        rule = [" --- |" if column in self.left else " ---: |" for column in range(len(self.headings))]
        rows = [[cell.replace("|", "&#124;") for cell in row] for row in self.rows]
        lines = [f"| {' | '.join(row)} |" for row in (self.headings, *rows)]
        return "\n".join([lines[0], f"|{''.join(rule)}", *lines[1:]])


def _least_width(table: Table, console: Console) -> int:
    """Return the smallest width [columns] at which each column of a table fits its longest word."""
    return console.measure(table, options=console.options.update(max_width=_PIPED_WIDTH)).minimum


def print_paragraphs(console: Console, paragraphs: Sequence[str]) -> None:
    """Print paragraphs, each after an empty line, exactly as they are: no markup, no emoji, no colours."""
    for paragraph in paragraphs:
        console.print(f"\n{paragraph}", highlight=False, markup=False, emoji=False)


@contextlib.contextmanager
def progress(
    description: str, total: int | None, *, first: float = 2.0, between_steps: bool = False
) -> Iterator[Callable[..., None]]:
    """Show the progress and the remaining time while the block runs; call the yielded function after each step.

    All arguments of that function are optional: ``next_description`` replaces the description, ``completed`` is the
    number of completed steps (default: one more), and ``line`` is printed above the bar, also without a terminal. With
    `between_steps` progress is shown only when it advances, so that nothing else runs while a step is timed. Without a
    terminal the first line comes after `first` seconds.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    stderr = _console(stderr=True)
    if not stderr.is_terminal:
        with _Lines(description, total, first, threaded=not between_steps) as lines:
            yield lines.advance
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True, auto_refresh=not between_steps) as bar:
        task = bar.add_task(description, total=total)

        def advance(
            next_description: str | None = None, *, completed: int | None = None, line: str | None = None
        ) -> None:
            bar.update(
                task,
                advance=1 if completed is None else None,
                completed=completed,
                description=next_description or description,
                refresh=between_steps,
            )
            if line is not None:
                stderr.print(line, highlight=False, markup=False, emoji=False, soft_wrap=True)

        yield advance


@contextlib.contextmanager
def status(description: str) -> Iterator[None]:
    """Show a description of the current work while the block runs."""
    stderr = _console(stderr=True)
    with stderr.status(description) if stderr.is_terminal else _Lines(description, None, 2.0):
        yield


_MINUTE = 60.0  # s, the longest time between two lines of progress


class _Lines:
    """Progress in plain lines on standard error, at intervals that double up to a minute."""

    def __init__(self, description: str, total: int | None, first: float, *, threaded: bool = True) -> None:
        self._description = self._shown = description
        self._total, self._done = total, 0
        self._begun = time.monotonic()
        self._due, self._pause = self._begun + first, 2.0
        self._earlier: tuple[float, int] | None = None  # time and completed steps of the first call of `advance`
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True) if threaded else None

    def __enter__(self) -> _Lines:
        if self._thread is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def advance(
        self, next_description: str | None = None, *, completed: int | None = None, line: str | None = None
    ) -> None:
        """Count a step; arguments as for the function that `progress` yields."""
        self._done = self._done + 1 if completed is None else completed
        self._shown = next_description or self._description
        if self._earlier is None:
            self._earlier = time.monotonic(), self._done
        if line is not None:
            say(line, error=True)
        if self._thread is None:
            self._show_if_due()

    def _run(self) -> None:
        while not self._over.wait(max(self._due - time.monotonic(), 0.0)):
            self._show_if_due()

    def _show_if_due(self) -> None:
        now = time.monotonic()
        if now < self._due:
            return
        self._due, self._pause = now + self._pause, min(2.0 * self._pause, _MINUTE)
        parts = [f"{_clock(now - self._begun)}  {self._steps()}{self._shown}"]
        since, before = self._earlier or (now, self._done)
        if self._total is not None and self._done > before:
            parts.append(f"{_clock((self._total - self._done) * (now - since) / (self._done - before))} left")
        say(", ".join(parts), error=True)

    def _steps(self) -> str:
        if self._total is None:
            return f"{self._done:,} " if self._done else ""
        return f"{self._done:,} of {self._total:,}  "


def _clock(seconds: float) -> str:
    return str(datetime.timedelta(seconds=round(seconds)))
