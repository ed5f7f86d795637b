"""A policy from the user's own code, named ``package.module:factory``.

The module is imported, which runs its code, and the factory is called. That happens only for a name given by the user,
as `--policy` on the command line; `fuzzyarm.load_policy`, which also accepts names from files, refuses such a name.

The factory may have parameters ``control_period``, the time between two calls of `predict` [s], and ``robot``, the arm
of the policy (`ArmParameters`); they are passed by name. The factory must return an object with

    action, state = predict(observation, state=..., episode_start=..., deterministic=True)

as in `Policy.predict`: ``observation`` (10,) from `FuzzyArmEnv`, ``action`` (2,) motor torques [N m], ``state``
anything that the policy needs at the next call, None when an episode begins. A policy that stores its memory elsewhere
must reset it when ``episode_start`` is true.

Tools that run many arms at once, unlike `fuzzyarm evaluate`, pass observations (lanes, 10) and need actions (lanes, 2)
and a state with one entry per lane; `fuzzyarm margins` also needs double precision and a state that is None
or an array (lanes, m). Optional attributes are:

    action_period              time for which an action is held [s]
    without_dry_friction()     the policy for an arm without dry friction, see `fuzzyarm.eval.stability._linearisation`
    repeated()                 the policy for passes over one path (``--passes``), or None: an object with `predict` and
                               ``begin_pass(state)``, which takes the last state of a pass and returns the first state
                               of the next pass, see `fuzzyarm.fuzzy_policy.policy.PassLearner`
    beliefs(state)             the policy's estimates of the load, see `fuzzyarm.eval.episodes._beliefs`
    declared                   a mapping, or an object with attributes: ``objective``, ``tuned_on``, ``knows``, ``sees``
                               and ``remembers``, each a one-line string, see `Declared`
"""

from __future__ import annotations

import importlib
import inspect
import operator
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.declared import Declared, stated
from fuzzyarm.policies.registry import foreign

__all__ = ["UserPolicy", "load_code", "source_file"]


def load_code(
    name: str, control_period: float, robot: AnyArm, action: ActionDefinition | None = None
) -> Policy | UserPolicy:
    """Return the policy of ``package.module:factory``, or of a model of another library (`registry.FOREIGN`).

    The actions of such a model are those of ``FuzzyArmLearn-v0``, unless `action` defines others.

    The current folder is also searched, as with ``python -m``. ValueError if the module is not found, fails or has no
    such factory, if the factory fails, or if its result has no `predict` or a wrong `declared`.
    """
    if prefix := foreign(name):
        path = Path(name.removeprefix(prefix))
        if prefix == "onnx:":
            from fuzzyarm.policies._onnx_model import OnnxPolicy

            return OnnxPolicy(path, robot, control_period, action)
        from fuzzyarm.policies._sb3 import sb3_policy

        return sb3_policy(path, robot, control_period, action)
    module = _imported(name)
    attribute = name.partition(":")[2]
    try:
        factory = operator.attrgetter(attribute)(module)
    except AttributeError:
        raise ValueError(f"{name}: module {module.__name__} ({module.__file__}) has no {attribute}") from None
    if not callable(factory):
        raise ValueError(
            f"{name} is of type {type(factory).__name__}; needed: a function or class that returns a policy"
        )
    try:
        policy = factory(**_accepted(factory, {"control_period": control_period, "robot": robot}))
    except Exception as error:
        raise ValueError(f"{name}: the factory failed: {_described(error)}") from error
    if not callable(getattr(policy, "predict", None)):
        raise ValueError(
            f"{name} returned an object of type {type(policy).__name__}; needed: a policy with a method predict"
        )
    loaded = UserPolicy(name, policy, control_period)
    _ = loaded.declared  # a wrong declaration is refused before anything runs
    return loaded


def source_file(name: str) -> Path | None:
    """Return the file of another library's model, or the module's source file for ``package.module:factory``.

    The module is imported to find its source; ValueError if the import fails.
    """
    if prefix := foreign(name):
        return Path(name.removeprefix(prefix))
    source = _imported(name).__file__
    return None if source is None else Path(source)


def _imported(name: str) -> ModuleType:
    module = name.partition(":")[0]
    here = os.getcwd()
    if here not in sys.path:  # for an installed command, the path begins with the folder of the command
        sys.path.insert(0, here)
    try:
        return importlib.import_module(module)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            raise ValueError(f"{name}: {error}; this module is neither in {here} nor installed") from None
        raise ValueError(f"{name}: importing {module} failed: {_described(error)}") from error


