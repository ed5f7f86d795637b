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
from support.processes import running, wait_until

from fuzzyarm.cli import main
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


WAITS = """
import os, sys, time
from pathlib import Path
from fuzzyarm.cli import main  # noqa: E402
replace = os.replace

def waits(source, target):
    replace(source, target)
    folder = Path(target).parent
    if folder.name == "chunks" and len(list(folder.glob("*.npz"))) == int(sys.argv[1]):
        time.sleep(3600)

os.replace = waits
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.slow
def test_an_interrupted_and_then_a_killed_sweep_goes_on_to_the_same_end(tmp_path, capsys):
    folder = tmp_path / "sweep"
    arguments = ["--policy", "fuzzy-4", "--case", "machining", "--plants", "60", "--chunk", "2", "--seed", "5"]

    def started(words, files):
        """Start a sweep that waits, and its workers too, once there are so many chunks."""
        command = ["sweep", *words, "--jobs", "2", "--out", str(folder)]
        return running(WAITS, str(files), *command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def done():
        return len(list(folder.glob("chunks/*.npz")))

    with started(arguments, 3) as process:
        wait_until(lambda: done() == 3, process)
        os.killpg(process.pid, signal.SIGINT)  # what Ctrl-C in a terminal does: everybody gets it
        error = process.communicate()[1]
    assert process.returncode == 130
    assert error.splitlines()[-1].startswith("fuzzyarm sweep: interrupted; what is done is kept: --resume --out")
    assert done() == 3
    with started(["--resume"], 6) as process:
        wait_until(lambda: done() == 6, process)  # and is killed
    kept = {path: path.stat().st_mtime_ns for path in folder.glob("chunks/*.npz")}
    assert len(kept) == 6 and not (folder / "sweep.json").exists()
    assert main(["sweep", "--resume", "--jobs", "1", "--out", str(folder)]) == 0
    assert all(path.stat().st_mtime_ns == when for path, when in kept.items())
    whole = SweepConfig(policies=("fuzzy-4",), cases=("machining",), plants=60, chunk=60, seed=5)
    found = np.load(folder / "episodes.npz")
    assert equal({name: found[name] for name in found.files}, swept(tmp_path / "whole", Engine(jobs=1), config=whole))
