"""The speed table with made-up speeds: the order of measurements, the statistics, and the texts for missing numbers."""

import contextlib
import dataclasses
import importlib.util
import io
import itertools
import json
import os
import sys
from types import ModuleType, SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image
from rich.console import Console
from slow_twins import slow_but

from fuzzyarm.eval.bench import accuracy, entries
from fuzzyarm.eval.bench import run as bench_module
from fuzzyarm.eval.bench.entries import MUJOCO_METHODS, Entry, NotMeasured, draw_actions, timed, timed_batch
from fuzzyarm.eval.bench.run import BenchConfig, memory_per_lane, race, run_bench, spread, write_document
from fuzzyarm.eval.bench.speed_table import draw_throughput, print_speeds, speed_cells, speed_notes
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.policies import load_policy


def silent(_):
    pass


def entry(name, speeds, log=None, **fields):
    """Return an entry with the given speeds per round, after a warm-up; `log` records its calls."""
    log = [] if log is None else log

    @contextlib.contextmanager
    def opened():
        remaining = iter([0.0, *speeds])  # the speed of the warm-up is dropped

        def measure(seconds):
            log.append((name, seconds))
            return next(remaining)

        log.append((name, "open"))
        try:
            yield measure
        finally:
            log.append((name, "close"))

    fields = {"lanes": 4, "threads": 2, "substeps": 5, "dtype": "float64"} | fields
    return Entry(name, open=opened, **fields)


def absent(name, error, **fields):
    @contextlib.contextmanager
    def opened():
        raise error
        yield

    return dataclasses.replace(entry(name, [], **fields), open=opened)


FIVE = [100.0, 200.0, 300.0, 400.0, 500.0]


def test_a_speed_is_steps_over_time_on_the_clock():
    ticks = itertools.count(start=7.0, step=0.25)
    calls = []
    measure = timed(lambda: calls.append(None) or 3, clock=lambda: next(ticks))
    assert measure(1.0) == 3 * 4 / 1.0  # the fourth call ends at one second
    assert len(calls) == 4
    assert measure(0.0) == 3 / 0.25  # never less than one call


def test_a_batch_counts_all_its_lanes_and_takes_the_actions_in_turn(monkeypatch):
    monkeypatch.setattr(entries, "timed", lambda advance: advance)
    seen = []
    advance = timed_batch(seen.append, ["a", "b"], lanes=1024)
    assert [advance(), advance(), advance()] == [1024] * 3
    assert seen == ["a", "b", "a"]


def test_entries_take_turns_after_all_are_warm_and_are_closed():
    log = []
    group = [entry(name, FIVE, log) for name in "ab"]
    rows = race("group", group, 5, 0.5, silent)
    warm = bench_module.WARM_UP
    assert log[:4] == [("a", "open"), ("a", warm), ("b", "open"), ("b", warm)]
    assert log[4:-2] == [("a", 0.5), ("b", 0.5)] * 5
    assert sorted(log[-2:]) == [("a", "close"), ("b", "close")]
    assert [row.speeds for row in rows] == [FIVE, FIVE]  # without the warm-up


def test_a_ratio_is_the_median_of_the_ratios_of_the_rounds():
    own = entry("own", [10.0, 20.0, 300.0, 40.0, 50.0])
    peer = entry("peer", [10.0, 5.0, 100.0, 4.0, 1.0], peer="Peer")
    row, other = (row.to_dict() for row in race("group", [own, peer], 5, 0.5, silent))
    assert row["ratios"] == {"Peer": {"median": 4.0, "q1": 3.0, "q3": 10.0}}  # of 1, 4, 3, 10, 50
    assert row["steps_per_s"]["median"] / other["steps_per_s"]["median"] == 8.0  # which is something else
    assert other["ratios"] == {}  # peers are not compared with each other


