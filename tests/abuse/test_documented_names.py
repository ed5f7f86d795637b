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
from fuzzyarm.cli._options import option_name
from fuzzyarm.common.checks import shown
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
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

ENVIRONMENT = {
    "case": "nominal",
    "disturbance": Disturbance(),
    "reference": JointReference(),
    "parameters": ArmParameters(),
    "control_period": 1e-3,
    "substep": 2e-4,
    "randomisation": "nominal",
}

Name = tuple[Callable[..., Any], Callable[[], dict[str, Any]]]
"""What is called with keyword arguments, and a function that returns arguments that fit together."""


def fields(kind: type, start: Callable[[], Any] | None = None) -> Name:
    """The fields of a dataclass as its arguments; `start` returns an instance."""
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    return kind, lambda: {name: getattr((start or kind)(), name) for name in names}


@functools.cache
def episode() -> Any:
    return fuzzyarm.run_episode("computed-torque")


@functools.cache
def shipped() -> Any:
    return fuzzyarm.Controller.load(CONTROLLERS / "fuzzy-1.json")


def claim() -> Any:
    return fuzzyarm.TipClaim("fuzzy-4-tip", plants=PlantSet(), steps=1)


def small() -> Any:
    return fuzzyarm.SweepConfig(policies=("fuzzy-1",), cases=("nominal",), plants=2)


def config() -> Any:
    return fuzzyarm.EvaluationConfig(policies=("fuzzy-1",), cases=("nominal",))


@functools.cache
def bound() -> Any:
    return fuzzyarm.find_bound(claim())


@functools.cache
def evaluation() -> Any:
    return fuzzyarm.evaluate(config())


def add_policy(**arguments: Any) -> None:
    """Add a policy that is forgotten again."""
    with mock.patch.dict(registry.POLICIES):
        fuzzyarm.add_policy(**arguments)


