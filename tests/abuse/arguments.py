"""The arguments of everything public that is built: arms, paths, references, disturbances, configurations, laws."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.cli.options import option_name
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import Case, find_case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Spline
from fuzzyarm.envs.scenario.randomisation import ALLOWED, DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.bench.config import BenchConfig
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.stability.margins import MarginsConfig
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.engine import Engine
from fuzzyarm.learned_policy.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.learned_policy.network import Network
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.synthesis import Specification

from .surface import Broken, Surface, Try, described
from .values import hostile_text, plausible, spoiled, wrong

__all__ = ["SURFACES", "driven", "names_of"]

Check = Callable[[Any], object]


def names_of(field: str, value: Any) -> tuple[str, ...]:
    """What a message about a field may name: it, its option, a number in it, or the value."""
    shown = described(value).partition(" ")[2].strip("\"'")[:12]
    camel, effect = field.title().replace("_", ""), {"length": ("reach of the arm",)}.get(field, ())
    return field, field.replace("_", " "), option_name(field), field.rstrip("s"), camel, shown, *effect


def driven(env: FuzzyArmEnv) -> None:
    """Run the beginning of an episode; everything that comes back has to be finite."""
    observation, info = env.reset(seed=1)
    for torque in ([0.0, 0.0], [500.0, -250.0]):
        if not np.isfinite(observation).all() or not np.isfinite(info["tip_error"]):
            raise Broken(f"observation {observation} is not finite")
        observation, reward, terminated, truncated, info = env.step(np.array(torque))
        if not 0.0 <= reward <= 1.0:
            raise Broken(f"reward {reward}")
        if terminated or truncated:
            return


def construction(
    name: str,
    make: Callable[..., Any],
    valid: Mapping[str, Any],
    check: Check = repr,
    *,
    count: int = 250,
    optional: tuple[str, ...] = (),
) -> Surface:
    """A surface of the keyword arguments of `make`: one of them is spoiled, the others are valid.

    Args:
        name: of the surface.
        make: what is called.
        valid: arguments that fit together.
        check: called with what was made.
        count: tries of a whole run.
        optional: arguments that may be None.
    """

    def attempt(rng: np.random.Generator) -> Try:
        field = list(valid)[rng.integers(len(valid))]
        value = spoiled(rng, valid[field])
        unknown = rng.random() < 0.02
        arguments = {**valid, (f"{field}_" if unknown else field): value}

        def run() -> None:
            made = make(**arguments)
            if unknown:
                raise Broken("an unknown argument was taken")
            if not (plausible(value, valid[field]) or (value is None and field in optional)):
                raise Broken("was taken without a word")
            check(made)

        return Try(f"{name}({field}={described(value)})", run, () if unknown else (*names_of(field, value), *valid))

    return Surface(name, "arguments", count, attempt, prepare=lambda: check(make(**valid)))


def settings(kind: type, start: Any, check: Check = repr, **options: Any) -> Surface:
    """A surface of the fields of a dataclass."""
    valid = {field.name: getattr(start, field.name) for field in dataclasses.fields(kind)}
    return construction(kind.__name__, kind, valid, check, **options)


def _disturbed(disturbance: Disturbance) -> None:
    driven(FuzzyArmEnv(disturbance=disturbance))


def _armed(arm: ArmParameters) -> None:
    if ArmParameters.from_dict(arm.to_dict()) != arm:
        raise Broken("to_dict and from_dict differ")
    driven(FuzzyArmEnv(parameters=arm))


def _followed(reference: JointReference) -> None:
    motion = reference.sample(np.linspace(-1.0, 2.0 * reference.duration, 7))
    if not all(np.isfinite(part).all() for part in motion):
        raise Broken("the motion is not finite")


def _sampled(path: Any) -> None:
    if not all(np.isfinite(part).all() for part in path.points(np.linspace(0.0, 1.0, 5))):
        raise Broken("the curve is not finite")


def _randomised(randomisation: DomainRandomisation) -> None:
    driven(FuzzyArmEnv(randomisation=randomisation))


def _warm() -> None:
    driven(FuzzyArmEnv()), load_policy("fuzzy-4-tip"), load_policy("elastic-observer")


def _from_dict(rng: np.random.Generator) -> Try:
    values = spoiled(rng, ArmParameters().to_dict())
    return Try(f"ArmParameters.from_dict({described(values)})", lambda: _armed(ArmParameters.from_dict(values)))


class _BadPath:
    """A path whose points are what it is made with."""

    def __init__(self, parts: Any) -> None:
        self.parts = parts

    def points(self, s: Any) -> Any:
        return self.parts


def _own_path(rng: np.random.Generator) -> Try:
    good = Circle().points(np.linspace(0.0, 1.0, 2001))
    parts: Any = tuple(np.array(part) for part in good)
    parts = spoiled(rng, parts)
    return Try(f"a path of one's own: {described(parts)}", lambda: JointReference(_BadPath(parts)))


class _BadForce:
    """A force that returns what it is made with."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def at(self, time: Any, tip_velocity: Any) -> Any:
        return self.value