def test_spread_is_median_and_quartiles():
    assert spread([5.0, 1.0, 2.0, 4.0, 3.0]) == {"median": 3.0, "q1": 2.0, "q3": 4.0}


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (NotMeasured("no GPU\nhere."), "no GPU here"),
        (
            ModuleNotFoundError("No module", name="envpool"),
            'envpool is not installed: pip install -c constraints.txt -e ".[bench]" in the repository',
        ),
        (ImportError("libGL.so is missing"), "libGL.so is missing"),
        (gym.error.DependencyNotInstalled("mujoco wanted"), "mujoco wanted"),
        (RuntimeError(), "RuntimeError"),
    ],
)
def test_what_cannot_run_is_a_row_with_the_reason(error, reason):
    own, peer = entry("own", FIVE), absent("peer", error, peer="Peer", extra="bench")
    ours, theirs = (row.to_dict() for row in race("group", [own, peer], 5, 0.5, silent))
    assert theirs["reason"] == reason
    assert theirs["steps_per_s"] is None
    assert ours["reason"] is None
    assert ours["steps_per_s"]["median"] == 300.0
    assert ours["ratios"] == {}


def test_a_mistake_is_no_reason_and_closes_what_was_open():
    log = []
    with pytest.raises(TypeError):
        race("group", [entry("own", FIVE, log), absent("peer", TypeError())], 5, 0.5, silent)
    assert log[-1] == ("own", "close")


@pytest.fixture
def small(monkeypatch):
    """Return the configuration of a table of made-up entries; `small.tip_errors` counts the calls."""
    calls = []

    def tip_error():
        calls.append(None)
        return 2e-6

    def never():
        raise AssertionError("the accuracy of what was not measured")

    groups = {
        "one environment": [
            entry("own", FIVE, tip_error=tip_error),
            entry("Pendulum-v1", [50.0, 50.0, 50.0, 50.0, 50.0], peer="Pendulum"),
        ],
        "64 lanes": [
            entry("own", [2.0 * speed for speed in FIVE], tip_error=tip_error),
            absent("torch", NotMeasured("no torch"), tip_error=never, dtype="float32"),
        ],
    }
    sweep = {
        f"sweep, {lanes} lanes": [
            entry("own", [lanes * speed for speed in FIVE], lanes=lanes),
            entry("torch", [2.0 * lanes * speed for speed in FIVE], lanes=lanes, dtype="float32"),
            absent("GPU", NotMeasured("no GPU"), lanes=lanes),
        ]
        for lanes in (1, 4, 16)
    }
    monkeypatch.setattr(BenchConfig, "groups", lambda self: groups)
    monkeypatch.setattr(BenchConfig, "sweep_groups", lambda self: sweep if self.lanes_sweep else {})
    monkeypatch.setattr(bench_module, "memory_per_lane", lambda: {"bytes": 321.4, "reason": None})
    return SimpleNamespace(config=BenchConfig(threads=1, lanes_sweep=True), tip_errors=calls)


def test_the_document(small):
    steps = []
    document = run_bench(small.config, steps.append)
    assert len(steps) == small.config.turns()
    assert document == json.loads(json.dumps(document))
    assert {"schema", "command", "date", "commit", "versions", "machine", "method"} < set(document)
    assert {"numpy", "envpool", "mujoco", "torch"} < set(document["versions"])
    assert (
        document["command"] == "fuzzyarm bench --seconds 0.5 --rounds 5 --lanes 64 1024 65536 --threads 1 --lanes-sweep"
    )
    assert document["rows"][0] == {
        "group": "one environment",
        "name": "own",
        "lanes": 4,
        "threads": 2,
        "substeps": 5,
        "dtype": "float64",
        "steps_per_s": {"median": 300.0, "q1": 200.0, "q3": 400.0},
        "ratios": {"Pendulum": {"median": 6.0, "q1": 4.0, "q3": 8.0}},
        "tip_error_um": 2.0,
        "reason": None,
    }
    assert [row["tip_error_um"] for row in document["rows"]] == [2.0, None, 2.0, None]
    assert len(small.tip_errors) == 1  # one back end, one closed loop
    assert [row["lanes"] for row in document["sweep"]] == [1, 1, 1, 4, 4, 4, 16, 16, 16]
    assert document["memory_per_lane"] == {"bytes": 321.4, "reason": None}


def test_without_a_sweep_there_is_none(small, tmp_path):
    document = run_bench(dataclasses.replace(small.config, lanes_sweep=False))
    assert document["sweep"] == []
    assert [path.name for path in write_document(document, tmp_path)] == ["bench.json"]
    assert json.loads((tmp_path / "bench.json").read_text()) == document


