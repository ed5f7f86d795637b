"""What a user sees of the command line."""


def one_line_error(capsys):
    """Return what went to standard error: one line, and no traceback."""
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err
