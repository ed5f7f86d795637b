"""The features of a learned policy: functions of the observation and of a memory.

At the k-th action instant, with e = q_d - q_a, ė = q̇_d - q̇_a (motors) and the action a, in [-1, 1] for each joint,

    f_k = (s(e_k/E), s(ė_k/V), q_d, q̇_d/D, q̈_d/A, s(e_(k-1)/E), ..., s(e_(k-n)/E), a_(k-1), ..., a_(k-m), s(x_k/X))

with scales E, V, D, A, X and U, s(x) = asinh(x)/c, with a constant c, which compresses large errors, and the leaky
integral

    x_(k+1) = (x_k + T e_k) exp(-T/τ).

With an elastic target the errors are e = θ_d - q_a, ė = θ̇_d - q̇_a, where θ_d are the target angles of the unloaded
arm's motors (`fuzzy_policy.laws._elastic_target`), and f_k ends with the torques in excess of that arm's u_ff,

    (..., w_(k-1)/U, ..., w_(k-m)/U),    w_k = u_k - u_ff,k,

where u_k is the last torque commanded before instant k + 1. When an episode begins, all past errors, actions and excess
torques and the integral x are zero.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.known_arm import checked_arm, joints_of, per_joint_of
from fuzzyarm.fuzzy_policy.law import Law, constants_array, law_of, seen_by, within_limits
from fuzzyarm.fuzzy_policy.laws._elastic_target import Aim, ElasticTarget, past_of
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.network import area_sine
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import Cells, array, each, flat, maximum, minimum
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["FeatureLanes", "Features", "guided", "learning_action"]


class _Remembered(NamedTuple):
    """The memory of a lane's features; errors, actions and excess contain a tuple per instant, newest first."""

    errors: Any  # e [rad]
    actions: Any  # a
    integral: Any  # x [rad s]
    excess: Any  # w [N m]
    feedforward: Any  # u_ff [N m]
    target: Any  # memory of the elastic target


class Features:
    """The features of a definition, lane by lane; see the module's docstring for the equations."""

    def __init__(
        self, definition: FeatureDefinition, period: float, parameters: AnyArm | None = None, *, friction: bool = True
    ) -> None:
        """Set up the features for a definition, T [s] between two actions, and the arm (default Table 1).

        `friction` says whether u_ff includes the dry friction. TypeError or ValueError if the period is not a positive
        number, or the features are for another number of joints.
        """
        self.definition, self.period, d = definition, real("period", period, "s", above=0.0), definition
        arm: AnyArm = ArmParameters() if parameters is None else checked_arm("parameters", parameters)
        self.size, joints = d.size, joints_of(arm)
        if d.joints != joints:
            raise ValueError(f"the features are for {d.joints} joints, but the arm has {joints}")
        self._target = ElasticTarget(arm, period, friction=friction) if d.elastic_target else None
        nothing, elastic = (0.0,) * joints, self._target is not None
        self.memory = _Remembered(
            errors=(nothing,) * d.past_errors,
            actions=(nothing,) * d.past_actions,
            integral=nothing,
            excess=(nothing,) * d.past_excesses,
            feedforward=nothing if elastic else (),
            target=past_of(joints) if elastic else (),
        )
        self.memory_size = len(flat(self.memory))
        self._limit = tuple(map(float, per_joint_of(arm, "torque_limit")))
        self._leak = math.exp(-period / d.integral_time) if d.integral_time > 0.0 else 0.0

    def told(self, memory: _Remembered, seen: Observation) -> tuple[Any, Any, Aim]:
        """Return the elastic target's next memory, u_ff (n,) [N m], and the reference of the motors."""
        if self._target is None:
            return memory.target, memory.feedforward, Aim(*seen[2:])
        past, aim, feedforward = self._target.of(memory.target, seen, self._target.constants)
        return past, feedforward, aim

    def fill(self, memory: _Remembered, seen: Observation, aim: Aim, out: Any = None) -> Any:
        """Return the features in an array (size,), `out` or a new one, for the motors' reference `aim`."""
        d, out = self.definition, array(self.size) if out is None else out
        errors = [(q_d - q) / d.error_scale for q_d, q in zip(aim.q, seen.q_motor, strict=True)]
        rates = [(dq_d - dq) / d.rate_scale for dq_d, dq in zip(aim.dq, seen.dq_motor, strict=True)]
        at = _put(out, 0, [*errors, *rates], squashed=d.compression)
        asked = [*seen.q_reference, *(dq / d.velocity_scale for dq in seen.dq_reference)]
        at = _put(out, at, [*asked, *(ddq / d.acceleration_scale for ddq in seen.ddq_reference)])
        at = _put(out, at, [error / d.error_scale for error in flat(memory.errors)], squashed=d.compression)
        at = _put(out, at, flat(memory.actions))
        if d.integral_time > 0.0:
            at = _put(out, at, [x / d.integral_scale for x in memory.integral], squashed=d.compression)
        _put(out, at, [w / d.excess_scale for w in flat(memory.excess)])
        return out

    def advance(self, memory: _Remembered, seen: Observation, told: tuple[Any, Any, Aim], action: Any) -> _Remembered:
        """Return the next memory for an observation, the result of the method `told`, and an action (n,) in [-1, 1]."""
        past, feedforward, aim = told
        error = tuple(q_d - q for q_d, q in zip(aim.q, seen.q_motor, strict=True))
        integral = (self._leak * (x + self.period * e) for x, e in zip(memory.integral, error, strict=True))
        return _Remembered(
            errors=(error, *memory.errors[:-1]) if memory.errors else (),
            actions=(tuple(action), *memory.actions[:-1]) if memory.actions else (),
            integral=tuple(integral),
            excess=(*memory.excess[:1], *memory.excess[:-1]),
            feedforward=feedforward,
            target=past,
        )

    def command(self, memory: _Remembered, torque: Any) -> _Remembered:
        """Return the memory with `torque` (n,) [N m], clipped to its limits, less u_ff, as the newest excess torque."""
        if not memory.excess:
            return memory
        parts = zip(torque, self._limit, memory.feedforward, strict=True)
        newest = tuple(minimum(maximum(u, -most), most) - u_ff for u, most, u_ff in parts)
        return memory._replace(excess=(newest, *memory.excess[1:]))