def test_the_table(small):
    document = run_bench(small.config)
    headings, cells = speed_cells(document["rows"])
    assert headings[-3:] == ["steps/s [thousand]", "× Pendulum", "tip error [µm]"]
    assert cells[0][-3:] == ["0.300 (0.200-0.400)", "6.00 (4.00-8.00)", "2"]
    assert cells[3][-3:] == ["not measured", "", ""]
    out = io.StringIO()
    print_speeds(document, Console(file=out, width=200))
    text = out.getvalue()
    assert text.count("one environment") == 1
    assert "steps/s [thousand]" in text  # rich would take the unit for markup
    assert "Not measured: torch: no torch." in text
    assert "Not measured: GPU: no GPU." in text  # named once, and no row of the sweep
    assert text.count("not measured") == 1
    assert "Memory: 321 bytes for each further lane" in text
    assert "5 rounds of 0.5 s" in text
    assert document["machine"]["cpu"] in text


@pytest.mark.parametrize(
    ("scale", "text"), [(1e-1, "0.0300 (0.0200-0.0400)"), (1e3, "300 (200-400)"), (1e5, "30000 (20000-40000)")]
)
def test_numbers_have_the_digits_that_mean_something(small, scale, text):
    (row, *_) = run_bench(small.config)["rows"]
    row["ratios"] = {"Peer": {key: 1e-3 * scale * value for key, value in row["steps_per_s"].items()}}
    _, ((*_, ratio, _),) = speed_cells([row])
    assert ratio == text


def test_a_terminal_of_a_hundred_columns_shows_everything(small):
    document, out = run_bench(small.config), io.StringIO()
    peers = ("Pendulum", "Reacher", *MUJOCO_METHODS)
    document["rows"][0]["ratios"] = {peer: {"median": 100.0, "q1": 100.0, "q3": 100.0} for peer in peers}
    document["rows"][0]["tip_error_um"] = 0.123
    print_speeds(document, Console(file=out, width=100, force_terminal=True, color_system=None))
    text = out.getvalue()
    assert "…" not in text
    for part in ("float64, 2, 5", "(0.200-0.400)", "0.123", "[thousand]", "[µm]"):
        assert part in text
    assert text.count("(100-100)") == len(peers)


@pytest.mark.parametrize(("load", "warned"), [(0.1, False), (1.5, True)])
def test_a_busy_machine_is_told(small, monkeypatch, load, warned):
    monkeypatch.setattr(os, "getloadavg", lambda: (load, 9.9, 9.9), raising=False)
    notes = speed_notes(run_bench(small.config))
    assert any("load average" in note for note in notes) == warned


def test_memory_that_was_not_measured_says_why(small):
    document = run_bench(small.config) | {"memory_per_lane": {"bytes": None, "reason": "no vector environment"}}
    assert "Memory: not measured, no vector environment." in speed_notes(document)


@pytest.mark.slow
def test_memory_of_a_lane_is_what_one_more_takes(monkeypatch):
    class Batch:
        def __init__(self, lanes):
            self.lanes, self.kept, self.common = lanes, np.zeros((lanes, 30)), np.zeros(100_000)

        def reset(self, seed):
            return np.zeros((self.lanes, 10)), {}

        def step(self, action):
            assert action.shape == (self.lanes, 2)
            return (np.zeros((self.lanes, 10)),)

        def close(self):
            pass

    monkeypatch.setattr(bench_module, "compiled_batch", lambda lanes, threads: Batch(lanes))
    assert memory_per_lane()["bytes"] == pytest.approx(8 * (30 + 10), abs=1.0)


def test_memory_without_a_batch(monkeypatch):
    def none(lanes, threads):
        raise gym.error.Error("no vector entry point")

    monkeypatch.setattr(bench_module, "compiled_batch", none)
    assert memory_per_lane() == {"bytes": None, "reason": "no vector entry point"}


def test_the_figure_shows_each_back_end_over_the_lanes(small):
    figure = draw_throughput(run_bench(small.config))
    (axes,) = figure.axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert "lanes" in axes.get_xlabel()
    assert axes.get_ylabel() == "throughput [steps/s]"
    own, torch = axes.lines
    assert own.get_xydata().tolist() == [[1, 300], [4, 1200], [16, 4800]]
    assert torch.get_xydata()[:, 1].tolist() == [600, 2400, 9600]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["own, float64", "torch, float32"]
    assert own.get_color() != torch.get_color()
    assert own.get_marker() != torch.get_marker()  # in grey
    assert len(axes.collections) == 2  # the quartiles
    low, high = axes.collections[0].get_datalim(axes.transData).intervaly
    assert (low, high) == (200, 400 * 16)