DOCUMENTED: dict[str, Name] = {
    "ArmParameters": fields(ArmParameters),
    "BenchConfig": fields(fuzzyarm.BenchConfig, lambda: fuzzyarm.BenchConfig(threads=1)),
    "Controller": fields(fuzzyarm.Controller, shipped),
    "DesignProblem": (fuzzyarm.DesignProblem, lambda: {"specification": fuzzyarm.Specification(kept=()), "scale": 1.0}),
    "Engine": fields(fuzzyarm.Engine, lambda: fuzzyarm.Engine(jobs=1)),
    "EvaluationConfig": fields(fuzzyarm.EvaluationConfig, config),
    "MarginsConfig": fields(fuzzyarm.MarginsConfig, lambda: fuzzyarm.MarginsConfig(robot="paper")),
    "Robot": fields(fuzzyarm.Robot, lambda: robot_named("planar-3r")),
    "ScheduledSpecification": fields(fuzzyarm.ScheduledSpecification, lambda: fuzzyarm.ScheduledSpecification(rules=2)),
    "Specification": fields(fuzzyarm.Specification),
    "Sweep": (fuzzyarm.Sweep.begin, lambda: {"folder": scratch(), "config": small()}),
    "SweepConfig": fields(fuzzyarm.SweepConfig, small),
    "TSModel": fields(fuzzyarm.TSModel, lambda: fuzzyarm.TSModel(ArmParameters())),
    "TipClaim": fields(fuzzyarm.TipClaim, claim),
    "add_policy": (add_policy, lambda: {"name": "own", "factory": lambda *_: None}),
    "certify": (fuzzyarm.certify, lambda: {"controller": shipped()}),
    "design": (fuzzyarm.design, lambda: {"specification": fuzzyarm.Specification(), "parameters": ArmParameters()}),
    "design_scheduled": (
        fuzzyarm.design_scheduled,
        lambda: {"specification": fuzzyarm.ScheduledSpecification(), "robot": robot_named("planar-3r")},
    ),
    "evaluate": (fuzzyarm.evaluate, lambda: {"config": config()}),
    "export_c": (
        fuzzyarm.export_c,
        lambda: {
            "label": "fuzzy-1",
            "policy": fuzzyarm.load_policy("fuzzy-1"),
            "folder": scratch(),
            "number": "double",
        },
    ),
    "find_bound": (fuzzyarm.find_bound, lambda: {"claim": claim()}),
    "identify": (
        fuzzyarm.identify,
        lambda: {"logs": fuzzyarm.read_log(samples.tables() / "log.csv"), "start": ArmParameters()},
    ),
    "load_policy": (
        fuzzyarm.load_policy,
        lambda: {"name": "fuzzy-2", "control_period": 1e-3, "robot": ArmParameters(), "allow_unproven": False},
    ),
    "measure_margins": (fuzzyarm.measure_margins, lambda: {"config": fuzzyarm.MarginsConfig(policies=("fuzzy-1",))}),
    "metrics_of": (fuzzyarm.metrics_of, lambda: {"rollout": episode()}),
    "rank_policies": (rank_policies, lambda: {"paths": [samples.evaluated()]}),
    "read_log": (
        fuzzyarm.read_log,
        lambda: {
            "path": samples.tables() / "log.csv",
            "columns": {"q1": "q_motor1"},
            "units": {"q": "rad"},
            "gear": (1.0,),
            "delay": 0.0,
        },
    ),
    "robot_named": (robot_named, lambda: {"name": "ur5"}),
    "run_bench": (fuzzyarm.run_bench, lambda: {"config": fuzzyarm.BenchConfig(threads=1)}),
    "run_episode": (
        fuzzyarm.run_episode,
        lambda: {"policy": "fuzzy-1", "case": "nominal", "seed": 0, "robot": None, "control_period": 1e-3},
    ),
    "save_bound": (fuzzyarm.save_bound, lambda: {"bound": bound(), "path": scratch() / "b.json"}),
    "sheet_of": (fuzzyarm.sheet_of, lambda: {"name": "fuzzy-1", "policy": fuzzyarm.load_policy("fuzzy-1")}),
    "tune_arm": (fuzzyarm.tune_arm, lambda: {"robot": "paper", "folder": scratch(), "resume": False, "jobs": 1}),
    "verify_file": (fuzzyarm.verify_file, lambda: {"path": CONTROLLERS / "fuzzy-1.json"}),
    "write_figures": (fuzzyarm.write_figures, lambda: {"rollouts": [episode()], "folder": scratch()}),
    "write_report": (
        fuzzyarm.write_report,
        lambda: {"folder": samples.evaluated(), "out": scratch() / "report.html"},
    ),
    "write_results": (
        fuzzyarm.write_results,
        lambda: {"evaluation": evaluation(), "folder": scratch()},
    ),
    "write_rollouts": (write_rollouts, lambda: {"rollouts": [episode()], "folder": scratch()}),
    # Environments, and what they are made with.
    "FuzzyArmEnv": (FuzzyArmEnv, lambda: {**ENVIRONMENT, "render_mode": "rgb_array"}),
    "FuzzyArmVectorEnv": (FuzzyArmVectorEnv, lambda: {**ENVIRONMENT, "num_envs": 3, "threads": 1}),
    "TorchFuzzyArm": (
        TorchFuzzyArm,
        lambda: {**ENVIRONMENT, "num_envs": 3, "device": "cpu", "dtype": torch.float64, "compiled": False},
    ),
    "Circle": fields(Circle),
    "Line": fields(Line, lambda: Line((0.3, 0.5), (0.5, 0.3))),
    "Lemniscate": fields(Lemniscate, lambda: Lemniscate((0.4, 0.5), 0.1)),
    "Spline": fields(Spline, lambda: Spline(((0.3, 0.5), (0.5, 0.3), (0.6, 0.5)))),
    "JointReference": fields(JointReference),
    "MachiningForce": fields(MachiningForce),
    "ConstantForce": fields(ConstantForce, lambda: ConstantForce((0.0, 50.0), 0.1, math.inf)),
    "TorqueBias": fields(TorqueBias, lambda: TorqueBias((5.0, 1.0), 0.1, 0.5)),
    "EncoderNoise": fields(EncoderNoise, lambda: EncoderNoise(1e-5, 1e-3)),
    "Payload": fields(Payload, lambda: Payload(5.0)),
    "Disturbance": fields(Disturbance, lambda: Disturbance(MachiningForce(), Payload(1.0), TorqueBias((1.0, 1.0)))),
    "Case": fields(Case, lambda: Case("own", "Own", Disturbance())),
    "DomainRandomisation": (
        DomainRandomisation,
        lambda: {**dict.fromkeys(ALLOWED, (0.5, 0.5)), "references": (JointReference(),)},
    ),
    "PPOConfig": fields(PPOConfig),
    "PlantSet": fields(PlantSet),
}
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
