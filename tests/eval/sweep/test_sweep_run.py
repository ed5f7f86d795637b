"""A sweep on every backend, with workers killed: always the same numbers; and what its identity depends on."""

import dataclasses
import functools
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
from support.results import identical

from fuzzyarm.envs.scenario.cases import CASES, Case, add_case, find_case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.eval.engine import Engine, WorkersLost, _call, _module_sources, _pickled
from fuzzyarm.eval.sweep import run
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.run import Sweep, _identity_of, _run_chunk
from fuzzyarm.policies import resolve_all

CONFIG = SweepConfig(policies=("fuzzy-4", "computed-torque-tip"), cases=("machining",), plants=24, chunk=2, seed=5)


def swept(folder, engine, progress=lambda: None, report=lambda text: None):
    sweep = Sweep.begin(folder / "sweep", CONFIG)
    for _ in sweep.run(engine, report):
        progress()
    return sweep.results().arrays


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return swept(tmp_path_factory.mktemp("expected"), Engine(jobs=1))


def waiting(folder, config, policies, needed, number):
    """Run a chunk in a worker; its second waits until somebody was killed."""
    if (folder / f"{os.getpid()}").exists():
        (folder / f"{os.getpid()}-again").touch()
        while not (folder / "killed").exists():
            time.sleep(0.005)
    (folder / f"{os.getpid()}").touch()
    return _run_chunk(config, policies, needed, number)


class Killer:
    """Kills the first worker that has handed in a chunk and is in the middle of its next."""

    def __init__(self, folder):
        self.folder = folder
        run._run_chunk = functools.partial(waiting, folder)

    def __call__(self):
        while not (self.folder / "killed").exists():
            for path in [*self.folder.glob("*-again")][:1]:
                os.kill(int(path.name.removesuffix("-again")), signal.SIGKILL)
                (self.folder / "killed").touch()
            time.sleep(0.005)

    @property
    def processes(self):
        return {int(path.name) for path in self.folder.iterdir() if path.name.isdigit()}


@pytest.mark.slow
def test_local_processes_give_the_numbers_of_one_and_one_of_them_may_die(tmp_path, expected, monkeypatch):
    monkeypatch.setattr(run, "_run_chunk", _run_chunk)  # put back after the test
    killer, reports = Killer(tmp_path), []
    assert identical(swept(tmp_path, Engine(jobs=2), killer, reports.append), expected)
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
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])  # Ray's workers get it too
    command, environment = [sys.executable, "-c", ON_RAY, str(tmp_path)], os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""  # is for results
    assert identical(Sweep.resume(tmp_path / "sweep").results().arrays, expected)
    found = json.loads((tmp_path / "found.json").read_text())
    assert len(found["workers"]) > 1 and found["own"] not in found["workers"]
    assert len(found["reports"]) == 1 and "a worker died" in found["reports"][0]
    assert found["addresses"] == ["127.0.0.1"] and not found["left"]  # nobody else can reach it


def test_a_worker_with_other_versions_is_refused(tmp_path, monkeypatch):
    def newer(config, policies, needed, number):
        return _run_chunk(config, policies, needed | {"numpy": "1.0"}, number)

    monkeypatch.setattr(run, "_run_chunk", newer)
    said = r"package versions or code of a worker differ from those of the sweep.s process \(numpy .* and 1\.0\)"
    with pytest.raises(ValueError, match=said):
        swept(tmp_path, Engine(jobs=1))
    assert list((tmp_path / "sweep" / "chunks").iterdir()) == []


def test_the_identity_holds_the_digest_of_every_file_of_a_policy():
    config = SweepConfig(policies=("fuzzy-4-tip", "ppo-residual", "computed-torque"))
    found = _identity_of(config, resolve_all(config.policies))
    assert list(found["policies"]["fuzzy-4-tip"]) == ["fuzzy-4.json"]
    assert "policy.json" in found["policies"]["ppo-residual"]  # which holds the digest of the weights
    assert found["policies"]["computed-torque"] == {}
    assert found["config"]["parameters"] == config.parameters.to_dict()
    assert "bound" not in found["config"]  # decides only how results are shown
    assert found == json.loads(json.dumps(found))  # as the file will be read


def poison(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def failing(number):
    raise ArithmeticError(f"no {number}")


@pytest.mark.slow
def test_work_that_always_kills_its_worker_is_given_up():
    reports, done = [], []
    with pytest.raises(WorkersLost, match="died 3 times"):
        done.extend(Engine(jobs=2).run(poison, range(6), reports.append))
    assert 3 not in dict(done) and len(done) == len(dict(done)) and len(reports) >= 2
    assert all(square == number * number for number, square in done)


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_the_work_itself_is_raised(jobs):
    with pytest.raises(ArithmeticError, match="no "):
        list(Engine(jobs=jobs).run(failing, range(4)))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"address": "auto"}, "--backend ray"),
        ({"backend": "ray", "address": "ray://host:10001"}, "auto or HOST:PORT"),
        ({"backend": "ray", "address": "127.0.0.1:9"}, "cannot connect to a Ray cluster at '127.0.0.1:9'"),
    ],
)
def test_a_bad_address_is_named_before_ray_looks_for_it(monkeypatch, arguments, expected):
    monkeypatch.setattr("ray.init", lambda **_: pytest.fail("Ray was asked"))
    with pytest.raises((TypeError, ValueError), match=expected):
        list(Engine(**arguments).run(poison, [0]))


PUSHED = Case("pushed", "Case 4: pushed", Disturbance(tip_force=ConstantForce((0.0, 30.0))))


def loads(number):
    return find_case("pushed").disturbance.tip_force.force[1]


@pytest.fixture
def pushed():
    add_case(PUSHED)
    yield
    CASES.pop("pushed", None)


def test_a_sweep_of_an_added_case_goes_on_only_where_the_case_is_known_and_the_same(tmp_path, pushed):
    config = SweepConfig(policies=("computed-torque",), cases=("pushed", "nominal"), plants=2)
    Sweep.begin(tmp_path, config)
    assert Sweep.resume(tmp_path).config == config
    CASES["pushed"] = dataclasses.replace(PUSHED, disturbance=Disturbance())
    with pytest.raises(ValueError, match=r"started with different .*\(cases: pushed"):
        Sweep.resume(tmp_path)
    del CASES["pushed"]
    with pytest.raises(ValueError, match=r"unknown case 'pushed'.*call .*add_case in each process"):
        Sweep.resume(tmp_path)


def test_work_travels_with_what_was_added_by_name(pushed):
    """As to a process that knows nothing of it, and to one where the name means something else."""
    content = _pickled(loads)
    for known in ({}, {"pushed": dataclasses.replace(PUSHED, disturbance=Disturbance())}):
        del CASES["pushed"]
        CASES.update(known)
        assert _call(content, (), 3) == (3, 30.0)


def test_the_modules_that_work_refers_to_are_sent_to_a_cluster(tmp_path, monkeypatch):
    (tmp_path / "pushes").mkdir()
    (tmp_path / "pushes" / "__init__.py").touch()
    (tmp_path / "pushes" / "side.py").write_text("class Side:\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    side = importlib.import_module("pushes.side")
    work = [side.Side(), dataclasses.fields, np.float64, Engine, "__main__"]
    assert _module_sources(cloudpickle.dumps(work)) == (tmp_path / "pushes",)