def _put(out: Any, at: int, numbers: list[Any], *, squashed: float = 0.0) -> int:
    """Write numbers x, or asinh(x) / `squashed` if that is not 0, into `out` from index `at`; return the next index."""
    for k, number in enumerate(numbers):
        out[at + k] = number
    if squashed:
        for k in each(len(numbers)):
            out[k + at] = area_sine(out[k + at]) / squashed
    return at + len(numbers)


def guided(base: Policy | None, name: str | None = None, *, beside: bool = False) -> Law:
    """Return the law ``act(memory, seen, told, constants, *tables)`` that shifts a base policy's target by `told`.

    `told` (n,) is a scaled action: angles [rad], or without a base the torque [N m]. If `beside` is true, it is a
    torque added to the base's, and the target stays. ValueError if the base, called `name`, has no law.
    """
    if base is None:
        return Law(lambda memory, seen, told, given: (memory, told), (), ())
    law = law_of(base)
    if law is None:
        raise ValueError(
            f"the base {name} is of type {type(base).__name__}, which does not define its control law as a `Law`; "
            "allowed: a fuzzy policy or computed-torque, with or without the ending -tip, or elastic-observer"
        )
    command = within_limits(law, base.joints, base.integral_at)

    def act(memory: Any, seen: Observation, told: Any, given: Any, *tables: Any) -> tuple[Any, Any]:
        if beside:
            memory, torque = command(memory, seen, given, *tables)
            return memory, type(torque)(*(u + v for u, v in zip(torque, told, strict=True)))
        motors = type(seen.q_motor)(*(q - shift for q, shift in zip(seen.q_motor, told, strict=True)))
        return command(memory, seen._replace(q_motor=motors), given, *tables)

    return Law(act, law.memory, (law.constants, tuple(map(float, base.torque_limit))), law.tables)


class FeatureLanes:
    """The features of many lanes, and the law that turns their actions into torques, see `guided`."""

    def __init__(self, features: Features, base: Law) -> None:
        d = features.definition
        numbers = (0.0,) * d.joints

        def see(memory: _Remembered, seen: Observation, out: Any, _: Any) -> tuple[Any, ...]:
            features.fill(memory, seen, features.told(memory, seen)[2], out)
            return memory, seen, out

        def act(
            memory: _Remembered, held: Any, seen: Observation, action: Any, torque: Any, given: Any, *tables: Any
        ) -> tuple[Any, ...]:
            memory = features.advance(memory, seen, features.told(memory, seen), action)
            held, torque = base.act(held, seen, torque, given, *tables)
            return features.command(memory, torque), held, seen, action, tuple(torque)

        own, seen, self._base = features.memory, seen_by(d.joints), base
        self._see = Kernel(Program(see, (own, seen, Cells((features.size,)))))
        shapes = [table.shape for table in base.tables]
        self._act = Kernel(Program(act, (own, base.memory, seen, numbers, numbers), base.constants, shapes))
        self._size, self._given = features.size, constants_array(base)

    def see(self, observation: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Return the features (lanes, size) for observations (lanes, 5 n) and their `memory` (lanes, memory_size)."""
        out = np.empty((len(observation), self._size))
        self._see((memory, observation, out), np.empty(0))
        return out

    def act(
        self, observation: np.ndarray, action: np.ndarray, torque: np.ndarray, memory: np.ndarray, held: np.ndarray
    ) -> None:
        """Replace the scaled actions in `torque` (lanes, n) by torques [N m]; advance `memory` and the base's `held`.

        `action` (lanes, n) has these actions before scaling, for `memory`.
        """
        self._act((memory, held, observation, action, torque), self._given, self._base.tables)


_HOLD = 2e-3  # s; computed torque held for 2, 5 and 10 ms has errors of 1.7, 4.7 and 26 mm


def learning_action(arm: AnyArm) -> ActionDefinition:
    """Return the meaning of an action of ``FuzzyArmLearn-v0``: the torque Γ a, with limits Γ, held for 2 ms."""
    return ActionDefinition(tuple(per_joint_of(arm, "torque_limit").tolist()), _HOLD)
