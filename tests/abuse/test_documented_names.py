"""Every documented name refuses arguments of the wrong kind, in one line that names the argument or the value."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import pytest
import torch

import fuzzyarm
from fuzzyarm import ArmParameters, load_policy, robot_named
from fuzzyarm.cli._options import option_name
from fuzzyarm.common.checks import shown
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.scenario.cases import Case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Spline
from fuzzyarm.envs.scenario.randomisation import ALLOWED, DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.rollout_file import write_rollouts
from fuzzyarm.eval.evaluation.ranking import rank_policies
from fuzzyarm.policies import registry
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

from . import samples
from .judged import Broken, held
from .samples import CONTROLLERS, scratch

pytestmark = pytest.mark.slow

CLAIM = fuzzyarm.TipClaim("fuzzy-4-tip", plants=PlantSet(), steps=1)
CONFIG = fuzzyarm.EvaluationConfig(policies=("fuzzy-1",), cases=("nominal",))
SHIPPED = fuzzyarm.Controller.load(CONTROLLERS / "fuzzy-1.json")
SMALL = fuzzyarm.SweepConfig(policies=("fuzzy-1",), cases=("nominal",), plants=2)
bound = functools.cache(lambda: fuzzyarm.find_bound(CLAIM))
episode = functools.cache(lambda: fuzzyarm.run_episode("computed-torque"))
evaluation = functools.cache(lambda: fuzzyarm.evaluate(CONFIG))


def add_policy(**arguments: Any) -> None:
    """Add a policy that is forgotten again."""
    with mock.patch.dict(registry.POLICIES):
        fuzzyarm.add_policy(**arguments)


RECORDS = (
    ArmParameters(), fuzzyarm.BenchConfig(threads=1), SHIPPED, fuzzyarm.Engine(jobs=1), CONFIG,
    fuzzyarm.MarginsConfig(robot="paper"), robot_named("planar-3r"), fuzzyarm.ScheduledSpecification(rules=2),
    fuzzyarm.Specification(), SMALL, fuzzyarm.TSModel(ArmParameters()), CLAIM, PPOConfig(), PlantSet(), Circle(),
    Line((0.3, 0.5), (0.5, 0.3)), Lemniscate((0.4, 0.5), 0.1), Spline(((0.3, 0.5), (0.5, 0.3), (0.6, 0.5))),
    JointReference(), MachiningForce(), ConstantForce((0.0, 50.0), 0.1, math.inf), TorqueBias((5.0, 1.0), 0.1, 0.5),
    EncoderNoise(1e-5, 1e-3), Payload(5.0), Disturbance(MachiningForce(), Payload(1.0), TorqueBias((1.0, 1.0))),
    Case("own", "Own", Disturbance()),
)  # fmt: skip
"""Whose fields are their arguments."""

ENVIRONMENT = {
    "case": "nominal",
    "disturbance": Disturbance(),
    "reference": JointReference(),
    "parameters": ArmParameters(),
    "control_period": 1e-3,
    "substep": 2e-4,
    "randomisation": "nominal",
}
TENSORS = {"device": "cpu", "dtype": torch.float64, "compiled": False}
LOG = {"columns": {"q1": "q_motor1"}, "units": {"q": "rad"}, "gear": (1.0,), "delay": 0.0}
EPISODE = {"policy": "fuzzy-1", "case": "nominal", "seed": 0, "robot": None, "control_period": 1e-3}

ARGUMENTS: dict[Callable[..., Any], Callable[[], dict[str, Any]]] = {
    add_policy: lambda: {"name": "own", "factory": lambda *_: None},
    fuzzyarm.DesignProblem: lambda: {"specification": fuzzyarm.Specification(kept=()), "scale": 1.0},
    fuzzyarm.Sweep.begin: lambda: {"folder": scratch(), "config": SMALL},
    fuzzyarm.certify: lambda: {"controller": SHIPPED},
    fuzzyarm.design: lambda: {"specification": fuzzyarm.Specification(), "parameters": ArmParameters()},
    fuzzyarm.design_scheduled: lambda: {
        "specification": fuzzyarm.ScheduledSpecification(),
        "robot": robot_named("planar-3r"),
    },
    fuzzyarm.evaluate: lambda: {"config": CONFIG},
    fuzzyarm.export_c: lambda: {
        "label": "fuzzy-1",
        "policy": load_policy("fuzzy-1"),
        "folder": scratch(),
        "number": "double",
    },
    fuzzyarm.find_bound: lambda: {"claim": CLAIM},
    fuzzyarm.identify: lambda: {
        "logs": fuzzyarm.read_log(samples.tables() / "log.csv"),
        "start": ArmParameters(),
    },
    load_policy: lambda: {
        "name": "fuzzy-2",
        "control_period": 1e-3,
        "robot": ArmParameters(),
        "allow_unproven": False,
    },
    fuzzyarm.measure_margins: lambda: {"config": fuzzyarm.MarginsConfig(policies=("fuzzy-1",))},
    fuzzyarm.metrics_of: lambda: {"rollout": episode()},
    rank_policies: lambda: {"paths": [samples.evaluated()]},
    fuzzyarm.read_log: lambda: {"path": samples.tables() / "log.csv", **LOG},
    robot_named: lambda: {"name": "ur5"},
    fuzzyarm.run_bench: lambda: {"config": fuzzyarm.BenchConfig(threads=1)},
    fuzzyarm.run_episode: lambda: EPISODE,
    fuzzyarm.save_bound: lambda: {"bound": bound(), "path": scratch() / "b.json"},
    fuzzyarm.sheet_of: lambda: {"name": "fuzzy-1", "policy": load_policy("fuzzy-1")},
    fuzzyarm.tune_arm: lambda: {"robot": "paper", "folder": scratch(), "resume": False, "jobs": 1},
    fuzzyarm.verify_file: lambda: {"path": CONTROLLERS / "fuzzy-1.json"},
    fuzzyarm.write_figures: lambda: {"rollouts": [episode()], "folder": scratch()},
    fuzzyarm.write_report: lambda: {"folder": samples.evaluated(), "out": scratch() / "report.html"},
    fuzzyarm.write_results: lambda: {"evaluation": evaluation(), "folder": scratch()},
    write_rollouts: lambda: {"rollouts": [episode()], "folder": scratch()},
    FuzzyArmEnv: lambda: {**ENVIRONMENT, "render_mode": "rgb_array"},
    FuzzyArmVectorEnv: lambda: {**ENVIRONMENT, "num_envs": 3, "threads": 1},
    TorchFuzzyArm: lambda: {**ENVIRONMENT, "num_envs": 3, **TENSORS},
    DomainRandomisation: lambda: {**dict.fromkeys(ALLOWED, (0.5, 0.5)), "references": (JointReference(),)},
}
"""What is called with keyword arguments, and a function that returns arguments that fit together."""


def fields(record: Any) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record) if field.init}


ARGUMENTS |= {type(record): functools.partial(fields, record) for record in RECORDS}
DOCUMENTED = {call.__qualname__.removesuffix(".begin"): (call, make) for call, make in ARGUMENTS.items()}
ELSEWHERE = {"__version__", "DesignFailed", "Design", "Rollout"}
"""An exception, and records of results, which are taken as they are."""


def test_every_documented_name_is_here():
    assert set(DOCUMENTED) >= set(fuzzyarm.__all__) - ELSEWHERE


NEVER = (object(), 1j, b"1", (one for one in (1.0, 2.0)))
"""What no argument may be that has a value by default."""


def wrong_values(valid: Any) -> Iterator[Any]:
    """Yield what stands in place of a valid argument."""
    if valid is not None:
        yield from NEVER
    match valid:
        case bool():
            yield from (2, "True")
        case int():
            yield from (0.5, math.nan, True, "1")
        case float():
            yield from (math.nan, -math.inf, 10**400, True, "1")
        case str():
            yield from (3, ["a"])
        case tuple() if valid:
            yield from ("ab", (*valid[:-1], object()), {1: 2})


@pytest.mark.parametrize("name", DOCUMENTED)
def test_arguments_of_the_wrong_kind_are_refused_by_name(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    call, make = DOCUMENTED[name]
    with pytest.raises(TypeError):
        call(**make(), unknown=1)
    for field, value in [(field, value) for field, valid in make().items() for value in wrong_values(valid)]:
        given, text = make() | {field: value}, shown(value)
        spellings = (field.replace("_", " "), option_name(field), field.rstrip("s"), field.title().replace("_", ""))
        try:
            accepted = held(functools.partial(call, **given), (*given, *spellings, text.strip("\"'")[:12]))
        except Broken as error:
            raise Broken(f"{name}({field}={text}): {error}") from None
        assert not accepted, f"{name}({field}={text}) was taken without a word"