def test_the_figure_is_written_beside_the_document(small, tmp_path):
    written = write_document(run_bench(small.config), tmp_path)
    assert [path.name for path in written] == ["bench.json", "throughput.png"]
    with Image.open(tmp_path / "throughput.png") as picture:
        assert picture.size[0] > 600
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"seconds": 0.0}, "seconds = 0.0"),
        ({"seconds": -1.0}, "seconds = -1.0"),
        ({"seconds": float("nan")}, "seconds = nan"),
        ({"seconds": float("inf")}, "seconds = inf"),
        ({"rounds": 3}, "rounds = 3 must be odd and at least 5"),
        ({"rounds": 6}, "rounds = 6 must be odd"),
        ({"threads": 0}, "threads = 0"),
        ({"threads": 100_000}, "threads = 100000"),
        ({"lanes": ()}, "lanes = []"),
        ({"lanes": (0,)}, "lanes = 0 is out of range"),
        ({"lanes": (64, 64)}, "lanes = [64, 64]"),
    ],
)
def test_numbers_are_checked_before_anything_runs(fields, message):
    with pytest.raises(ValueError) as caught:
        BenchConfig(**fields)
    assert message in str(caught.value)


def test_the_default_table():
    groups = BenchConfig(threads=1).groups()
    assert list(groups)[:4] == ["one environment", "64 lanes", "1024 lanes", "65536 lanes"]
    assert [entry.peer for entry in groups["sweep of elastic-observer"]] == ["", "step by step"]
    assert [entry.peer for entry in groups["one environment"]] == ["", "Pendulum", "Reacher"]
    batch = groups["1024 lanes"]
    assert {entry.lanes for entry in batch} == {1024}
    assert [entry.peer for entry in batch if entry.peer] == ["Pendulum", "Reacher", *MUJOCO_METHODS]
    assert not any("torch" in entry.name for entry in batch)
    large = groups["65536 lanes"]
    assert {entry.dtype for entry in large if "torch" in entry.name} == {"float64", "float32"}
    assert not any(entry.peer for entry in large)
    assert BenchConfig(threads=1).sweep_groups() == {}
    sweep = BenchConfig(threads=1, lanes_sweep=True).sweep_groups()
    assert [group[0].lanes for group in sweep.values()] == [4**power for power in range(10)]
    assert not any(entry.peer for group in sweep.values() for entry in group)
    in_torch = [entry for group in sweep.values() for entry in group if "torch" in entry.name]
    assert {entry.dtype for entry in in_torch} == {"float32"}
    assert min(entry.lanes for entry in in_torch) == entries.TORCH_LANES


@pytest.mark.parametrize("how", slow_but(["step by step"], entries.RUN))
def test_a_sweep_counts_the_steps_of_its_episodes(monkeypatch, how):
    monkeypatch.setattr(entries, "timed", lambda advance: advance)
    config = SweepConfig(policies=("fuzzy-4",), cases=("nominal", "payload"), plants=1)
    with entries._swept(config, how) as advance:
        assert advance() == 2 * 1500


def test_actions_are_within_the_scale_and_the_same_every_time():
    space = gym.spaces.Box(np.float32([-500, -250]), np.float32([500, 250]))
    actions = draw_actions(space, 8, (64,), scale=0.1)
    assert actions.shape == (8, 64, 2)
    assert actions.dtype == np.float32
    highest = np.abs(actions).max(axis=(0, 1))
    assert (highest <= [50, 25]).all() and (highest > [45, 22]).all()
    assert (actions == draw_actions(space, 8, (64,), scale=0.1)).all()


@pytest.mark.parametrize("number", range(3))
def test_what_needs_no_optional_package_runs(number):
    runnable = (entries.own_single(), entries.gymnasium_peers()[0], entries.own_batches(4, 1)[0])
    with runnable[number].open() as measure:
        assert measure(0.0) > 0.0


