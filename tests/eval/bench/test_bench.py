"""The speed table with made-up speeds: order, statistics and missing numbers; the step against the event integrator."""

import contextlib
import dataclasses
import itertools
import json
from unittest import mock

import gymnasium as gym
import numpy as np
import pytest
from rich.console import Console

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.periods import MAX_DEFAULT_SUBSTEP
from fuzzyarm.eval.bench import _entries, run
from fuzzyarm.eval.bench._accuracy import exact_tips, max_tip_difference, stepped_tips
from fuzzyarm.eval.bench._entries import Entry, timed
from fuzzyarm.eval.bench.run import BenchConfig, _race, run_bench, write_document
from fuzzyarm.eval.bench.speed_table import _speed_cells, draw_throughput, print_speeds


def entry(name, speeds, log=None, **fields):
    """Return an entry with the given speeds per round, after a warm-up; `log` records its calls."""
    log = [] if log is None else log

    @contextlib.contextmanager
    def opened():
        remaining = iter([0.0, *speeds])  # the speed of the warm-up is dropped
        log.append((name, "open"))
        try:
            yield lambda seconds: log.append((name, seconds)) or next(remaining)
        finally:
            log.append((name, "close"))

    return Entry(name, open=opened, **{"lanes": 4, "threads": 2, "dtype": "float64"} | fields)


def absent(name, error, **fields):
    return dataclasses.replace(entry(name, [], **fields), open=mock.Mock(side_effect=error))


FIVE = [100.0, 200.0, 300.0, 400.0, 500.0]


def test_a_speed_is_steps_over_time_on_the_clock():
    ticks, calls = itertools.count(start=7.0, step=0.25), []
    measure = timed(lambda: calls.append(None) or 3, clock=lambda: next(ticks))
    assert measure(1.0) == 3 * 4 / 1.0  # the fourth call ends at one second
    assert len(calls) == 4
    assert measure(0.0) == 3 / 0.25  # never less than one call


def test_entries_take_turns_after_all_are_warm_and_are_closed():
    log, warm = [], run._WARM_UP
    rows = _race("group", [entry(name, FIVE, log) for name in "ab"], 5, 0.5)
    assert log[:4] == [("a", "open"), ("a", warm), ("b", "open"), ("b", warm)]
    assert log[4:-2] == [("a", 0.5), ("b", 0.5)] * 5
    assert sorted(log[-2:]) == [("a", "close"), ("b", "close")]
    quartiles = {"median": 300.0, "q1": 200.0, "q3": 400.0}  # without the warm-up
    assert [row["steps_per_s"] for row in rows] == [quartiles, quartiles]


def test_a_ratio_is_the_median_of_the_ratios_of_the_rounds():
    own = entry("own", [10.0, 20.0, 300.0, 40.0, 50.0])
    peer = entry("peer", [10.0, 5.0, 100.0, 4.0, 1.0], peer="Peer")
    row, other = _race("group", [own, peer], 5, 0.5)
    assert row["ratios"] == {"Peer": {"median": 4.0, "q1": 3.0, "q3": 10.0}}  # of 1, 4, 3, 10, 50
    assert row["steps_per_s"]["median"] / other["steps_per_s"]["median"] == 8.0  # which is something else
    assert other["ratios"] == {}  # peers are not compared with each other


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (RuntimeError("no GPU\nhere."), "no GPU here"),
        (
            ModuleNotFoundError("No module", name="envpool"),
            'envpool is not installed; run in the repository: pip install -c constraints.txt -e ".[bench]"',
        ),
        (gym.error.DependencyNotInstalled("mujoco wanted"), "mujoco wanted"),
    ],
)
def test_what_cannot_run_is_a_row_with_the_reason(error, reason):
    ours, theirs = _race("group", [entry("own", FIVE), absent("peer", error, peer="Peer")], 5, 0.5)
    assert (theirs["reason"], theirs["steps_per_s"]) == (reason, None)
    assert ours["reason"] is None and ours["steps_per_s"]["median"] == 300.0 and ours["ratios"] == {}


