"""A whole sweep on every backend, with workers and the driver killed: always the same numbers."""

import functools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.sweep import run
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.run import Sweep, run_chunk

HERE = Path(__file__).parent
CONFIG = SweepConfig(policies=("fuzzy-4", "computed-torque-tip"), cases=("machining",), plants=24, chunk=2, seed=5)


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return swept(tmp_path_factory.mktemp("expected"), Engine(jobs=1))


def swept(folder, engine, progress=lambda: None, report=lambda text: None, config=CONFIG):
    sweep = Sweep.begin(folder / "sweep", config)
    for _ in sweep.run(engine, report):
        progress()
    return vars(sweep.results())


def equal(one, other):
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def waiting(folder, config, policies, needed, number):
    """Run a chunk in a worker; its second waits until somebody was killed."""
    if (folder / f"{os.getpid()}").exists():
        (folder / f"{os.getpid()}-again").touch()
        while not (folder / "killed").exists():
            time.sleep(0.005)
    (folder / f"{os.getpid()}").touch()
    return run_chunk(config, policies, needed, number)


class Killer:
    """Kills the first worker that has handed in a chunk and is in the middle of its next."""

    def __init__(self, folder):
        self.folder, self.killed = folder, None
        run.run_chunk = functools.partial(waiting, folder)

    def __call__(self):
        while self.killed is None:
            for path in self.folder.glob("*-again"):
                self.killed = int(path.name.removesuffix("-again"))
                os.kill(self.killed, signal.SIGKILL)
                (self.folder / "killed").touch()
                break
            time.sleep(0.005)

    @property
    def processes(self):
        return {int(path.name) for path in self.folder.iterdir() if path.name.isdigit()}


@pytest.mark.slow
def test_local_processes_give_the_numbers_of_one_and_one_of_them_may_die(tmp_path, expected, monkeypatch):
    monkeypatch.setattr(run, "run_chunk", run_chunk)  # put back after the test
    killer, reports = Killer(tmp_path), []
    assert equal(swept(tmp_path, Engine(jobs=2), killer, reports.append), expected)
    assert os.getpid() not in killer.processes and len(killer.processes) > 1
    assert len(reports) == 1


ON_RAY = """
import json, os, sys
from pathlib import Path
from test_sweep_run import CONFIG, Killer, swept
from fuzzyarm.eval.engine import Engine

killer, reports, addresses = Killer(Path(sys.argv[1])), [], set()

def progress():
    import ray
    addresses.add(ray.util.get_node_ip_address())
    killer()

swept(Path(sys.argv[1]), Engine("ray", jobs=3), progress, reports.append)
import ray
found = {"reports": reports, "addresses": list(addresses), "workers": sorted(killer.processes), "own": os.getpid()}
Path(sys.argv[1], "found.json").write_text(json.dumps(found | {"left": ray.is_initialized()}))
"""


@pytest.mark.slow
def test_ray_gives_the_same_numbers_and_one_of_its_workers_may_die(tmp_path, expected):
    """In a process of its own: Ray does not wait for its processes, which warns."""
    path = os.pathsep.join([str(HERE), *sys.path])  # Ray's workers get it too
    command, environment = [sys.executable, "-c", ON_RAY, str(tmp_path)], os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""  # is for results
    assert equal(vars(Sweep.resume(tmp_path / "sweep").results()), expected)
    found = json.loads((tmp_path / "found.json").read_text())
    assert len(found["workers"]) > 1 and found["own"] not in found["workers"]
    assert len(found["reports"]) == 1 and "a worker died" in found["reports"][0]
    assert found["addresses"] == ["127.0.0.1"]  # nobody else can reach it
    assert not found["left"]


def test_a_worker_with_other_versions_is_refused(tmp_path, monkeypatch):
    def newer(config, policies, needed, number):
        return run_chunk(config, policies, needed | {"numpy": "1.0"}, number)

    monkeypatch.setattr(run, "run_chunk", newer)
    with pytest.raises(ValueError, match=r"other versions than the process that runs the sweep \(numpy .* and 1\.0\)"):
        swept(tmp_path, Engine(jobs=1))
    assert list((tmp_path / "sweep" / "chunks").iterdir()) == []
