"""The terminal: its width, its tables and its progress bars, decided once.

In a terminal a table has lines, headings of one word a line, and keeps its digits; piped, it has plain columns and is
never folded. Progress is shown on a terminal's standard error alone.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

PIPED_WIDTH = 1000  # columns; wide enough for every table
_BETWEEN_WORDS = re.compile(r" (?![^\[]*\])")  # spaces, but for those within the brackets of a unit such as [N m]


def output() -> Console:
    """Return the console of standard output, wide where that is no terminal."""
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=PIPED_WIDTH)


def table(
    headings: Sequence[str],
    left: Sequence[int] = (0,),
    *,
    console: Console,
    title: str | None = None,
    fold: bool = False,
) -> Table:
    """Return an empty table with these headings.

    Args:
        headings: of the columns.
        left: indices of the columns that are aligned left; the others are aligned right.
        console: where the table will be printed.
        title: stands above the table.
        fold: whether long cells may be broken into several lines.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    terminal = console.is_terminal
    lines = box.SIMPLE_HEAD if terminal else None
    made = Table(title=title, title_justify="left", box=lines, pad_edge=False, padding=(0, 1, 0, 0))
    for column, heading in enumerate(headings):
        text = _BETWEEN_WORDS.sub("\n", heading) if terminal else heading
        made.add_column(Text(text), justify="left" if column in left else "right", no_wrap=not fold)
    return made


def print_paragraphs(console: Console, paragraphs: Sequence[str]) -> None:
    """Print paragraphs, each after an empty line, exactly as they are: no markup, no emoji, no colours."""
    for paragraph in paragraphs:
        console.print(f"\n{paragraph}", highlight=False, markup=False, emoji=False)


@contextlib.contextmanager
def progress(description: str, total: int | None) -> Iterator[Callable[..., None]]:
    """Show a bar with the time left while the block runs; what it yields advances it by one.

    The arguments of that function are all optional: ``next_description`` replaces the description, ``completed`` says
    how much is done in place of one more, and ``line`` is printed above the bar, without a terminal too.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # The speed is that of the last ten minutes: one step may take longer than the half minute that rich looks back.
    with Progress(
        *columns, console=stderr, disable=not stderr.is_terminal, transient=True, speed_estimate_period=600.0
    ) as bar:
        task = bar.add_task(description, total=total)

        def advance(
            next_description: str | None = None, *, completed: int | None = None, line: str | None = None
        ) -> None:
            step = {"advance": 1} if completed is None else {"completed": completed}
            bar.update(task, description=next_description or description, **step)
            if line is not None:
                stderr.print(line, highlight=False, markup=False, emoji=False, soft_wrap=True)

        yield advance


@contextlib.contextmanager
def status(description: str) -> Iterator[None]:
    """Show what is being done while the block runs."""
    from rich.console import Console

    stderr = Console(stderr=True)
    with stderr.status(description) if stderr.is_terminal else contextlib.nullcontext():
        yield
