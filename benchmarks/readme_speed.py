"""The tables of two speeds: batches on two threads, and sweeps beside an older commit."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["batch_threads_table", "sweep_before_table"]


def batch_threads_table(document: dict[str, Any]) -> str:
    """Return the step of a batch on one thread and on two, by its size and the pause before it."""
    headings = ["arms", "pause before a step [µs]", "one thread [µs]", "two threads [µs]", "times as fast"]
    rows = [
        [
            f"{row['lanes']:,}",
            f"{row['pause_us']:g}",
            f"{row['one_us']:.0f}",
            f"{row['two_us']:.0f}",
            f"{row['ratio']:.2f}",
        ]
        for row in document["rows"]
    ]
    return (
        f"{table(headings, rows)}\n\nMedians of {document['rounds'] * document['steps']} steps each, in turns. "
        f"`{document['command']}`; {made_with(document)}"
    )


def sweep_before_table(document: dict[str, Any]) -> str:
    """Return the speed of a sweep beside that of an older commit."""
    headings = ["sweep of", "steps/s before", "steps/s now", "ratio: median, quartiles"]
    rows = [
        [
            f"`{row['policy']}`",
            f"{row['before_steps_per_s']['median']:,.0f}",
            f"{row['now_steps_per_s']['median']:,.0f}",
            "{median:.2f}, {q1:.2f} to {q3:.2f}".format(**row["ratio"]),
        ]
        for row in document["rows"]
    ]
    return (
        f"{table(headings, rows)}\n\nMedians of {document['rounds']} rounds in turns, on one core, of the time that "
        f"{document['plants']:,} plants take. `{document['command']}`; {made_with(document)}"
    )
