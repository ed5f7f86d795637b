"""The peers of the speed table: Gymnasium's and EnvPool's nearest environments, and the same arm in MuJoCo."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import fuzzyarm
from fuzzyarm.eval.bench.entries import Entry, Measure, NotMeasured, draw_actions, single_environment, timed_batch

__all__ = ["MUJOCO_ARM", "MUJOCO_METHODS", "batch_peers", "gymnasium_peers"]

MUJOCO_ARM = Path(fuzzyarm.__file__).parents[1] / "benchmarks" / "mujoco_arm.py"
"""The arm in MuJoCo. A clone of the repository has it, an installed package does not."""

MUJOCO_METHODS = {"MuJoCo arm": ("Euler", True, 30), "MuJoCo arm, 1 ms": ("Euler", False, 1)}
"""By heading: integrator, whether positions are read half a step back, and sub-steps.

The fastest method whose tip error is no larger than ours, and the fastest of all; `benchmarks/mujoco_arm.py` chose
them, where they are EQUAL_ACCURACY and FASTEST.
"""


def gymnasium_peers() -> list[Entry]:
    """Return the peers of one environment."""

    def peer(heading: str, name: str, substeps: int) -> Entry:
        opened = functools.partial(single_environment, name, 1.0)
        return Entry(f"Gymnasium {name}", 1, 1, substeps, "float64", opened, heading, extra="bench")

    return [peer("Pendulum", "Pendulum-v1", 1), peer("Reacher", "Reacher-v5", 2)]


def batch_peers(lanes: int, threads: int) -> list[Entry]:
    """Return the peers of a batch."""

    def envpool(heading: str, name: str) -> Entry:
        opened = functools.partial(_envpool, name, lanes, threads)
        return Entry(f"EnvPool {name}", lanes, threads, 1, "float64", opened, heading, extra="bench")

    def mujoco(heading: str) -> Entry:
        *_, substeps = MUJOCO_METHODS[heading]
        name = f"same arm in MuJoCo, 1{f'/{substeps}' if substeps > 1 else ''} ms"
        opened, tip_error = functools.partial(_mujoco, heading, lanes, threads), MUJOCO_TIP_ERRORS[heading]
        return Entry(name, lanes, threads, substeps, "float64", opened, heading, tip_error, "bench")

    pools = [envpool("Pendulum", "Pendulum-v1"), envpool("Reacher", "ReacherEasy-v1")]
    return [*pools, *map(mujoco, MUJOCO_METHODS)]


@contextlib.contextmanager
def _envpool(name: str, lanes: int, threads: int) -> Iterator[Measure]:
    import envpool

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium's, on the precision of EnvPool's spaces
        envs = envpool.make_gymnasium(name, num_envs=lanes, num_threads=threads, seed=0)
        envs.reset()
        actions = draw_actions(envs.action_space, 4, (lanes,))
    try:
        yield timed_batch(envs.step, actions, lanes)
    finally:
        envs.close()


@contextlib.contextmanager
def _mujoco(heading: str, lanes: int, threads: int) -> Iterator[Measure]:
    integrator, _, substeps = MUJOCO_METHODS[heading]
    yield functools.partial(_mujoco_arm().steps_per_second, lanes, threads, 1e-3 / substeps, integrator)


def _mujoco_tip_error(heading: str) -> float:
    integrator, half_step_back, substeps = MUJOCO_METHODS[heading]
    module = _mujoco_arm()
    arm = module.MujocoArm(module.COULOMB, module.Method(integrator, half_step_back), 1e-3 / substeps)
    error: float = module.tip_error(arm.advance, module.COULOMB)
    return error


MUJOCO_TIP_ERRORS = {heading: functools.partial(_mujoco_tip_error, heading) for heading in MUJOCO_METHODS}
"""By heading. Batches of all sizes share one function, so that the error is computed once."""


@functools.cache
def _mujoco_arm() -> ModuleType:
    """Import the benchmark that holds the model."""
    if not MUJOCO_ARM.exists():
        raise NotMeasured("benchmarks/mujoco_arm.py is not there: run from a clone of the repository")
    spec = importlib.util.spec_from_file_location(MUJOCO_ARM.stem, MUJOCO_ARM)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
