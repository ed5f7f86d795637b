"""The learning algorithms by name: the `SPEC` of each module in this folder, and those added by `add_algorithm`."""

import importlib
import pkgutil
from collections.abc import Iterator

from fuzzyarm.common.registry import Registry
from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec
from fuzzyarm.rl_baselines.config import TrainingConfig

__all__ = ["ALGORITHMS", "add_algorithm", "algorithm_of", "find_algorithm"]


def _shipped() -> Iterator[AlgorithmSpec]:
    """Yield the `SPEC` of every module of this folder, in the order of their names."""
    for module in pkgutil.iter_modules(__path__):
        yield importlib.import_module(f"{__name__}.{module.name}").SPEC


ALGORITHMS = Registry[AlgorithmSpec](__name__, {spec.name: spec for spec in _shipped()})
"""All known algorithms by name."""


def add_algorithm(spec: AlgorithmSpec) -> None:
    """Register an algorithm; ValueError if its name or its class of settings is already registered."""
    if spec.name in ALGORITHMS:
        raise ValueError(f"algorithm {spec.name!r} already exists; choose another name")
    for other in ALGORITHMS.values():
        if other.config is spec.config:
            raise ValueError(f"{spec.config.__name__} belongs to {other.name!r}; give a subclass of it as config")
    ALGORITHMS[spec.name] = spec


def find_algorithm(name: str) -> AlgorithmSpec:
    """Return the algorithm called `name`; ValueError names the choices."""
    if name not in ALGORITHMS:
        raise ValueError(f"unknown algorithm {name!r}; choose from: {', '.join(ALGORITHMS)}")
    return ALGORITHMS[name]


def algorithm_of(config: TrainingConfig) -> AlgorithmSpec:
    """Return the algorithm that is configured by the class of `config`; ValueError if there is no such algorithm."""
    for spec in ALGORITHMS.values():
        if type(config) is spec.config:
            return spec
    raise ValueError(f"{type(config).__name__} is not the configuration of a known algorithm; call add_algorithm first")
