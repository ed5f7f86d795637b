"""Piped output is plain and complete; output on a terminal has lines and fits its width."""

import datetime
import io
import itertools
import re
import sys
import time
import types

import pytest
import rich.console

from fuzzyarm.common import console
from fuzzyarm.common.waiting import announced


@pytest.mark.parametrize("width", [30, 80, 200])
def test_a_table_that_is_too_wide_is_split_and_keeps_its_first_column_and_its_digits(width):
    rows = [("observer", *(f"{k}234567.891" for k in range(9))), ("rigid", *"111111111")]
    headings = ["policy", *(f"error {k} [mm]" for k in range(9))]
    screen = rich.console.Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    console.Sheet(headings, rows, groups=("Case 1", "Case 1"), title="Errors").print(screen)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert all(text.count(f"{k}234567.891") == 1 for k in range(9)) and "…" not in text
    tables = text.count("policy")
    assert tables == text.count("observer") == text.count("Case 1") == text.count("rigid")
    assert (tables == 1) == (width == 200)
    assert text.count("Errors") == 1  # the title stands above the first


@pytest.mark.parametrize("width", [1, 39])
def test_no_terminal_is_narrower_than_what_is_laid_out_for_it(monkeypatch, width):
    """Rich took minutes and gigabytes to lay out a help text in one column."""
    monkeypatch.setenv("COLUMNS", str(width))
    assert console.output(piped_width=None).width == console._NARROWEST
    monkeypatch.setenv("COLUMNS", "41")
    assert console.output(piped_width=None).width == 41


def test_paragraphs_are_printed_as_they_are(capsys):
    console.print_paragraphs(console.output(), ["a [bold]b[/bold] :smile: 12", "x" * 900])
    assert capsys.readouterr().out == "\na [bold]b[/bold] :smile: 12\n\n" + "x" * 900 + "\n"


@pytest.mark.parametrize("terminal", ["", "1"])
def test_progress_of_less_than_two_seconds_is_on_standard_error_of_a_terminal_only(capsys, monkeypatch, terminal):
    monkeypatch.setenv("FORCE_COLOR", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with console.progress("episodes", 2) as advance, console.status("waiting"):
        advance("the next")
        advance()
    shown = capsys.readouterr()
    assert shown.out == "" and bool(shown.err) == bool(terminal)


def test_elsewhere_progress_is_plain_lines_that_become_rare(capsys, monkeypatch):
    seconds = iter(range(10**6))
    monkeypatch.setattr(console, "time", types.SimpleNamespace(monotonic=lambda: next(seconds) / 3))
    with console.progress("turns\x1b", 400, between_steps=True) as advance:
        for _ in range(400):
            advance("the next\x1b[2J")
        advance(completed=390)
    lines = capsys.readouterr().err.splitlines()
    times = [datetime.datetime.strptime(line[:7], "%H:%M:%S") for line in lines]
    pauses = [(after - before).seconds for before, after in itertools.pairwise(times)]
    assert pauses == sorted(pauses) and pauses[0] == 2 and 60 <= pauses[-1] <= 61 and pauses.count(pauses[-1]) <= 3
    assert lines[2].startswith("0:00:08  ") and re.search(r" \d+ of 400  the next.*, 0:0\d:\d\d left$", lines[2])
    assert "\x1b" not in "".join(lines)


def test_a_line_comes_where_no_step_is_done(capsys):
    with console.progress("steps", None, first=0.0):
        until = time.monotonic() + 20.0
        while not (line := capsys.readouterr().err) and time.monotonic() < until:
            time.sleep(0.01)
    assert line == "0:00:00  steps\n"


def test_what_takes_long_is_announced_once_and_on_a_terminal_alone(capsys, monkeypatch):
    for terminal, times in ((False, 0), (True, 1), (True, 0)):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        with announced("compiling, for this test", after=0.0):
            time.sleep(0.3)
        assert capsys.readouterr().err == "compiling, for this test\n" * times
