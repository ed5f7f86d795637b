"""A library that keeps a user waiting says so, once, and only to a terminal."""

import sys
import time

from fuzzyarm.common.waiting import announced


def test_what_takes_long_is_announced_once_and_on_a_terminal_alone(capsys, monkeypatch):
    for terminal, times in ((False, 0), (True, 1), (True, 0)):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        with announced("compiling, for this test", after=0.0):
            time.sleep(0.3)
        assert capsys.readouterr().err == "compiling, for this test\n" * times
