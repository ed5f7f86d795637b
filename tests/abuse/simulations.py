"""Environments and policies under way: their arguments, options of a reset, actions, states, observations."""

from __future__ import annotations

import copy
import dataclasses
import functools
import numbers
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.rl_baselines.sb3_vec_env import training_envs
from fuzzyarm.rl_baselines.torch_env import TorchFuzzyArm

from .arguments import construction, driven, names_of
from .surface import Broken, Surface, Try, described
from .values import plausible, spoiled, wrong

__all__ = ["SURFACES"]

LANES = 3
START = np.array([0.3, 0.5, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0])
POLICIES = ("fuzzy-1", "fuzzy-4-tip", "computed-torque", "elastic-observer", "ppo-nominal", "ppo-residual")
OPTIONAL = ("disturbance", "reference", "parameters", "substep", "threads", "render_mode")
COMMON = {
    "case": "nominal",
    "disturbance": Disturbance(),
    "reference": JointReference(),
    "parameters": ArmParameters(),
    "control_period": 1e-3,
    "substep": 2e-4,
    "randomisation": "nominal",
}


def _run_batch(envs: FuzzyArmVectorEnv) -> None:
    if envs.num_envs > 10_000:
        return
    observation, _ = envs.reset(seed=0)
    for _ in range(2):
        _check_finite(observation)
        observation, reward, _, _, _ = envs.step(np.zeros((envs.num_envs, 2)))
        _check_finite(reward)
    envs.close()


def _run_tensors(envs: TorchFuzzyArm) -> None:
    if envs.num_envs > 10_000:
        return
    _check_finite(envs.reset(0).numpy())
    observation, reward, *_ = envs.step(torch.zeros((envs.num_envs, 2)))
    _check_finite(observation.numpy()), _check_finite(reward.numpy())


def _check_finite(values: Any) -> None:
    if not np.isfinite(np.asarray(values, dtype=float)).all():
        raise Broken("a number is not finite")


@functools.cache
def _env() -> FuzzyArmEnv:
    return FuzzyArmEnv()


@functools.cache
def _batch() -> FuzzyArmVectorEnv:
    return FuzzyArmVectorEnv(LANES, case="machining")


@functools.cache
def _tensors() -> TorchFuzzyArm:
    return TorchFuzzyArm(LANES, compiled=False)


@functools.cache
def _policy(name: str) -> Any:
    return load_policy(name)


def _options() -> dict[str, Any]:
    return {"initial_state": START, "reference": JointReference(), "case": "machining"}


def _reset(make: Callable[[], Any], name: str) -> Callable[[np.random.Generator], Try]:
    """Tries of seeds and options; afterwards the environment has to work as before."""

    def attempt(rng: np.random.Generator) -> Try:
        arguments: dict[str, Any] = {"seed": 3, "options": _options()}
        field = "seed" if rng.random() < 0.4 else "options"
        arguments[field] = spoiled(rng, arguments[field])

        def run() -> None:
            env = make()
            observation, _ = env.reset(**arguments)
            _check_finite(observation)
            if field == "seed" and not isinstance(arguments["seed"], list | tuple | range | np.ndarray):
                _check_taken(arguments["seed"], 3)

        return Try(f"{name}.reset({field}={described(arguments[field])})", run)

    return attempt


def _check_taken(value: Any, valid: Any) -> None:
    if value is not None and not plausible(value, valid):
        raise Broken("was taken without a word")


def _actions(make: Callable[[], Any], name: str, valid: np.ndarray) -> Callable[[np.random.Generator], Try]:
    """Tries of actions; a refused one must leave the environment as it was."""

    def attempt(rng: np.random.Generator) -> Try:
        action = spoiled(rng, valid)

        def run() -> None:
            env = make()
            env.reset(seed=0)
            try:
                observation, reward, *_ = env.step(action)
            except (TypeError, ValueError):
                untouched = env.step(valid)[0]
                env.reset(seed=0)
                if not np.array_equal(untouched, env.step(valid)[0]):
                    raise Broken("a refused action moved the arm") from None
                raise
            _check_finite(observation), _check_finite(reward)
            entries = np.asarray(action).ravel().tolist()
            if not all(isinstance(one, numbers.Real) and not isinstance(one, bool) for one in entries):
                raise Broken("was taken without a word")

        return Try(f"{name}.step({described(action)})", run)

    return attempt


def _tensor_actions(rng: np.random.Generator) -> Try:
    valid = np.full((LANES, 2), 5.0)
    action = spoiled(rng, valid)
    given = (
        torch.from_numpy(action)
        if isinstance(action, np.ndarray) and action.dtype.kind == "f" and rng.random() < 0.5
        else action
    )

    def run() -> None:
        envs = _tensors()
        envs.reset(0)
        observation, reward, *_ = envs.step(given)
        _check_finite(observation.numpy()), _check_finite(reward.numpy())

    return Try(f"TorchFuzzyArm.step({described(given)})", run)


