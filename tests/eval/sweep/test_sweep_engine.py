"""Work on many workers: the same results from all, and complete results whichever worker dies."""

import dataclasses
import importlib
import os
import signal
import threading
import time

import cloudpickle
import numpy as np
import pytest

from fuzzyarm.envs.scenario.cases import CASES, Case, add_case, find_case
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.eval.engine import Engine, WorkersLost, _call, _pickled, module_sources


def slow(number):
    time.sleep(0.2)
    return os.getpid()


def poison(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def failing(number):
    raise ArithmeticError(f"no {number}")


@pytest.mark.slow
def test_a_killed_process_loses_no_work():
    reports, found = [], {}
    for number, process in Engine(jobs=2).run(slow, range(8), reports.append):
        found[number] = process
        if len(found) == 2:
            os.kill(process, signal.SIGKILL)
    assert sorted(found) == list(range(8)) and os.getpid() not in found.values()
    assert len(reports) == 1 and "run again" in reports[0]


@pytest.mark.slow
def test_work_that_always_kills_its_worker_is_given_up():
    reports, done = [], []

    def run():
        for number, square in Engine(jobs=2).run(poison, range(6), reports.append):
            assert square == number * number
            done.append(number)

    with pytest.raises(WorkersLost, match="died 3 times"):
        run()
    assert 3 not in done and len(done) == len(set(done)) and len(reports) >= 2


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_the_work_itself_is_raised(jobs):
    with pytest.raises(ArithmeticError, match="no "):
        list(Engine(jobs=jobs).run(failing, range(4)))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"jobs": 1.5}, "jobs = 1.5 must be a whole number"),
        ({"address": "auto"}, "--backend ray"),
        ({"backend": "ray", "address": "ray://host:10001"}, "auto or HOST:PORT"),
    ],
)
def test_bad_values_are_named(arguments, expected):
    with pytest.raises((TypeError, ValueError), match=expected):
        Engine(**arguments)


def test_a_cluster_that_is_not_there_is_named_before_ray_looks_for_it(monkeypatch):
    """Ray itself would try for minutes."""
    monkeypatch.setattr("ray.init", lambda **_: pytest.fail("Ray was asked"))
    with pytest.raises(ValueError, match=r"no Ray cluster at '127\.0\.0\.1:9'"):
        list(Engine("ray", address="127.0.0.1:9").run(slow, [0]))


def test_work_that_cannot_be_pickled_runs_in_this_process_alone():
    lock = threading.Lock()

    def locked(number):
        with lock:
            return number

    assert dict(Engine(jobs=1).run(locked, [2])) == {2: 2}
    with pytest.raises(ValueError, match=r"cannot be sent to other processes .*use --jobs 1"):
        list(Engine(jobs=2).run(locked, [2]))


@dataclasses.dataclass(frozen=True)
class Push:
    force: float

    def at(self, time, tip_velocity):
        return np.full((*np.shape(time), 2), self.force)


PUSHED = Case("pushed", "Case 4: pushed", Disturbance(tip_force=Push(30.0)))


@pytest.fixture
def pushed():
    """The case, which is forgotten at the end."""
    add_case(PUSHED)
    yield
    CASES.pop("pushed", None)


def loads(number):
    return find_case("pushed").disturbance.tip_force.force


def test_work_travels_with_what_was_added_by_name(pushed):
    """As to a process that knows nothing of it, and to one where the name means something else."""
    content = _pickled(loads)
    for known in ({}, {"pushed": dataclasses.replace(PUSHED, disturbance=Disturbance())}):
        del CASES["pushed"]
        CASES.update(known)
        assert _call(content, (), 3) == (3, 30.0)


def test_the_modules_that_work_refers_to_are_sent_to_a_cluster(tmp_path, monkeypatch):
    """Those of a policy and of a case alike, not what every machine has, nor what is run."""
    (tmp_path / "pushes").mkdir()
    (tmp_path / "pushes" / "__init__.py").touch()
    (tmp_path / "pushes" / "side.py").write_text("class Side:\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    side = importlib.import_module("pushes.side")
    work = [side.Side(), dataclasses.fields, np.float64, Engine, "__main__"]
    assert module_sources(cloudpickle.dumps(work)) == (tmp_path / "pushes",)