@pytest.fixture
def small(monkeypatch):
    """Return the configuration of a table of made-up entries."""

    def times(factor):
        return [factor * speed for speed in FIVE]

    pendulum = entry("Pendulum-v1", [50.0] * 5, peer="Pendulum")
    missing = absent("torch", RuntimeError("no torch"), tip_error=None, dtype="float32")
    one, more = (entry("own", times(factor), tip_error=lambda: 2e-6) for factor in (1.0, 2.0))
    groups = {"one environment": [one, pendulum], "64 lanes": [more, missing]}
    sweep = {
        f"sweep, {lanes} lanes": [
            entry("own", times(lanes), lanes=lanes),
            entry("torch", times(2.0 * lanes), lanes=lanes, dtype="float32"),
            absent("GPU", RuntimeError("no GPU"), lanes=lanes),
        ]
        for lanes in (1, 4, 16)
    }
    monkeypatch.setattr(BenchConfig, "groups", lambda self: groups)
    monkeypatch.setattr(BenchConfig, "sweep_groups", lambda self: sweep if self.lanes_sweep else {})
    monkeypatch.setattr(run, "_memory_per_lane", lambda: 321.4)
    return BenchConfig(threads=1, lanes_sweep=True)


def test_the_document_and_the_figure(small, tmp_path):
    steps = []
    document = run_bench(small, steps.append)
    assert len(steps) == small.turns()
    assert {"schema", "command", "date", "commit", "versions", "machine", "method"} < set(document)
    assert document["command"].endswith("--seconds 0.5 --rounds 5 --lanes 64 1024 65536 --threads 1 --lanes-sweep")
    assert [row["tip_error_um"] for row in document["rows"]] == [2.0, None, 2.0, None]
    assert [row["lanes"] for row in document["sweep"]] == [1, 1, 1, 4, 4, 4, 16, 16, 16]
    written = write_document(document, tmp_path)
    assert [path.name for path in written] == ["bench.json", "throughput.png"]
    assert json.loads(written[0].read_text()) == document
    (axes,) = draw_throughput(document).axes
    assert (axes.get_xscale(), axes.get_yscale(), axes.get_ylabel()) == ("log", "log", "throughput [steps/s]")
    own, torch = axes.lines
    assert own.get_xydata().tolist() == [[1, 300], [4, 1200], [16, 4800]]
    assert torch.get_xydata()[:, 1].tolist() == [600, 2400, 9600]
    assert axes.collections[0].get_datalim(axes.transData).intervaly.tolist() == [200, 400 * 16]  # the quartiles


def test_the_table(small):
    document = run_bench(small)
    headings, cells = _speed_cells(document["rows"])
    assert headings[-3:] == ["steps/s [thousand]", "× Pendulum", "tip error [µm]"]
    assert cells[0][-3:] == ["0.300 (0.200-0.400)", "6.00 (4.00-8.00)", "2"]
    assert cells[3][-3:] == ["not measured", "", ""]
    with (console := Console(width=200)).capture() as captured:
        print_speeds(document, console)
    text = captured.get()
    assert "Not measured: torch: no torch." in text and text.count("not measured") == 1
    assert "Not measured: GPU: no GPU." in text  # named once, and no row of the sweep
    assert "Memory: 321 bytes for each further lane" in text and "5 rounds of 0.5 s" in text


@pytest.mark.parametrize("number", range(4))
def test_what_is_installed_runs(number):
    batch = _entries.batch_entries(4, 1)
    with (*_entries.single_entries()[:2], batch[0], batch[-1])[number].open() as measure:
        assert measure(0.001) > 0.0


@pytest.mark.slow
def test_the_arm_in_torch_is_as_close_to_the_event_integrator_as_that_in_machine_code():
    own, torch = _entries._own_tip_error(), _entries._torch_tip_error("cpu", "float64")
    assert own < 1e-6 and torch == pytest.approx(own, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["nominal", "machining", "payload"])
def test_the_default_step_is_within_a_micrometre_and_the_error_falls_with_the_square_of_the_step(case):
    """The regression of log error on log h over the coarser steps; below, the held line of the force takes over."""
    policy = load_policy("computed-torque")
    exact, steps = exact_tips(policy, case), [1e-3, 5e-4, 2.5e-4, FuzzyArmEnv().substep]
    errors = [max_tip_difference(stepped_tips(policy, case, h), exact) for h in steps]
    assert steps[-1] == MAX_DEFAULT_SUBSTEP == 2e-4 and errors[-1] < 1e-6
    assert 1.9 < np.polyfit(np.log(steps), np.log(errors), 1)[0] < 2.1
