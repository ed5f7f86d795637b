"""What a user sees of the command line."""

import re

from fuzzyarm.cli import main


def without_progress(err):
    """Return what went to standard error but for progress, whose first line comes after a second or two."""
    return re.sub(r"(?m)^\d+:\d\d:\d\d  .*\n", "", err)


def one_line_error(capsys):
    """Return what went to standard error: one line, and no traceback."""
    err = without_progress(capsys.readouterr().err)
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def refused(capsys, *words):
    """Return the one line on standard error of a command line with exit code 2 and nothing on standard output."""
    capsys.readouterr()  # of commands before
    assert main([str(word) for word in words]) == 2
    out, err = capsys.readouterr()
    err = without_progress(err)
    assert out == "" and err.count("\n") == 1 and "Traceback" not in err
    return err


def printed(capsys, *words):
    """Return what a command line with exit code 0 prints, with nothing but progress on standard error."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == 0
    out, err = capsys.readouterr()
    assert without_progress(err) == ""
    return out
