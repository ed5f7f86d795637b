"""Every documented name of package and environments: arguments of the wrong kind, out of range, too large."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import fuzzyarm
from fuzzyarm.cli.options import option_name
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
from fuzzyarm.eval.episodes.rollout import run_episode
from fuzzyarm.eval.episodes.rollout_file import write_rollouts
from fuzzyarm.eval.evaluation.ranking import rank_policies
from fuzzyarm.identification.log import read_log
from fuzzyarm.proof.tip.plant import PlantSet
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

from . import samples
from .judged import Broken, examples, held
from .samples import CONTROLLERS, no_code_ran, room, scratch
from .values import plausible, spoiled

pytestmark = pytest.mark.slow

LANES = 3
ENVIRONMENT = {
    "case": "nominal",
    "disturbance": Disturbance(),
    "reference": JointReference(),
    "parameters": ArmParameters(),
    "control_period": 1e-3,
    "substep": 2e-4,
    "randomisation": "nominal",
}
OPTIONAL = [
    "disturbance",
    "reference",
    "parameters",
    "substep",
    "threads",
    "render_mode",
    "robot",
    "start",
    "scale",
    "jobs",
]


class Name(NamedTuple):
    """How a documented name is called.

    Attributes:
        call: with keyword arguments.
        valid: returns arguments that fit together.
        use: called with what came of it.
        checked: whether it checks what it takes; records of results are taken as they are.
    """

    call: Callable[..., Any]
    valid: Callable[[], dict[str, Any]]
    use: Callable[[Any], object] = lambda made: None
    checked: bool = True


def fields(kind: type, start: Callable[[], Any], use: Callable[[Any], object] = repr, checked: bool = True) -> Name:
    """The fields of a dataclass as its arguments."""
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    return Name(kind, lambda: {name: getattr(start(), name) for name in names}, use, checked)


def drive(env: FuzzyArmEnv) -> None:
    """Run the beginning of an episode; everything that comes back has to be finite."""
    observation, _ = env.reset(seed=1)
    for torque in ([0.0, 0.0], [500.0, -250.0]):
        if not np.isfinite(observation).all():
            raise Broken(f"observation {observation} is not finite")
        observation, reward, terminated, truncated, _ = env.step(np.array(torque))
        if not 0.0 <= reward <= 1.0:
            raise Broken(f"reward {reward}")
        if terminated or truncated:
            return


def disturbed(part: str) -> Callable[[Any], object]:
    return lambda made: drive(FuzzyArmEnv(disturbance=Disturbance(**{part: made})))


def sampled(path: Any) -> None:
    if not all(np.isfinite(part).all() for part in path.points(np.linspace(0.0, 1.0, 5))):
        raise Broken("the curve is not finite")


def batch(envs: Any) -> None:
    if envs.num_envs > 10_000:
        return
    observation, _ = envs.reset(seed=0)
    zeros = np.zeros if isinstance(envs, FuzzyArmVectorEnv) else torch.zeros
    observation, reward, *_ = envs.step(zeros((envs.num_envs, 2)))
    if not (np.isfinite(np.asarray(observation)).all() and np.isfinite(np.asarray(reward)).all()):
        raise Broken("a number is not finite")


@functools.cache
def episode() -> Any:
    return run_episode("computed-torque")


@functools.cache
def shipped() -> Any:
    return fuzzyarm.Controller.load(CONTROLLERS / "fuzzy-1.json")


@functools.cache
def found() -> Any:
    return fuzzyarm.find_bound(claim())


def claim() -> Any:
    return fuzzyarm.TipClaim("fuzzy-4-tip", plants=PlantSet(), steps=1)


def small() -> Any:
    return fuzzyarm.SweepConfig(policies=("fuzzy-1",), cases=("nominal",), plants=2)


@functools.cache
def designed() -> Any:
    return fuzzyarm.design(fuzzyarm.Specification(kept=()))


def cached(**arguments: Any) -> Any:
    """Add a policy that is forgotten again."""
    from fuzzyarm.policies import registry

    with mock.patch.dict(registry.POLICIES):
        fuzzyarm.add_policy(**arguments)


def factory(robot: Any, control_period: float) -> Any:
    return fuzzyarm.load_policy("computed-torque")


def out() -> Path:
    return scratch()


EVALUATION = fields(fuzzyarm.EvaluationConfig, lambda: fuzzyarm.EvaluationConfig(policies=("fuzzy-1",)))

DOCUMENTED = {
    "ArmParameters": fields(ArmParameters, ArmParameters, lambda one: drive(FuzzyArmEnv(parameters=one))),
    "BenchConfig": fields(fuzzyarm.BenchConfig, lambda: fuzzyarm.BenchConfig(threads=1)),
    "Controller": fields(fuzzyarm.Controller, shipped, lambda one: one.to_json()),
    "Design": fields(fuzzyarm.Design, designed, lambda one: None, checked=False),
    "DesignProblem": Name(
        fuzzyarm.DesignProblem,
        lambda: {"specification": fuzzyarm.Specification(kept=()), "parameters": ArmParameters(), "scale": 1.0},
    ),
    "Engine": fields(fuzzyarm.Engine, lambda: fuzzyarm.Engine(jobs=1)),
    "EvaluationConfig": EVALUATION,
    "MarginsConfig": fields(fuzzyarm.MarginsConfig, lambda: fuzzyarm.MarginsConfig(robot="paper")),
    "Robot": fields(fuzzyarm.Robot, lambda: robot_named("planar-3r"), lambda one: one.digest),
    "Rollout": fields(fuzzyarm.Rollout, episode, lambda one: None, checked=False),
    "ScheduledSpecification": fields(fuzzyarm.ScheduledSpecification, lambda: fuzzyarm.ScheduledSpecification(rules=2)),
    "Specification": fields(fuzzyarm.Specification, fuzzyarm.Specification),
    "Sweep": Name(fuzzyarm.Sweep.begin, lambda: {"folder": out(), "config": small()}),
    "SweepConfig": fields(fuzzyarm.SweepConfig, small),
    "TSModel": fields(fuzzyarm.TSModel, lambda: fuzzyarm.TSModel(ArmParameters()), lambda one: one.polytope),
    "TipClaim": fields(fuzzyarm.TipClaim, claim),
    "add_policy": Name(cached, lambda: {"name": "own", "factory": factory}),
    "certify": Name(fuzzyarm.certify, lambda: {"controller": shipped()}),
    "design": Name(
        fuzzyarm.design, lambda: {"specification": fuzzyarm.Specification(kept=()), "parameters": ArmParameters()}
    ),
    "design_scheduled": Name(
        fuzzyarm.design_scheduled,
        lambda: {"specification": fuzzyarm.ScheduledSpecification(), "robot": robot_named("planar-3r")},
    ),
    "evaluate": Name(
        fuzzyarm.evaluate, lambda: {"config": fuzzyarm.EvaluationConfig(policies=("fuzzy-1",), cases=("nominal",))}
    ),
    "export_c": Name(
        fuzzyarm.export_c,
        lambda: {"label": "fuzzy-1", "policy": fuzzyarm.load_policy("fuzzy-1"), "folder": out(), "number": "double"},
    ),
    "find_bound": Name(fuzzyarm.find_bound, lambda: {"claim": claim()}),
    "identify": Name(
        fuzzyarm.identify, lambda: {"log": read_log(samples.tables() / "log.csv"), "start": ArmParameters()}
    ),
    "load_policy": Name(
        fuzzyarm.load_policy,
        lambda: {"name": "fuzzy-2", "control_period": 1e-3, "robot": ArmParameters(), "allow_unproven": False},
    ),
    "measure_margins": Name(
        fuzzyarm.measure_margins, lambda: {"config": fuzzyarm.MarginsConfig(policies=("fuzzy-1",))}
    ),
    "metrics_of": Name(fuzzyarm.metrics_of, lambda: {"rollout": episode()}),
    "rank_policies": Name(rank_policies, lambda: {"paths": [samples.evaluated()]}),
    "read_log": Name(fuzzyarm.read_log, lambda: {"path": samples.tables() / "log.csv"}),
    "robot_named": Name(fuzzyarm.robot_named, lambda: {"name": "ur5"}),
    "run_bench": Name(fuzzyarm.run_bench, lambda: {"config": fuzzyarm.BenchConfig(threads=1)}),
    "run_episode": Name(
        fuzzyarm.run_episode,
        lambda: {"policy": "fuzzy-1", "case": "nominal", "seed": 0, "robot": None, "control_period": 1e-3},
    ),
    "save_bound": Name(fuzzyarm.save_bound, lambda: {"bound": found(), "path": out() / "bound.json"}),
    "sheet_of": Name(fuzzyarm.sheet_of, lambda: {"name": "fuzzy-1", "policy": fuzzyarm.load_policy("fuzzy-1")}),
    "tune_arm": Name(fuzzyarm.tune_arm, lambda: {"robot": "paper", "folder": out(), "resume": False, "jobs": 1}),
    "verify_file": Name(fuzzyarm.verify_file, lambda: {"path": CONTROLLERS / "fuzzy-1.json"}),
    "write_figures": Name(fuzzyarm.write_figures, lambda: {"rollouts": [episode()], "folder": out()}),
    "write_report": Name(fuzzyarm.write_report, lambda: {"folder": samples.evaluated(), "out": out() / "report.html"}),
    "write_results": Name(
        fuzzyarm.write_results,
        lambda: {"evaluation": fuzzyarm.evaluate(DOCUMENTED["evaluate"].valid()["config"]), "folder": out()},
    ),
    "write_rollouts": Name(write_rollouts, lambda: {"rollouts": [episode()], "folder": out()}),
    # Environments, and what they are made with.
    "FuzzyArmEnv": Name(FuzzyArmEnv, lambda: {**ENVIRONMENT, "render_mode": "rgb_array"}, drive),
    "FuzzyArmVectorEnv": Name(FuzzyArmVectorEnv, lambda: {**ENVIRONMENT, "num_envs": LANES, "threads": 1}, batch),
    "TorchFuzzyArm": Name(
        TorchFuzzyArm,
        lambda: {**ENVIRONMENT, "num_envs": LANES, "device": "cpu", "dtype": torch.float64, "compiled": False},
        batch,
    ),
    "Circle": fields(Circle, Circle, sampled),
    "Line": fields(Line, lambda: Line((0.3, 0.5), (0.5, 0.3)), sampled),
    "Lemniscate": fields(Lemniscate, lambda: Lemniscate((0.4, 0.5), 0.1), sampled),
    "Spline": fields(Spline, lambda: Spline(((0.3, 0.5), (0.5, 0.3), (0.6, 0.5))), sampled),
    "JointReference": fields(JointReference, JointReference, lambda one: one.sample(np.linspace(0.0, one.duration, 5))),
    "MachiningForce": fields(MachiningForce, MachiningForce, disturbed("tip_force")),
    "ConstantForce": fields(ConstantForce, lambda: ConstantForce((0.0, 50.0), 0.1, math.inf), disturbed("tip_force")),
    "TorqueBias": fields(TorqueBias, lambda: TorqueBias((5.0, 1.0), 0.1, 0.5), disturbed("torque_bias")),
    "EncoderNoise": fields(EncoderNoise, lambda: EncoderNoise(1e-5, 1e-3), disturbed("encoder_noise")),
    "Payload": fields(Payload, lambda: Payload(5.0), disturbed("payload")),
    "Disturbance": fields(Disturbance, lambda: Disturbance(MachiningForce(), Payload(1.0), TorqueBias((1.0, 1.0)))),
    "Case": fields(Case, lambda: Case("own", "Own", Disturbance())),
    "DomainRandomisation": Name(
        DomainRandomisation, lambda: {**dict.fromkeys(ALLOWED, (0.5, 0.5)), "references": (JointReference(),)}
    ),
    "PPOConfig": fields(PPOConfig, PPOConfig, lambda one: PPOConfig.from_dict(one.to_dict())),
    "PlantSet": fields(PlantSet, PlantSet),
}
EXCEPTIONS = {"__version__", "DesignFailed"}
COSTLY = {"run_bench", "identify", "design_scheduled"}
OFTEN = {"ArmParameters", "PPOConfig", "FuzzyArmEnv", "FuzzyArmVectorEnv", "SweepConfig", "Controller"}


def test_every_documented_name_is_here():
    assert set(DOCUMENTED) >= set(fuzzyarm.__all__) - EXCEPTIONS


@pytest.mark.parametrize("name", DOCUMENTED)
def test_arguments_are_refused_by_name_or_right(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fuzzyarm.eval.tuning.run.tune", lambda *arguments, **named: None)  # which takes minutes
    room()
    one = DOCUMENTED[name]
    if name not in COSTLY:
        one.use(one.call(**one.valid()))

    @examples(60 if name in OFTEN else 25)
    @given(data=st.data())
    def attempt(data):
        valid = one.valid()
        field = data.draw(st.sampled_from(list(valid)))
        value, unknown = data.draw(spoiled(valid[field])), data.draw(st.integers(0, 40)) == 7

        def run() -> None:
            made = one.call(**{**valid, (f"{field}_" if unknown else field): value})
            if unknown:
                raise Broken("an unknown argument was taken")
            one.use(made)
            if one.checked and not (plausible(value, valid[field]) or (value is None and field in OPTIONAL)):
                raise Broken("was taken without a word")

        names = () if unknown else (*_names_of(field, value), *valid)
        try:
            held(run, names, (MemoryError, fuzzyarm.DesignFailed))
        except Broken as error:
            raise Broken(f"{name}({field}={_described(value)}): {error}") from None
        no_code_ran()

    attempt()


def _described(value: Any) -> str:
    try:
        return f"{type(value).__name__} {shown(value)[:100]}"
    except Exception:
        return object.__repr__(value)


EFFECTS = {
    "length": ("reach of the arm",),
    "name": ("robot = ",),
    "label": ("File name too long",),
    "paths": ("is not there", "No such file", "directory", "File name too long"),
}


def _text(value: Any) -> str:
    return value[:12] if isinstance(value, str) else "No such file" if isinstance(value, Path) else ""


def _names_of(field: str, value: Any) -> tuple[str, ...]:
    """What a message about a field may name: it, its option, a number in it, or the value."""
    described = _described(value).partition(" ")[2].strip("\"'")[:12]
    camel, effect = field.title().replace("_", ""), EFFECTS.get(field, ())
    own = (field, field.replace("_", " "), option_name(field), field.rstrip("s"))
    return (*own, camel, described, _text(value), *effect)
