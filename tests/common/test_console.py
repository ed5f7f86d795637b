"""What is piped is plain and whole; what is on a terminal has lines and fits."""

import io

import pytest
import rich.console

from fuzzyarm.common import console

HEADINGS = ["case", "tip error max [mm]"]


def printed(terminal, width=40):
    """A table as it is shown on a terminal or in a pipe of this width."""
    screen = rich.console.Console(file=io.StringIO(), force_terminal=terminal, width=width, color_system=None)
    table = console.table(HEADINGS, console=screen)
    table.add_row("Case 1", "3.90")
    table.add_row("Case 2: a force", "10.8")
    screen.print(table)
    return screen.file.getvalue().splitlines()


def test_piped_tables_are_columns_of_text():
    head, *rows = (line.rstrip() for line in printed(False))
    assert head.split("  ")[0] == "case" and head.endswith("tip error max [mm]")  # no markup: the unit stays
    assert [row.split()[-1] for row in rows] == ["3.90", "10.8"]
    assert len({len(line) for line in (head, *rows)}) == 1  # numbers are aligned right


def test_on_a_terminal_each_word_of_a_heading_has_a_line_and_the_digits_stay():
    lines = printed(True, width=24)
    assert [line.split()[-1] for line in lines if line.strip()][:4] == ["tip", "error", "max", "[mm]"]
    assert any("─" in line for line in lines)
    assert any("10.8" in line for line in lines)


def test_output_is_wide_where_it_is_no_terminal(capsys):
    screen = console.output()
    screen.print("x" * 900)
    assert capsys.readouterr().out == "x" * 900 + "\n"


def test_paragraphs_are_printed_as_they_are(capsys):
    console.print_paragraphs(console.output(), ["a [bold]b[/bold] :smile: 12", "c"])
    assert capsys.readouterr().out == "\na [bold]b[/bold] :smile: 12\n\nc\n"


@pytest.mark.parametrize("terminal", ["", "1"])
def test_progress_is_on_standard_error_of_a_terminal_only(capsys, monkeypatch, terminal):
    monkeypatch.setenv("FORCE_COLOR", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with console.progress("episodes", 2) as advance, console.status("waiting"):
        advance("the next")
        advance()
    shown = capsys.readouterr()
    assert shown.out == "" and bool(shown.err) == bool(terminal)