@pytest.mark.parametrize("steps", slow_but([200], [200, None]))
def test_the_batch_is_as_accurate_as_the_one_environment(monkeypatch, steps):
    """The error of the time step, as benchmarks/accuracy.py has it: a fraction of a micrometre."""
    exact = accuracy.exact_tips(load_policy("computed-torque"), "nominal", steps)

    def difference(stepped, exact):
        assert len(stepped) >= len(exact)
        return accuracy.max_tip_difference(stepped[: len(exact)], exact)

    monkeypatch.setattr(entries, "_exact_tips", lambda: exact)
    monkeypatch.setattr(entries, "max_tip_difference", difference)
    error = entries.own_single().tip_error()
    assert 0.0 < error < 1e-6
    assert entries.own_batches(4, 1)[0].tip_error() == pytest.approx(error, rel=1e-6)


def test_the_batch_is_made_with_its_threads_and_closed(monkeypatch):
    asked = []

    class Batch:
        single_action_space = gym.spaces.Box(-1.0, 1.0, (2,))

        def reset(self, seed):
            asked.append(seed)

        def step(self, action):
            asked.append(action.shape)

        def close(self):
            asked.append("close")

    monkeypatch.setattr(gym, "make_vec", lambda name, **fields: asked.append((name, fields)) or Batch())
    with entries.own_batches(2048, 4)[0].open() as measure:
        measure(0.0)
    fields = {"num_envs": 2048, "vectorization_mode": "vector_entry_point", "threads": 2}
    assert asked == [("FuzzyArm-v0", fields), 0, (2048, 2), "close"]


@pytest.mark.parametrize(("lanes", "used"), [(1, 1), (1024, 1), (2047, 1), (2048, 2), (100_000, 3)])
def test_the_batch_uses_as_many_threads_as_help(lanes, used):
    compiled, *in_torch = entries.own_batches(lanes, 3)
    assert compiled.threads == used
    assert {torch.threads for torch in in_torch} == ({3} if lanes >= entries.TORCH_LANES else set())


def test_an_episode_that_ends_begins_anew(monkeypatch):
    log = []

    class Env:
        action_space = gym.spaces.Box(-1.0, 1.0, (2,))

        def reset(self, seed=None):
            log.append("reset")

        def step(self, action):
            log.append("step")
            return None, 0.0, False, log.count("step") % 24 == 0, {}

        def close(self):
            log.append("close")

    monkeypatch.setattr(gym, "make", lambda name: Env())
    with entries.single_environment("any", 1.0) as measure:
        measure(0.0)
    assert log == ["reset", *["step"] * 24, "reset", *["step"] * 24, "reset", *["step"] * 16, "close"]


class Tensor(np.ndarray):
    """What the harness uses of a torch tensor."""

    def new_tensor(self, values):
        return np.asarray(values, dtype=self.dtype).view(Tensor)

    def cpu(self):
        return self


@pytest.fixture
def torch_env(monkeypatch):
    """Return a stand-in of the module that logs its calls."""
    log = []

    class TorchFuzzyArm:
        def __init__(self, num_envs, *, device, dtype, compiled):
            log.append((num_envs, device, dtype, compiled))
            self.lanes, self.dtype, self.steps = num_envs, dtype, 0

        def reset(self, *, seed):
            return np.zeros((self.lanes, 10), self.dtype).view(Tensor)

        def step(self, action):
            assert isinstance(action, Tensor)
            assert action.shape == (self.lanes, 2)
            assert action.dtype == self.dtype
            self.steps += 1
            log.append("step")
            ended = np.full(self.lanes, self.steps == 3).view(Tensor)
            info = {"tip": np.full((self.lanes, 2), 0.1 * self.steps).view(Tensor)}
            if ended.any():  # of the next episode
                info = {"tip": np.full((self.lanes, 2), 9.9).view(Tensor)}
            return self.reset(seed=0), ended, ended & False, ended, info

    cuda = SimpleNamespace(is_available=lambda: False, synchronize=lambda: log.append("synchronize"))
    torch = SimpleNamespace(
        float32=np.float32, float64=np.float64, cuda=cuda, get_num_threads=lambda: 7, set_num_threads=log.append
    )
    module = ModuleType("fuzzyarm.rl_baselines.torch_env")
    module.torch, module.TorchFuzzyArm, module.log = torch, TorchFuzzyArm, log
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(entries.shutil, "which", lambda name: name)
    return module