def _own_force(rng: np.random.Generator) -> Try:
    value = spoiled(rng, np.zeros((7501, 2)))
    return Try(f"a force of one's own: {described(value)}", lambda: _disturbed(Disturbance(tip_force=_BadForce(value))))


def _elastic(rng: np.random.Generator) -> Try:
    value = wrong(rng)
    return Try(f"ElasticReference({described(value)})", lambda: ElasticReference(value), names_of("reference", value))


def _lookups(rng: np.random.Generator) -> Try:
    value = wrong(rng) if rng.random() < 0.5 else hostile_text(rng)
    if isinstance(value, str) and value.startswith("/dev/"):
        value += "x"
    calls = {
        "find_case": find_case,
        "find_randomisation": lambda name: find_randomisation(name, ArmParameters()),
        "load_policy": load_policy,
        "Case.name": lambda name: FuzzyArmEnv(case=name),
    }
    name = list(calls)[rng.integers(len(calls))]
    return Try(f"{name}({described(value)})", lambda: calls[name](value))


def _policy_arguments() -> dict[str, Any]:
    return {"name": "fuzzy-2", "control_period": 1e-3, "robot": ArmParameters(), "allow_unproven": False}


def _network(**parts: Any) -> Network:
    return Network(**parts)


def _network_parts() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    shapes = [(4, 6), (2, 4)]
    return {
        "mean": rng.normal(size=6),
        "std": np.ones(6),
        "clip": 10.0,
        "weights": tuple(rng.normal(size=shape).astype(np.float32) for shape in shapes),
        "biases": tuple(np.zeros(shape[0], dtype=np.float32) for shape in shapes),
    }


SURFACES = (
    settings(ArmParameters, ArmParameters(), _armed, count=1500),
    Surface("ArmParameters.from_dict", "arguments", 400, _from_dict, prepare=_warm),
    settings(Circle, Circle(), _sampled),
    settings(Line, Line((0.3, 0.5), (0.5, 0.3)), _sampled),
    settings(Lemniscate, Lemniscate((0.4, 0.5), 0.1), _sampled),
    settings(Spline, Spline(((0.3, 0.5), (0.5, 0.3), (0.6, 0.5))), _sampled),
    settings(JointReference, JointReference(), _followed, count=400),
    Surface("path of one's own", "arguments", 200, _own_path, prepare=_warm),
    Surface("ElasticReference", "arguments", 100, _elastic),
    settings(MachiningForce, MachiningForce(), lambda one: _disturbed(Disturbance(tip_force=one)), count=400),
    settings(
        ConstantForce,
        ConstantForce((0.0, 50.0), 0.1, math.inf),
        lambda one: _disturbed(Disturbance(tip_force=one)),
        count=400,
    ),
    settings(
        TorqueBias, TorqueBias((5.0, 1.0), 0.1, 0.5), lambda one: _disturbed(Disturbance(torque_bias=one)), count=400
    ),
    settings(EncoderNoise, EncoderNoise(1e-5, 1e-3), lambda one: _disturbed(Disturbance(encoder_noise=one)), count=300),
    settings(Payload, Payload(5.0), lambda one: _disturbed(Disturbance(payload=one)), count=300),
    settings(
        Disturbance,
        Disturbance(MachiningForce(), Payload(1.0), TorqueBias((1.0, 1.0)), EncoderNoise(1e-5, 1e-3)),
        _disturbed,
        count=300,
    ),
    Surface("force of one's own", "arguments", 200, _own_force, prepare=_warm),
    settings(Case, Case("own", "Own", Disturbance()), count=100),
    construction(
        "DomainRandomisation",
        DomainRandomisation,
        {**dict.fromkeys(ALLOWED, (0.5, 0.5)), "references": (JointReference(),)},
        _randomised,
        count=500,
    ),
    Surface("names", "arguments", 500, _lookups, prepare=_warm),
    construction("load_policy", load_policy, _policy_arguments(), count=200, optional=("robot",)),
    settings(EvaluationConfig, EvaluationConfig(policies=("fuzzy-1",)), EvaluationConfig.command, count=500),
    settings(
        SweepConfig, SweepConfig(policies=("fuzzy-1",), ranges=(("mass", 0.9, 1.1),)), SweepConfig.command, count=700
    ),
    settings(BenchConfig, BenchConfig(threads=1), BenchConfig.command, count=300),
    settings(MarginsConfig, MarginsConfig(robot="robot.toml"), MarginsConfig.command, count=200, optional=("robot",)),
    settings(Engine, Engine(jobs=1), count=200, optional=("jobs",)),
    settings(PPOConfig, PPOConfig(), lambda one: PPOConfig.from_dict(one.to_dict()), count=1200),
    settings(Specification, Specification(), lambda one: one.objective, count=400, optional=("alpha", "gamma")),
    settings(FeatureDefinition, FeatureDefinition(), lambda one: one.size, count=300),
    settings(ActionDefinition, ActionDefinition(), lambda one: one.smoothing, count=200),
    construction("Network", _network, _network_parts(), lambda one: one.sizes, count=300),
)