class UserPolicy:
    """A wrapper of the user's object; if the object fails, the error names the object."""

    def __init__(self, name: str, policy: Any, control_period: float) -> None:
        self.name, self.control_period, self._policy = name, control_period, policy

    @property
    def action_period(self) -> float:
        """Time for which an action is held [s]: the object's value if it states one, else the control period."""
        return float(getattr(self._policy, "action_period", self.control_period))

    def without_dry_friction(self) -> UserPolicy:
        """Return this policy for an arm without dry friction; this policy if the object has no such method."""
        method = getattr(self._policy, "without_dry_friction", None)
        return self if method is None else UserPolicy(self.name, method(), self.control_period)

    @property
    def declared(self) -> Declared | None:
        """The declaration of the object, None without a declaration; ValueError if a field is wrong."""
        given = getattr(self._policy, "declared", None)
        try:
            return None if given is None else stated(given)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    @property
    def beliefs(self) -> Callable[[Any], Any] | None:
        """The object's method ``beliefs(state)``; None if there is no such method."""
        return self._believed if callable(getattr(self._policy, "beliefs", None)) else None

    def repeated(self) -> UserPolicy | None:
        """Return the object's policy for passes over one path, or None; ValueError if its method `repeated` fails."""
        found = self._called("repeated") if hasattr(self._policy, "repeated") else None
        if found is None:
            return None
        for needed in ("predict", "begin_pass"):
            if not callable(getattr(found, needed, None)):
                raise ValueError(
                    f"{self.name}: repeated() returned an object of type {type(found).__name__}, which has no method "
                    f"{needed}"
                )
        return UserPolicy(self.name, found, self.control_period)

    def begin_pass(self, state: Any) -> Any:
        """Return the first state of the next pass, given the last of this one; ValueError if the policy fails."""
        return self._called("begin_pass", state)

    def _believed(self, state: Any) -> Any:
        found = self._called("beliefs", state)
        names = ("force", "force_deviation", "payload", "payload_deviation")
        if missing := [name for name in names if not hasattr(found, name)]:
            raise ValueError(
                f"{self.name}: beliefs() returned an object of type {type(found).__name__}, which lacks "
                f"{', '.join(missing)}"
            )
        return found

    def _called(self, method: str, *arguments: Any) -> Any:
        """Return the result of a method of the user's policy; a ValueError names the method if the call fails."""
        try:
            return getattr(self._policy, method)(*arguments)
        except Exception as error:
            raise ValueError(f"{self.name}: {method} failed: {_described(error)}") from error

    def predict(
        self,
        observation: np.ndarray,
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Return the action and the next state; ValueError if `predict` failed or the action has another shape."""
        try:
            action, after = self._policy.predict(
                observation, state=state, episode_start=episode_start, deterministic=deterministic
            )
            torque = np.asarray(action)
        except Exception as error:
            failed = f"{self.name}: predict failed, or did not return (action, state)"
            raise ValueError(f"{failed}: {_described(error)}") from error
        needed = (*observation.shape[:-1], JOINTS)
        if torque.shape != needed:
            raise ValueError(
                f"{self.name}: predict returned an action of shape {torque.shape} for observations of shape "
                f"{observation.shape}; needed: motor torques [N m] of shape {needed}"
            )
        if torque.dtype.kind not in "fiuO":  # the environment checks objects one by one
            raise ValueError(
                f"{self.name}: predict returned an action of type {torque.dtype}; the motor torques [N m] must be "
                "two real numbers"
            )
        return torque, after


def _accepted(factory: Any, offered: dict[str, Any]) -> dict[str, Any]:
    """Return the offered arguments for which a factory has parameters."""
    try:
        parameters = inspect.signature(factory).parameters.values()
    except ValueError:  # a built-in without a signature
        return {}
    if any(one.kind == one.VAR_KEYWORD for one in parameters):
        return offered
    by_name = {one.name for one in parameters if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)}
    return {name: value for name, value in offered.items() if name in by_name}


def _described(error: BaseException) -> str:
    """Return an error as the last line of its traceback, and where it was raised."""
    last = traceback.format_exception_only(error)[-1].strip()
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last} ({Path(place.filename).name}, line {place.lineno})"
