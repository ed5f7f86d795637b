"""A policy from code of one's own, named ``package.module:factory``.

The module is imported, which runs it, and the factory is called. That happens only where the user has given the name,
as `--policy` on the command line: `fuzzyarm.load_policy`, which is also given names that stand in files, refuses them.

The factory may take ``control_period``, the time between two calls of `predict` [s], and ``robot``, the arm the policy
is for (`ArmParameters`); whichever of the two it names is passed by name. It returns any object with

    action, state = predict(observation, state=..., episode_start=..., deterministic=True)

as in `Policy.predict`: ``observation`` (10,) as `FuzzyArmEnv` gives it, ``action`` (2,) motor torques [N m],
``state`` whatever the policy wants back at the next call, None when an episode begins. What it remembers elsewhere it
has to forget by itself where ``episode_start`` is true.

`fuzzyarm evaluate` needs no more than that. Tools that run many arms at once give (lanes, 10) and need (lanes, 2) back,
with a state that has one entry per lane; `fuzzyarm margins` moreover double precision and a state that is None or an
array (lanes, m). Two attributes are heeded if there: ``action_period`` [s], for which an action is held, and
``without_dry_friction()``, see `fuzzyarm.eval.stability.linearisation`.
"""

from __future__ import annotations

import importlib
import inspect
import operator
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.registry import is_code, load_policy

_PASSED_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_HEEDED = ("action_period", "without_dry_friction")


def find_policy(name: str, *, control_period: float = 1e-3, robot: ArmParameters | None = None) -> Policy | UserPolicy:
    """Return what the user calls by `--policy`: a policy as `load_policy` knows it, or one of their own code.

    Args:
        name: of `load_policy`, or ``package.module:factory``, whose module is imported; the current folder counts as
            one to import from, as with ``python -m``.
        control_period: time between two calls of `predict` [s].
        robot: the arm the policy is for, default Table 1.

    Raises:
        ValueError: as `load_policy`; or the module is not found or fails, there is no such factory in it, the factory
            fails, or what it returns has no `predict`.
        OSError: a file cannot be read.
    """
    if not is_code(name):
        return load_policy(name, control_period=control_period, robot=robot)
    module = imported(name)
    attribute = name.partition(":")[2]
    try:
        factory = operator.attrgetter(attribute)(module)
    except AttributeError:
        raise ValueError(f"{name}: module {module.__name__} ({module.__file__}) has no {attribute}") from None
    if not callable(factory):
        raise ValueError(f"{name} is {type(factory).__name__}; needed: a function or class that returns a policy")
    try:
        policy = factory(**_taken(factory, {"control_period": control_period, "robot": robot or ArmParameters()}))
    except Exception as error:
        raise ValueError(f"{name}: the factory failed: {_told(error)}") from error
    if not callable(getattr(policy, "predict", None)):
        raise ValueError(f"{name} returned {type(policy).__name__} without a method predict; needed: a policy")
    return UserPolicy(name, policy, control_period)


def imported(name: str) -> ModuleType:
    """Import the module of ``package.module:factory`` and return it.

    Raises:
        ValueError: it is not found, or fails when it is run.
    """
    module = name.partition(":")[0]
    here = os.getcwd()
    if here not in sys.path:  # an installed command has its own folder there instead
        sys.path.insert(0, here)
    try:
        return importlib.import_module(module)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            raise ValueError(f"{name}: {error}; looked for in {here} and among the installed packages") from None
        raise ValueError(f"{name}: importing {module} failed: {_told(error)}") from error


class UserPolicy:
    """An object with `predict` at work: what it does wrong becomes an error that names it.

    Attributes:
        name: ``package.module:factory``.
        control_period: [s].
    """

    def __init__(self, name: str, policy: Any, control_period: float) -> None:
        """Keep the object."""
        self.name, self.control_period, self._policy = name, control_period, policy
        for heeded in _HEEDED:
            if hasattr(policy, heeded):
                setattr(self, heeded, getattr(policy, heeded))

    def certificate(self, reference: JointReference) -> None:
        """Return None: nothing is proven of code of one's own."""
        return

    def predict(
        self,
        observation: np.ndarray,
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Return the action and the next state.

        Raises:
            ValueError: `predict` failed, or returned no action of this shape; whether the numbers are finite is for the
                environment to see.
        """
        try:
            action, after = self._policy.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
            torque = np.asarray(action)
        except Exception as error:
            raise ValueError(f"{self.name}: predict failed, or returned no (action, state): {_told(error)}") from error
        needed = (*observation.shape[:-1], 2)
        if torque.shape != needed:
            raise ValueError(
                f"{self.name}: predict returned an action of shape {torque.shape} for observations of shape "
                f"{observation.shape}; needed: {needed}, the motor torques [N m]"
            )
        return torque, after


def _taken(factory: Any, offered: dict[str, Any]) -> dict[str, Any]:
    """Return those arguments that a factory takes by name."""
    try:
        parameters = inspect.signature(factory).parameters
    except ValueError:  # built in, without a signature
        return {}
    if any(parameter.kind == inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return offered
    return {k: v for k, v in offered.items() if k in parameters and parameters[k].kind in _PASSED_BY_NAME}


def _told(error: BaseException) -> str:
    """Return an error as the last line of its traceback, and where it was raised."""
    last = traceback.format_exception_only(error)[-1].strip()
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last} ({Path(place.filename).name}, line {place.lineno})"
