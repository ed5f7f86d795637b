"""Policies from user code: they run like the others, only if the user names them, and fail in one line."""

import sys
from pathlib import Path

import numpy as np
import pytest
from support.command_line import one_line_error

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.episodes._beliefs import Believing
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate
from fuzzyarm.policies import resolve

ARM = ArmParameters()
TORQUE = """
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy

def factory(control_period, robot):
    return ComputedTorquePolicy(robot, control_period)
"""
PREDICT = """
import numpy as np

class Law:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        {}
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Write a module into the current folder, which is on no path, and return its name; forget it afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())

    def write(source):
        (tmp_path / "my_law.py").write_text(source, encoding="utf-8")
        return "my_law"

    yield write
    sys.modules.pop("my_law", None)


def loaded(name, **options):
    return resolve(name, run_code=True).load(**options)


def test_it_runs_exactly_like_the_same_law_by_name(module):
    name = f"{module(TORQUE)}:factory"
    config = EvaluationConfig(policies=("computed-torque", name), cases=("machining",), encoder_noise=(1e-5, 1e-3))
    named, own = evaluate(config).rows
    assert own == named | {"policy": name, "predict_us": own["predict_us"]}


@pytest.mark.parametrize(
    ("factory", "definition", "taken"),
    [
        ("make", "def make(control_period, robot): return Law(control_period=control_period, robot=robot)", "both"),
        ("make", "def make(*, robot): return Law(robot=robot)", "robot"),
        ("make", "def make(**options): return Law(**options)", "both"),
        ("make", "def make(robot=None, /): return Law() if robot is None else Law(robot=robot)", ""),
        ("Made", "class Made(Law):\n    def __init__(self, control_period): self.given = locals()", "control_period"),
        ("Law.plain", "Law.plain = staticmethod(lambda: Law())", ""),
    ],
)
def test_a_factory_is_given_what_it_names(module, factory, definition, taken):
    law = "class Law:\n    predict = print\n    def __init__(self, **given): self.given = given\n"
    offered = {"control_period": 2e-3, "robot": ArmParameters(mass=(12.0, 8.0))}
    policy = loaded(f"{module(law + definition)}:{factory}", **offered)
    given = {name: value for name, value in policy._policy.given.items() if name in offered}
    assert given == {name: value for name, value in offered.items() if taken in ("both", name)}
    assert policy.control_period == 2e-3


@pytest.mark.parametrize(
    ("source", "name", "expected"),
    [
        ("", "my_other:factory", "No module named 'my_other'; this module is neither in"),
        ("", "my_law.deep:factory", "No module named 'my_law.deep'; 'my_law' is not a package"),
        ("\n1 / 0", "my_law:factory", "ing my_law failed: ZeroDivisionError: division by zero (my_law.py, line 2)"),
        ("import sys; sys.exit(3)", "my_law:factory", "importing my_law failed: SystemExit: 3"),
        ("", "my_law:factory", "has no factory"),
        ("factory = 3", "my_law:factory", "my_law:factory is of type int; needed: a function or class"),
        ("def factory(size): return size", "my_law:factory", "the factory failed: TypeError: factory() missing 1"),
        ("def factory(): return {}", "my_law:factory", "returned an object of type dict; needed: a policy with"),
        ("raise KeyError('x')", "my_law:Law", "KeyError: 'x' (my_law.py, line 6)"),
        ("return np.zeros(3)", "my_law:Law", "did not return (action, state): ValueError: too many"),
        ("return np.zeros((1, 2)), None", "my_law:Law", "shape (1, 2) for observations of shape (10,)"),
        ("return np.full(2, np.nan), None", "my_law:Law", "action = [nan, nan] N m is not finite"),
        ("return np.array(['a', 'b']), None", "my_law:Law", "must be two real numbers"),
    ],
)
def test_what_goes_wrong_is_one_line_and_exit_code_2(module, tmp_path, capsys, source, name, expected):
    module(PREDICT.format(source) if name == "my_law:Law" else source)
    out = tmp_path / "out"
    assert main(["evaluate", "--policy", name, "--case", "nominal", "--out", str(out)]) == 2
    error = one_line_error(capsys)
    assert expected in error and name in error and not out.exists()


def test_load_policy_runs_no_code(module, tmp_path):
    """It is given names out of files: of learned policies, reports and sweeps."""
    name = f"{module('open(`ran`, `w`).close()'.replace('`', chr(39)) + TORQUE)}:factory"
    with pytest.raises(ValueError, match="names code, which load_policy does not run"):
        load_policy(name)
    assert not (tmp_path / "ran").exists()
    loaded(name)
    assert (tmp_path / "ran").exists()


LEARNING = """
from types import SimpleNamespace

