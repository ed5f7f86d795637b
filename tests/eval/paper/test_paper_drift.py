"""Drift: which differences count, and the file of stored numbers."""

import json
import math

import pytest

from fuzzyarm.eval.paper.claims import Claim, Tolerance
from fuzzyarm.eval.paper.report import find_drift, load_expected, store_expected

CLAIM = Claim("peak", "6.2", "228", "peak", "N m", 228.0, dict, tolerance=Tolerance(relative=0.01, absolute=1.0))
STORED = {"peak": {"a": 200.0, "b": -200.0}}


@pytest.mark.parametrize(
    ("a", "b", "moved"),
    [
        (203.0, -203.0, []),
        (203.1, -200.0, ["a"]),
        (200.0, -196.9, ["b"]),
        (math.nan, -200.0, ["a"]),
        (math.inf, -math.inf, ["a", "b"]),
    ],
)
def test_a_number_moves_beyond_its_tolerance(a, b, moved):
    assert [entry.label for entry in find_drift([CLAIM], {"peak": {"a": a, "b": b}}, STORED)] == moved


def test_a_number_that_is_new_or_gone_is_drift_and_named():
    measured = {"peak": {"a": 200.0, "c": 1.0}}
    found = find_drift([CLAIM], measured, STORED | {"other": {"x": 2.0}})
    assert [(entry.key, entry.label) for entry in found] == [("peak", "b"), ("peak", "c"), ("other", "x")]
    assert "peak, b: measured none, stored -200 N m" in str(found[0])
    assert "peak, c: measured 1 N m, stored none" in str(found[1])


def test_stored_numbers_come_back_exactly(tmp_path):
    path, numbers = tmp_path / "expected.json", {"peak": {"a": 1.0 / 3.0}, "rules": {"fewest": 1}}
    store_expected(numbers, {"commit": "abc"}, path)
    assert load_expected(path) == numbers
    assert json.loads(path.read_text())["commit"] == "abc"


def test_a_damaged_file_says_how_to_write_it_again(tmp_path):
    path = tmp_path / "expected.json"
    for text in (
        "",
        "{}",
        '{"schema": "other/1", "measured": {}}',
        '{"schema": "fuzzyarm-paper-expected/1", "measured": {"peak": {"a": "1"}}}',
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"expected\.json holds no stored numbers .* --renew"):
            load_expected(path)
