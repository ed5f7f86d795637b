"""Entries of the speed table: this project's environments, its sweeps in one kernel or step by step, and their peers.

A step is a control step with observation, reward and any reset that is due, under actions drawn beforehand. The peers
are the most similar environments of Gymnasium and EnvPool, and the same arm in MuJoCo.
"""

import contextlib
import dataclasses
import functools
import importlib.util
import itertools
import os
import shutil
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np

import fuzzyarm
from fuzzyarm.envs.batch.workers import LANES_PER_THREAD
from fuzzyarm.envs.periods import MAX_DEFAULT_SUBSTEP
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.bench._accuracy import exact_tips, max_tip_difference, stepped_tips
from fuzzyarm.eval.sweep._episodes import errors_in_one_kernel, errors_step_by_step
from fuzzyarm.eval.sweep._plants import Plants
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.policies import load_policy

__all__ = [
    "UNAVAILABLE", "Entry", "Measure", "batch_entries", "compiled_batch", "single_entries", "sweep_entries", "timed",
]  # fmt: skip


Measure = Callable[[float], float]
"""Wall time to spend [s] -> environment steps per second."""

_TORQUE_SCALE = 0.1  # of the torque limits: the arm moves and slips, but does not leave the joint domain
_TORCH_LANES = 4096  # smallest batch measured in torch: below, the fixed cost of a step, a tenth of a ms, dominates
_MOST_PEER_LANES = 4096  # EnvPool takes a minute to open a thousand environments of one kind

UNAVAILABLE = (ImportError, gym.error.Error, RuntimeError)
"""The errors of opening an entry whose package, compiler or device is missing."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """A line of the speed table.

    `open` returns a context that builds and frees the environment and yields the measuring function; entering raises
    one of `UNAVAILABLE` if the entry cannot run. `tip_error` returns the largest distance [m] of the tip from the event
    integrator's in the nominal case under computed torque; None where it is not defined.
    """

    name: str
    lanes: int  # environments stepped by one call
    threads: int  # CPU threads it may use
    open: Callable[[], contextlib.AbstractContextManager[Measure]]
    dtype: str = "float64"  # of the physics
    peer: str = ""  # heading of the ratio to this entry; empty for the entries of this project
    tip_error: Callable[[], float] | None = None


def single_entries() -> list[Entry]:
    """Return the entries that step a single environment made by `gymnasium.make`: this project's and peers."""
    opened = functools.partial(_single_environment, "FuzzyArm-v0", _TORQUE_SCALE)
    found = [Entry("FuzzyArm-v0, machine code", 1, 1, opened, tip_error=_own_tip_error)]
    for heading, name in (("Pendulum", "Pendulum-v1"), ("Reacher", "Reacher-v5")):
        opened = functools.partial(_single_environment, name, 1.0)
        found.append(Entry(f"Gymnasium {name}", 1, 1, opened, peer=heading))
    return found


