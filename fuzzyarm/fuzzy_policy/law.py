"""A law as one function of numbers, and the policy that runs it as machine code.

    act(memory, seen, constants, *tables) -> (memory, torque)

`memory` is a tree (nested tuples) of numbers, all zero when an episode begins; each part of `seen`, an `Observation`,
is a record with one number per joint; `constants` is a tree of floats; rows of a table are read by
`numbers.functions.row`. Torques are not clipped. `act` also runs on floats; machine code and C are generated from a
recording of its operations.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import all_finite
from fuzzyarm.envs.observation import PARTS, Observation
from fuzzyarm.envs.physics.records import per_joint
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import flat, like, maximum, minimum, select
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["Law", "LawPolicy", "constants_array", "held_at_limits", "law_of", "seen_by", "within", "within_limits"]


class Law(NamedTuple):
    """A control law: the function `act`, and its arguments besides an observation."""

    act: Callable[..., tuple[Any, Any]]  # see the module's docstring
    memory: Any  # a tree of zeros
    constants: Any  # a tree of floats
    tables: tuple[np.ndarray, ...] = ()  # arrays (rows, columns)
    # whether `act` has an argument ``admit``: a function that returns the applied torques for the requested torques
    told: bool = False


def seen_by(joints: int) -> Observation:
    """Return an observation of zeros, in which each part is a record of `joints` numbers."""
    return Observation(*[per_joint(joints)(*[0.0] * joints)] * PARTS)


def within(torque: Any, limit: Any) -> Any:
    """Return torques clipped to ±`limit` [N m], joint by joint."""
    return type(torque)(*(minimum(maximum(u, -most), most) for u, most in zip(torque, limit, strict=True)))


def within_limits(law: Law, joints: int, integral_at: int | None) -> Callable[..., tuple[Any, Any]]:
    """Return ``command(memory, seen, (constants, limit), *tables)``: the law, with torques clipped to ±`limit` [N m].

    Integrals in the memory, from index `integral_at` on (None: none), are held as by `held_at_limits`.
    """

    def command(memory: Any, seen: Any, given: Any, *tables: Any) -> tuple[Any, Any]:
        constants, limit = given
        after, torque = law.act(memory, seen, constants, *tables)
        torque = type(seen.q_motor)(*torque)
        if integral_at is not None:
            after = held_at_limits(memory, after, integral_at, torque, [(-most, most) for most in limit])
        return after, within(torque, limit)

    return command


def held_at_limits(memory: Any, after: Any, integral_at: int, asked: Any, limits: Any) -> Any:
    """Return `after`, the memory after a sample, but hold integrals that would drive torques further beyond limits.

    With u = `asked`, the integral at `integral_at` + j is held if it falls at u_j > high_j or rises at u_j < low_j.
    """
    before, numbers = flat(memory), flat(after)
    for joint, (torque, (low, high)) in enumerate(zip(asked, limits, strict=True)):
        at = integral_at + joint
        change = numbers[at] - before[at]
        further = ((torque > high) & (change < 0.0)) | ((torque < low) & (change > 0.0))
        numbers[at] = select(further, before[at], numbers[at])
    return like(after, iter(numbers))


def constants_array(law: Law, *others: Any) -> np.ndarray:
    """Return the constants of a law, then `others`, as the array (k,) for its machine code."""
    return np.array([*flat(law.constants), *flat(others)], dtype=np.float64)


class LawPolicy(Policy):
    """A policy whose torques are those of a `Law`, which runs as machine code."""

    @functools.cached_property
    def control_law(self) -> Law:
        """The control law of this policy."""
        raise NotImplementedError

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy.act`."""
        self._act_kernel((memory, observation, torque), self._constants, self.control_law.tables)

    def command(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> bool:
        """Fill `torque`, clipped to its limits; return False if a torque is not a number, see `Policy.command`."""
        if not self._lawful:
            return super().command(observation, memory, torque)
        alone = self._alone
        double = memory.dtype is torque.dtype is _DOUBLE
        if double and (memory.shape, observation.shape, torque.shape) == alone.shapes:
            alone.run(memory, observation, torque)
        else:
            self._command_kernel((memory, observation, torque), self._limited_constants, self.control_law.tables)
        return all_finite(torque)

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without cached properties, which are recomputed when needed."""
        parts = [part for kind in type(self).__mro__ if issubclass(kind, LawPolicy) for part in vars(kind).items()]
        made = {name for name, part in parts if isinstance(part, functools.cached_property)}
        return {name: value for name, value in super().__getstate__().items() if name not in made}

    @functools.cached_property
    def _lawful(self) -> bool:
        return law_of(self) is not None

    @functools.cached_property
    def _act_kernel(self) -> Kernel:
        return self._kernel(self.control_law.act, self.control_law.constants)

    @functools.cached_property
    def _command_kernel(self) -> Kernel:
        command = within_limits(self.control_law, self.joints, self.integral_at)
        return self._kernel(command, (self.control_law.constants, (0.0,) * self.joints))

    @functools.cached_property
    def _alone(self) -> _Alone:
        return _Alone(self._command_kernel, self._limited_constants, self.control_law.tables)

    def _kernel(self, function: Callable[..., tuple[Any, Any]], constants: Any) -> Kernel:
        def step(memory: Any, seen: Any, _: Any, given: Any, *tables: Any) -> tuple[Any, Any, Any]:
            after, torque = function(memory, seen, given, *tables)
            return after, seen, tuple(torque)

        ports = (self.control_law.memory, seen_by(self.joints), (0.0,) * self.joints)
        return Kernel(Program(step, ports, constants, [table.shape for table in self.control_law.tables]))

    @functools.cached_property
    def _constants(self) -> np.ndarray:
        return constants_array(self.control_law)

    @functools.cached_property
    def _limited_constants(self) -> np.ndarray:
        return constants_array(self.control_law, tuple(map(float, self.torque_limit)))


class _Alone:
    """A compiled law for one arm, run on arrays of its own per thread: copying is faster than passing the caller's."""

    def __init__(self, kernel: Kernel, constants: np.ndarray, tables: Sequence[np.ndarray]) -> None:
        self.shapes = tuple((1, numbers) for numbers in kernel.program.ports)  # of memory, observation and torque
        self._kernel, self._rest, self._own = kernel, (constants, tables), threading.local()

    def run(self, memory: np.ndarray, observation: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law for float64 arrays (1, size): fill `torque` and advance `memory`."""
        try:
            remembered, seen, given, call = self._own.arrays
        except AttributeError:
            remembered, seen, given = (np.empty(shape) for shape in self.shapes)
            call = self._kernel.bound((remembered, seen, given), *self._rest)
            self._own.arrays = remembered, seen, given, call
        remembered[...], seen[...] = memory, observation
        call()
        memory[...], torque[...] = remembered, given


_DOUBLE = np.dtype(np.float64)
_ACTING = {"predict", "command", "act"}


def law_of(policy: Policy) -> Law | None:
    """Return the law of a policy; None if there is no law, or if a subclass overrides `act`, `command` or `predict`."""
    for kind in type(policy).__mro__:
        if kind is LawPolicy or "control_law" in vars(kind):
            return policy.control_law if isinstance(policy, LawPolicy) else None
        if _ACTING & vars(kind).keys():
            return None
    return None
