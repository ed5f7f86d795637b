"""The end of `fuzzyarm evaluate`: five lines, and on a narrow terminal fewer columns but all digits."""

import io
from pathlib import Path

import pytest
import rich.console

from fuzzyarm.eval.episodes.metrics import columns
from fuzzyarm.eval.evaluation.result_table import print_results, verdict


def row(policy, case, rms, *, seed=0, completed=True, largest=1.0):
    """A row of results; its numbers have as many digits as there can be."""
    metrics = dict.fromkeys((one.name for metrics in columns().values() for one in metrics), -123456.789)
    own = {"tip_error_rms_mm": rms, "tip_error_max_mm": largest}
    return {"case": case, "policy": policy, "seed": seed, "completed": completed, **metrics, **own}


THREE = [
    *(row(name, "nominal", rms) for name, rms in (("a", 1.0), ("b", 0.000419), ("c", 2.0))),
    *(row(name, "machining", rms) for name, rms in (("a", 1.0), ("b", 1.0), ("c", 2.0))),
    *(row(name, "payload", 1.0, completed=False) for name in "abc"),
]


def test_the_verdict_of_three_cases_has_five_lines():
    assert verdict(THREE, {"a": "For the ...", "b": None, "c": None}, Path("my folder"), 43) == [
        "Case 1: nominal: b won, rms tip error < 0.001 mm",
        "Case 2: machining force: a, b tie, rms tip error 1.00 mm",
        "Case 3: 5 kg payload: no policy followed the path to its end",
        "Proven of the rigid arm: a; nothing of 2 others",
        "43 files in 'my folder'; next: fuzzyarm report 'my folder'",
    ]


def test_who_lost_the_path_once_cannot_win():
    rows = [row("a", "nominal", 1e-3, seed=seed, completed=seed != 1) for seed in range(3)]
    rows += [row("far", "nominal", 1e-3, largest=101.0)]
    rows += [row("b", "nominal", rms, seed=seed) for seed, rms in enumerate((5.0, 1.0, 2.0))]
    assert verdict(rows, {"a": None}, Path("x"), 3)[:2] == [
        "Case 1: nominal: b followed, rms tip error 2.00 mm; a, far lost the path",
        "Proven of the rigid arm: nothing",
    ]


@pytest.mark.parametrize(("width", "left_out"), [(200, ()), (80, (6,)), (60, (3, 4, 5, 6)), (34, (1, 3, 4, 5, 6))])
def test_a_narrow_terminal_has_fewer_columns_and_every_digit_of_the_others(width, left_out):
    rows = [row("computed-torque-tip", "nominal", 1234.5, largest=0.0412)]
    screen = rich.console.Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    print_results(rows, screen)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= width and "…" not in text
    assert "1.23e+03" in text and "0.0412" in text  # rms and the largest error are always there
    note = " ".join(text.split("Left out on")[1].split()) if left_out else ""
    assert ("Left out on" in text) == bool(left_out)
    for number in left_out:
        assert list(columns())[number] in note