def batch_entries(lanes: int, threads: int) -> list[Entry]:
    """Return the entries that step `lanes` environments as a batch, on at most `threads` threads.

    They are ours, ours in torch (from 4096 lanes on), and peers (up to 4096 lanes).
    """
    used = min(threads, max(1, lanes // LANES_PER_THREAD))  # the environment's own default: as many threads as help
    own = functools.partial(_batch, lanes, used)
    found = [Entry("FuzzyArm-v0, machine code", lanes, used, own, tip_error=_own_tip_error)]
    if lanes >= _TORCH_LANES:
        for device, dtype in itertools.product(("cpu", "cuda"), ("float64", "float32")):
            name = f"FuzzyArm, torch.compile, {'GPU' if device == 'cuda' else 'CPU'}"
            opened = functools.partial(_torch, lanes, threads, device, dtype)
            error = functools.partial(_torch_tip_error, device, dtype)
            found.append(Entry(name, lanes, threads, opened, dtype=dtype, tip_error=error))
    if lanes <= _MOST_PEER_LANES:
        for heading, name in (("Pendulum", "Pendulum-v1"), ("Reacher", "ReacherEasy-v1")):
            opened = functools.partial(_envpool, name, lanes, threads)
            found.append(Entry(f"EnvPool {name}", lanes, threads, opened, peer=heading))
        # `benchmarks/mujoco_arm.py` chose both methods: the fastest that is as accurate as ours, and the fastest.
        for heading, substeps, step in (("MuJoCo arm", 30, "1/30 ms"), ("MuJoCo arm, 1 ms", 1, "1 ms")):
            opened = functools.partial(_mujoco, lanes, threads, substeps)
            error = functools.partial(_mujoco_tip_error, substeps)
            found.append(Entry(f"same arm in MuJoCo, {step}", lanes, threads, opened, "float64", heading, error))
    return found


def sweep_entries() -> dict[str, list[Entry]]:
    """Return the entries of sweeps by heading, two for each of two policies; they run one chunk of `fuzzyarm sweep`.

    A chunk runs on one thread. The first entry runs in one kernel; the second, its peer, step by step.
    """
    found = {}
    for policy in ("fuzzy-4-tip", "elastic-observer"):
        config = SweepConfig(policies=(policy,), plants=SweepConfig.chunk)
        name, lanes = f"sweep of {policy}", config.plants * len(config.cases)
        found[name] = [
            Entry(f"{name}, {how}", lanes, 1, functools.partial(_swept, config, run), peer=peer)
            for how, run, peer in (
                ("in one kernel", errors_in_one_kernel, ""),
                ("step by step", errors_step_by_step, "step by step"),
            )
        ]
    return found


def timed(advance: Callable[[], int], clock: Callable[[], float] = time.perf_counter) -> Measure:
    """Return a function that calls `advance` for a time [s] and returns steps/s; `advance` returns its step count."""

    def measure(seconds: float) -> float:
        begin, steps = clock(), 0
        while True:
            steps += advance()
            elapsed = clock() - begin
            if elapsed >= seconds:
                return steps / elapsed

    return measure


def _timed_batch(envs: Any, space: gym.Space, lanes: int, scale: float) -> Measure:
    """Return a function that measures the steps/s of a batch; a lane's actions are drawn from `scale` times `space`."""
    ring = itertools.cycle(_draw_actions(space, 4, (lanes,), scale))

    def advance() -> int:
        envs.step(next(ring))
        return lanes

    return timed(advance)


def _draw_actions(space: gym.Space, count: int, lanes: tuple[int, ...], scale: float) -> np.ndarray:
    """Return random actions (count, *lanes, *space.shape), drawn uniformly from the space times the factor `scale`."""
    assert isinstance(space, gym.spaces.Box)
    low, high = scale * space.low.astype(float), scale * space.high.astype(float)
    values = np.random.default_rng(0).uniform(low, high, (count, *lanes, *low.shape))
    return values.astype(space.dtype)


@contextlib.contextmanager
def _single_environment(name: str, scale: float) -> Iterator[Measure]:
    """Open an environment and yield its measuring function; actions are drawn from `scale` times its action space."""
    with contextlib.closing(gym.make(name)) as env:
        actions = list(_draw_actions(env.action_space, 64, (), scale))
        env.reset(seed=0)

        def advance() -> int:
            for action in actions:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset()
            return len(actions)

        yield timed(advance)


def compiled_batch(lanes: int, threads: int) -> gym.vector.VectorEnv:
    """Return `lanes` environments FuzzyArm-v0 as one batch of `gymnasium.make_vec`, after a reset."""
    envs = gym.make_vec("FuzzyArm-v0", num_envs=lanes, vectorization_mode="vector_entry_point", threads=threads)
    envs.reset(seed=0)
    return envs


@contextlib.contextmanager
def _batch(lanes: int, threads: int) -> Iterator[Measure]:
    with contextlib.closing(compiled_batch(lanes, threads)) as envs:
        yield _timed_batch(envs, envs.single_action_space, lanes, _TORQUE_SCALE)


@contextlib.contextmanager
def _torch(lanes: int, threads: int, device: str, dtype: str) -> Iterator[Measure]:
    torch_env, torch = _torch_modules(device)
    threads_before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        arm = torch_env.TorchFuzzyArm(lanes, device=device, dtype=getattr(torch, dtype), compiled=True)
        observation, _ = arm.reset(seed=0)
        limit = np.array(ArmParameters().torque_limit)
        space = gym.spaces.Box(-limit, limit, dtype=np.float64)
        actions = observation.new_tensor(_draw_actions(space, 4, (lanes,), _TORQUE_SCALE))

        def advance() -> int:
            for action in actions:
                arm.step(action)
            if device == "cuda":
                torch.cuda.synchronize()  # a step only enqueues work on the device
            return len(actions) * lanes

        yield timed(advance)
    finally:
        torch.set_num_threads(threads_before)


def _torch_modules(device: str) -> tuple[ModuleType, ModuleType]:
    """Return the modules `torch_env` and torch; ImportError or RuntimeError without torch, the device or a compiler."""
    # By name: only rl_baselines imports torch, which is optional.
    torch_env = importlib.import_module("fuzzyarm.rl_baselines.torch_env")
    torch: ModuleType = torch_env.torch
    if device == "cuda" and not torch.cuda.is_available():
        raise RuntimeError("torch finds no GPU")
    compilers = (os.environ.get("CXX"), "g++", "clang++", "cl")
    if not any(shutil.which(name) for name in compilers if name):
        raise RuntimeError("torch.compile needs a C++ compiler: install g++ or clang++, or name one in CXX")
    return torch_env, torch


@contextlib.contextmanager
def _envpool(name: str, lanes: int, threads: int) -> Iterator[Measure]:
    import envpool

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium's, on the precision of EnvPool's spaces
        envs = envpool.make_gymnasium(name, num_envs=lanes, num_threads=threads, seed=0)
        envs.reset()
        measure = _timed_batch(envs, envs.action_space, lanes, 1.0)
    with contextlib.closing(envs):
        yield measure


@contextlib.contextmanager
def _mujoco(lanes: int, threads: int, substeps: int) -> Iterator[Measure]:
    yield functools.partial(_mujoco_arm().steps_per_second, lanes, threads, 1e-3 / substeps, "Euler")


@functools.cache
def _mujoco_arm() -> ModuleType:
    """Import the benchmark with the arm in MuJoCo, which is in the repository but not in the installed package."""
    path = Path(fuzzyarm.__file__).parents[1] / "benchmarks" / "mujoco_arm.py"
    if not path.exists():
        raise RuntimeError("benchmarks/mujoco_arm.py is missing: run from a clone of the repository")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextlib.contextmanager
def _swept(config: SweepConfig, run: Callable[..., Any]) -> Iterator[Measure]:
    (name,) = config.policies
    plants, policy = Plants(config, config.members(0), config.cases), load_policy(name)
    with contextlib.closing(plants.envs):

        def advance() -> int:
            errors = run(plants, policy)
            assert errors is not None  # the policy has a law for the kernel
            return int(errors.steps.sum())

        yield timed(advance)


# Tip errors. Batches of all sizes have the same ones: a lane of a batch equals the single arm, bit for bit.


@functools.cache
def _exact_tips() -> np.ndarray:
    return exact_tips(load_policy("computed-torque"), "nominal")


@functools.cache
def _own_tip_error() -> float:
    stepped = stepped_tips(load_policy("computed-torque"), "nominal", MAX_DEFAULT_SUBSTEP)
    return max_tip_difference(stepped, _exact_tips())


@functools.cache
def _torch_tip_error(device: str, dtype: str) -> float:
    torch_env, torch = _torch_modules(device)
    # Not compiled by torch, as that takes a minute for each number of lanes; tests compare both steps.
    arm = torch_env.TorchFuzzyArm(2, device=device, dtype=getattr(torch, dtype), compiled=False)
    policy, (observation, _) = load_policy("computed-torque"), arm.reset(seed=0)
    memory, stepped, ended = None, [], False
    while not ended:
        seen, begins = observation[0].double().cpu().numpy(), np.array([memory is None])
        torque, memory = policy.predict(seen, memory, begins, deterministic=True)
        observation, _, terminated, truncated, info = arm.step(observation.new_tensor(np.tile(torque, (2, 1))))
        stepped.append(info["tip"][0].double().cpu().numpy())
        ended = bool(terminated[0]) or bool(truncated[0])
    # After the last step the batch reports the beginning of the next episode.
    return max_tip_difference(np.array(stepped[:-1]), _exact_tips()[:-1])


@functools.cache
def _mujoco_tip_error(substeps: int) -> float:
    module = _mujoco_arm()
    method, timestep = module.FASTEST if substeps == 1 else module.EQUAL_ACCURACY["Coulomb"]
    return float(module.tip_error(module.MujocoArm(module.COULOMB, method, timestep).advance, module.COULOMB))