def _states(rng: np.random.Generator) -> Try:
    """A state that is not one: refused, and the batch as before; or taken, and the batch steps."""
    envs = _batch()
    envs.reset(seed=5)
    envs.step(np.zeros((LANES, 2)))
    state = envs.get_state()
    changed = spoiled(rng, {name: np.array(value) for name, value in state.items() if name != "made_of"})
    if isinstance(changed, dict):
        changed = {**changed, "made_of": state["made_of"]}

    def run() -> None:
        try:
            envs.set_state(changed)
        except (TypeError, ValueError, KeyError):
            after = envs.get_state()
            if any(after[name].tobytes() != state[name].tobytes() for name in state):
                raise Broken("a refused state changed the batch") from None
            raise
        for _ in range(3):
            observation, reward, *_ = envs.step(np.zeros((LANES, 2)))
            _check_finite(observation), _check_finite(reward)

    return Try(f"set_state({described(changed)})", run)


def _predictions(rng: np.random.Generator) -> Try:
    name = POLICIES[rng.integers(len(POLICIES))]
    policy = _policy(name)
    observation = np.array([[0.3, 0.5, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0]] * 2)
    _, state = policy.predict(observation)
    arguments: dict[str, Any] = {"observation": observation, "state": state, "episode_start": np.array([False, True])}
    field = list(arguments)[rng.integers(3)]
    arguments[field] = spoiled(rng, arguments[field])
    memory = copy.deepcopy(state)

    def run() -> None:
        torque, _ = policy.predict(**arguments)
        given = arguments["observation"]
        if np.shape(torque) != (*np.shape(given)[:-1], 2) or np.asarray(torque).dtype != np.float64:
            raise Broken(f"torque of shape {np.shape(torque)}")
        if field == "observation" and np.asarray(given).dtype.kind not in "fiub":
            raise Broken("was taken without a word")
        if np.isfinite(np.asarray(given, dtype=float)).all() and field == "observation":
            limit = np.array(ArmParameters().torque_limit)
            if not (np.abs(torque) <= limit).all():
                raise Broken("a torque beyond the limit, or not a number")
        if field != "state" and not np.array_equal(state, memory, equal_nan=True):
            raise Broken("predict changed the state it was given")

    return Try(f"{name}.predict({field}={described(arguments[field])})", run)


def _stable_baselines(rng: np.random.Generator) -> Try:
    value = wrong(rng)
    return Try(f"training_envs({described(value)})", lambda: _only_small(value), names_of("num_envs", value))


def _only_small(value: Any) -> None:
    if not (isinstance(value, int) and value > 10_000):
        training_envs(value).close()


def _warm() -> None:
    (
        _run_batch(FuzzyArmVectorEnv(LANES, randomisation="plants")),
        _run_batch(_batch()),
        _run_tensors(_tensors()),
        driven(_env()),
    )
    for name in POLICIES:
        _policy(name).predict(np.zeros((2, 10)))


def _lanes(make: Callable[..., Any], name: str, valid: dict[str, Any], check: Any, count: int) -> Surface:
    """As `construction`, but a number of lanes that no memory holds raises MemoryError, as it should."""
    made = construction(name, make, valid, check, count=count, optional=OPTIONAL)
    return dataclasses.replace(made, group="environments", raises=(MemoryError,))


SURFACES = (
    _lanes(FuzzyArmEnv, "FuzzyArmEnv", {**COMMON, "render_mode": "rgb_array"}, driven, 800),
    _lanes(FuzzyArmVectorEnv, "FuzzyArmVectorEnv", {**COMMON, "num_envs": LANES, "threads": 1}, _run_batch, 800),
    _lanes(
        TorchFuzzyArm,
        "TorchFuzzyArm",
        {**COMMON, "num_envs": LANES, "device": "cpu", "dtype": torch.float64, "compiled": False},
        _run_tensors,
        500,
    ),
    Surface("training_envs", "environments", 100, _stable_baselines, raises=(MemoryError,), prepare=_warm),
    Surface("FuzzyArmEnv.reset", "environments", 700, _reset(_env, "FuzzyArmEnv"), prepare=_warm),
    Surface("FuzzyArmVectorEnv.reset", "environments", 700, _reset(_batch, "FuzzyArmVectorEnv"), prepare=_warm),
    Surface(
        "FuzzyArmEnv.step", "environments", 600, _actions(_env, "FuzzyArmEnv", np.array([5.0, 2.0])), prepare=_warm
    ),
    Surface(
        "FuzzyArmVectorEnv.step",
        "environments",
        600,
        _actions(_batch, "FuzzyArmVectorEnv", np.full((LANES, 2), 5.0)),
        prepare=_warm,
    ),
    Surface("TorchFuzzyArm.step", "environments", 300, _tensor_actions, prepare=_warm),
    Surface("set_state", "environments", 800, _states, prepare=_warm),
    Surface("predict", "policies", 1000, _predictions, prepare=_warm),
)