def torch_entry(device, dtype):
    (entry,) = [
        entry
        for entry in entries.own_batches(4096, 2)
        if entry.dtype == dtype and entry.name.endswith({"cpu": "torch.compile, CPU", "cuda": "GPU"}[device])
    ]
    return entry


def test_the_torch_batch_is_compiled_and_gives_the_threads_back(torch_env):
    with torch_entry("cpu", "float32").open() as measure:
        assert measure(0.0) > 0.0
        assert torch_env.log == [2, (4096, "cpu", np.float32, True), *["step"] * 4]
    assert torch_env.log[-1] == 7


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_gpu_is_waited_for(dtype, torch_env):
    with pytest.raises(NotMeasured, match="no GPU"), torch_entry("cuda", dtype).open():
        pass
    torch_env.torch.cuda.is_available = lambda: True
    with torch_entry("cuda", dtype).open() as measure:
        measure(0.0)
    assert torch_env.log[-3:] == ["step", "synchronize", 7]


def test_a_kernel_needs_no_compiler(torch_env, monkeypatch):
    monkeypatch.setattr(entries.shutil, "which", lambda name: None)
    torch_env.torch.cuda.is_available = lambda: True
    with pytest.raises(NotMeasured, match="compiler"), torch_entry("cuda", "float32").open():
        pass
    entry = torch_entry("cuda", "float64")
    assert entry.name == "FuzzyArm, PTX kernel, GPU"
    with entry.open():
        assert torch_env.log[-1] == (4096, "cuda", np.float64, True)


def test_no_compiler_is_a_reason(torch_env, monkeypatch):
    monkeypatch.setattr(entries.shutil, "which", lambda name: None)
    with pytest.raises(NotMeasured, match="needs a C\\+\\+ compiler"), torch_entry("cpu", "float64").open():
        pass


def test_no_torch_is_a_reason(monkeypatch):
    monkeypatch.setitem(sys.modules, "fuzzyarm.rl_baselines.torch_env", None)
    (row,) = race("64 lanes", [torch_entry("cpu", "float32")], 5, 0.5, silent)
    assert row.reason.endswith('is not installed: pip install -c constraints.txt -e ".[rl]" in the repository')


def test_tip_error_of_a_batch_is_that_of_its_first_lane(torch_env, monkeypatch):
    exact = np.array([[0.1, 0.1], [0.2, 0.2 + 1e-3], [0.3, 0.3]])
    monkeypatch.setattr(entries, "_exact_tips", lambda: exact)
    assert torch_entry("cpu", "float64").tip_error() == pytest.approx(1e-3)


def test_mujoco_methods_are_those_that_its_benchmark_chose():
    spec = importlib.util.spec_from_file_location("mujoco_arm", entries.MUJOCO_ARM)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    chosen = [module.EQUAL_ACCURACY["Coulomb"], module.FASTEST]
    assert list(MUJOCO_METHODS.values()) == [(*method, round(1e-3 / h)) for method, h in chosen]


def test_the_arm_in_mujoco_runs():
    entry = entries.batch_peers(4, 1)[-1]
    with entry.open() as measure:
        assert measure(0.001) > 0.0


def test_without_a_checkout_there_is_no_mujoco_arm(monkeypatch, tmp_path):
    monkeypatch.setattr(entries, "MUJOCO_ARM", tmp_path / "mujoco_arm.py")
    entries._mujoco_arm.cache_clear()
    (row,) = race("64 lanes", entries.batch_peers(64, 1)[-1:], 5, 0.5, silent)
    assert "run from a clone" in row.reason


def test_envpool_is_asked_for_lanes_and_threads(monkeypatch):
    asked = []

    class Pool:
        action_space = gym.spaces.Box(-2.0, 2.0, (1,))

        def reset(self):
            pass

        def step(self, action):
            asked.append(action.shape)

        def close(self):
            asked.append("close")

    module = ModuleType("envpool")
    module.make_gymnasium = lambda name, **fields: asked.append((name, fields)) or Pool()
    monkeypatch.setitem(sys.modules, "envpool", module)
    with entries.batch_peers(64, 2)[0].open() as measure:
        measure(0.0)
    assert asked == [("Pendulum-v1", {"num_envs": 64, "num_threads": 2, "seed": 0}), (64, 1), "close"]
