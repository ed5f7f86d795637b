"""Attacks: on readers of files, documented names, proofs and processes.

    python -m pytest -n logical -m slow tests/abuse                   the same examples every time
    ABUSE_TIMES=20 python -m pytest -n logical -m slow tests/abuse    twenty times as many, other ones each time

`values` has strategies of spoiled documents, `samples` good files of every format; `judged` says what has to come of a
try, and `dissipation` what is true of a controller.
"""
