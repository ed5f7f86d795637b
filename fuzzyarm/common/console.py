"""Output to the terminal: width, tables and progress bars are defined here for all commands.

On a terminal a table has lines, and each word of a heading has a line of its own. Digits are never cut: a table that is
too wide is printed as several tables below each other that repeat the first columns. In a pipe a table is plain columns
of text, neither folded nor split. Progress is shown on the standard error of a terminal only.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

__all__ = ["PIPED_WIDTH", "output", "print_paragraphs", "print_table", "progress", "status", "table"]

PIPED_WIDTH = 1000  # columns; wide enough for every table
_BETWEEN_WORDS = re.compile(r" (?![^\[]*\])")  # spaces, but for those within the brackets of a unit such as [N m]


def output(piped_width: int | None = PIPED_WIDTH) -> Console:
    """Return the console of standard output.

    Args:
        piped_width: width where that is no terminal; None: the width of a terminal.
    """
    from rich.console import Console

    class Output(Console):
        """A console that says if the reader of the pipe has left; rich itself would exit with code 1."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    console = Output()
    return console if console.is_terminal or piped_width is None else Output(width=piped_width)


def table(
    headings: Sequence[str],
    left: Sequence[int] = (0,),
    *,
    console: Console,
    title: str | None = None,
    fold: bool = False,
) -> Table:
    """Return an empty table; `print_table` prints it once it has its rows.

    Args:
        headings: of the columns; one that has several lines keeps them.
        left: indices of the columns that are aligned left; the others are aligned right.
        console: where the table will be printed.
        title: stands above the table.
        fold: whether the cells of the columns in `left` are text that may be folded on a terminal.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    terminal = console.is_terminal
    lines = box.SIMPLE_HEAD if terminal else None
    made = Table(title=title, title_justify="left", box=lines, pad_edge=False, padding=(0, 1, 0, 0))
    for column, heading in enumerate(headings):
        # A heading that has several lines already keeps them.
        text = _BETWEEN_WORDS.sub("\n", heading) if terminal and "\n" not in heading else heading
        may_fold = terminal and fold and column in left
        made.add_column(Text(text), justify="left" if column in left else "right", no_wrap=not may_fold)
    return made


def print_table(table: Table, console: Console, keys: int = 1) -> None:
    """Print a table; on a terminal that is too narrow, as several tables below each other.

    Args:
        table: as `table` makes it, with its rows.
        console: where it is printed.
        keys: number of columns on the left that each of these tables repeats.
    """
    if not console.is_terminal:
        console.print(table)
        return
    _measure_columns(table, console)
    parts = [[*range(min(keys + 1, len(table.columns)))]]
    for column in range(keys + 1, len(table.columns)):
        wider = [*parts[-1], column]
        if _least_width(_part(table, wider), console) <= console.width:
            parts[-1] = wider
        else:
            parts.append([*range(keys), column])
    for number, columns in enumerate(parts):
        part = _part(table, columns)
        part.title = table.title if number == 0 else None
        least = _least_width(part, console)
        _spread(part, console.width - least)
        if least > console.width:
            # Not even one column fits beside the keys: the terminal breaks the lines, and no digit is lost.
            part.width = least
        console.print(part, crop=False)


def _measure_columns(table: Table, console: Console) -> None:
    """Set the least and the largest width of each column: a widest cell, or a longest word if cells may be folded."""
    for number, column in enumerate(table.columns):
        alone = _part(table, [number])
        alone.box, alone.title = None, None
        width = console.measure(alone, options=console.options.update(max_width=PIPED_WIDTH))
        column.min_width = width.maximum if column.no_wrap else width.minimum
        column.max_width = width.maximum


def _least_width(table: Table, console: Console) -> int:
    return console.measure(table, options=console.options.update(max_width=PIPED_WIDTH)).minimum


def _spread(table: Table, room: int) -> None:
    """Divide the room that is left among the columns, in proportion to what each lacks of its largest width."""
    widths = [(column.min_width or 0, column.max_width or 0) for column in table.columns]
    lacking = sum(largest - least for least, largest in widths)
    for column, (least, largest) in zip(table.columns, widths, strict=True):
        column.width = least + (largest - least) * min(max(room, 0), lacking) // max(lacking, 1)


def _part(table: Table, columns: Sequence[int]) -> Table:
    """Return the table of some of the columns."""
    part = copy.copy(table)
    part.columns = [dataclasses.replace(table.columns[column], _index=place) for place, column in enumerate(columns)]
    return part


def print_paragraphs(console: Console, paragraphs: Sequence[str]) -> None:
    """Print paragraphs, each after an empty line, exactly as they are: no markup, no emoji, no colours."""
    for paragraph in paragraphs:
        console.print(f"\n{paragraph}", highlight=False, markup=False, emoji=False)


@contextlib.contextmanager
def progress(description: str, total: int | None, *, between_steps: bool = False) -> Iterator[Callable[..., None]]:
    """Show a progress bar with the remaining time while the block runs; call the yielded function after each step.

    The arguments of that function are all optional: ``next_description`` replaces the description, ``completed`` says
    how much is done in place of one more, and ``line`` is printed above the bar, without a terminal too.

    Args:
        description: stands in front of the bar.
        total: number of steps; None: unknown.
        between_steps: draw only when the bar advances, so that nothing else runs while a step is timed.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    shown = Progress(
        *columns, console=stderr, disable=not stderr.is_terminal, transient=True, auto_refresh=not between_steps
    )
    with shown as bar:
        task = bar.add_task(description, total=total)

        def advance(
            next_description: str | None = None, *, completed: int | None = None, line: str | None = None
        ) -> None:
            step = 1 if completed is None else None
            bar.update(
                task,
                advance=step,
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
    from rich.console import Console

    stderr = Console(stderr=True)
    with stderr.status(description) if stderr.is_terminal else contextlib.nullcontext():
        yield