import numpy as np

class Law:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = 0 if state is None else state
        return np.full(observation.shape[:-1] + (2,), float(count)), count

    def begin_pass(self, state):
        return state + 1

    def repeated(self):
        return self

    def beliefs(self, state):
        return SimpleNamespace(force=np.array([state, 0.0]), force_deviation=np.ones(2), payload=1.0,
                               payload_deviation=0.1)
"""


def test_what_it_learns_from_a_pass_and_what_it_believes_is_passed_on(module):
    repeated, state, torques = loaded(f"{module(LEARNING)}:Law").repeated(), None, []
    for _ in range(3):
        torque, state = repeated.predict(np.zeros(10), state)
        torques.append(torque[0])
        state = repeated.begin_pass(state)
    assert torques == [0.0, 1.0, 2.0]
    believing = Believing(repeated)
    believing.add(2)
    np.testing.assert_array_equal(believing.rows(), [[2.0, 0.0, 1.0, 1.0, 1.0, 0.1]])


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("return self\n", "return 3\n", "repeated() returned an object of type int, which has no method predict"),
        ("begin_pass", "begin", "repeated() returned an object of type Law, which has no method begin_pass"),
        ("return self\n", "return 1 / 0\n", "repeated failed: ZeroDivisionError: division by zero (my_law"),
        ("return state + 1", "return 1 / 0", "begin_pass failed: ZeroDivisionError"),
        ("payload=1.0,", "", "beliefs() returned an object of type SimpleNamespace, which lacks payload"),
    ],
)
def test_what_fails_between_passes_is_one_line(module, before, after, expected):
    policy = loaded(f"{module(LEARNING.replace(before, after))}:Law")
    with pytest.raises(ValueError) as refused:
        _ = policy.repeated().begin_pass(0), policy.beliefs(0)
    assert str(refused.value).startswith(f"my_law:Law: {expected}") and "\n" not in str(refused.value)


TEMPLATE = "examples.own_controller:factory"


@pytest.fixture
def template(monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.chdir(Path(__file__).parents[2])
    return loaded(TEMPLATE)


def test_at_rest_on_the_reference_the_template_holds_the_weight(template):
    """g(q) by differences of the potential energy of two point masses; x points down."""
    (m1, m2), (r1, r2), length, h = ARM.mass, ARM.mass_center, ARM.length[0], 1e-6

    def potential(q):
        return -ARM.gravity * (m1 * r1 * np.cos(q[0]) + m2 * (length * np.cos(q[0]) + r2 * np.cos(q[0] + q[1])))

    for q in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2)):
        torque, _ = template.predict(np.concatenate([q, np.zeros(2), q, np.zeros(4)]))
        slopes = [(potential(q + h * e) - potential(q - h * e)) / (2.0 * h) for e in np.eye(2)]
        np.testing.assert_allclose(torque, slopes, atol=1e-6)
    batch = np.random.default_rng(0).normal(size=(5, 10))
    for lane, torque in zip(batch, template.predict(batch)[0], strict=True):
        np.testing.assert_array_equal(template.predict(lane)[0], torque)


@pytest.mark.usefixtures("template", "undrawn")
def test_the_template_joins_the_comparison(tmp_path, capsys):
    assert main(["evaluate", "--policy", TEMPLATE, "--case", "nominal", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert f"\nnothing is proven for the rigid arm: {TEMPLATE}\n" in out  # rich has a picture for :factory:
    error = float(next(line for line in out.splitlines() if line.startswith(f"{TEMPLATE} ")).split()[1])
    assert 1.0 < error < 10.0
