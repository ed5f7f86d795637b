"""Stability margins: how far a policy is from instability on the sampled elastic arm, by linearising the closed loop.

At a posture of the path the reference is held fixed and dry friction is removed; viscous friction remains. The
equilibrium is found by Newton's method.

The plant may carry a payload unknown to the policy. A policy with a model of dry friction, such as an observer, is
linearised without that model.

The result is local. It compares policies and proves nothing about the moving arm.

With the deviations x of the plant's states [rad, rad/s], s of the policy's memory and u of the torques [N m], one
control period is

    x⁺ = A x + B u_(k-d),    u = κ (D x + C s),    s⁺ = G x + F s,

where κ is a factor on the loop gain and d are extra samples of delay (0: the torque computed from the sample at t_k
acts from t_k). If d = m + 1/2 with a whole m, the torque changes in the middle of the period; with the map A_h, B_h of
half a period

    x⁺ = A_h (A_h x + B_h u_(k-m-1)) + B_h u_(k-m).

The spectral radius of the matrix of (x, s, u_(k-1), u_(k-2), ...), with ⌈d⌉ torques, is below 1 if and only if small
deviations decay.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from fuzzyarm.common.arithmetic import last_that_works
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.observation import PARTS, starts
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.integrator import force_line, hold_of
from fuzzyarm.envs.physics.records import columns, flat, size
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, without_dry_friction
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = [
    "GAIN_SPAN", "POSTURES", "GainLimits", "Linearisable", "LocalLoop", "gain_limits", "largest_radius", "linearise_at",
    "linearise_path", "remark_on",
]  # fmt: skip


GAIN_SPAN = 100.0
"""The search for a gain margin goes from κ = 1 up to this factor and down to its inverse."""
_GAIN_RATIO = 1.1  # ratio of successive factors in this search
_GAIN_TOLERANCE = 1e-4  # of a gain margin, relative
_LONG = 0.01  # share of the steps with a motor at its limit, above which there is a remark
_GROWTH = 1e-6  # tolerance of a spectral radius above 1: a memory that keeps its value has eigenvalue 1


class GainLimits(NamedTuple):
    """Factors on the loop gain, around 1, between which a loop is stable; both nan if unstable at the factor 1."""

    lower: float  # 0 where there is no limit within `GAIN_SPAN`
    upper: float  # inf where there is no limit within `GAIN_SPAN`


@dataclasses.dataclass(frozen=True)
class LocalLoop:
    """The loop of the module's equation at one posture, with n plant states, r torques and m entries of memory.

    Memory that the torque never reads is left out: an integral without a gain would add the eigenvalue 1.
    """

    plant: np.ndarray  # [A B], (n, n + r)
    half_plant: np.ndarray  # [A_h B_h], (n, n + r)
    law: np.ndarray  # [D C; G F], (r + m, n + m)
    equilibrium: np.ndarray  # plant state and whole memory, (n + m or more,)
    torque: np.ndarray  # at the equilibrium [N m], (r,)

    def matrix(self, loop_gain: float = 1.0, delay: float = 0.0) -> np.ndarray:
        """Return the map (N, N) over one period of n plant states, m memory entries and ⌈delay⌉ past torques (r,).

        `loop_gain` [1] is a factor on the torques, and `delay` [samples] is a multiple of 0.5.
        """
        n, columns = len(self.plant), self.law.shape[1]
        inputs = self.plant.shape[1] - n
        unit = np.eye(columns + math.ceil(delay) * inputs)
        law = self.law @ unit[:columns]
        torques = np.vstack([loop_gain * law[:inputs], unit[columns:]])  # newest first, the last one acts
        moved = unit[:n]
        if float(delay).is_integer():
            moved = self.plant @ np.vstack([moved, torques[-inputs:]])
        else:  # the last one for half a period, then the one before
            moved = self.half_plant @ np.vstack([moved, torques[-inputs:]])
            moved = self.half_plant @ np.vstack([moved, torques[-2 * inputs : -inputs]])
        return np.vstack([moved, law[inputs:], torques[:-inputs]])


def largest_radius(loops: Sequence[LocalLoop], loop_gain: float = 1.0, delay: float = 0.0) -> float:
    """Return the largest spectral radius of the loops, for a factor `loop_gain` [1] and an extra delay [samples]."""
    # One by one: where a learned law saturates, less of its memory is read, and the matrix is smaller.
    return max(float(np.abs(np.linalg.eigvals(loop.matrix(loop_gain, delay))).max()) for loop in loops)


def gain_limits(loops: Sequence[LocalLoop], delay: float = 0.0) -> GainLimits:
    """Return the factors on the gain of all motors between which every loop is stable, for an extra delay [samples]."""

    def stable(loop_gain: float) -> bool:
        return largest_radius(loops, loop_gain, delay) < 1.0

    if not stable(1.0):
        return GainLimits(math.nan, math.nan)
    search = partial(last_that_works, stable, 1.0, resolution=_GAIN_TOLERANCE)
    lower = search(1.0 / _GAIN_RATIO, limit=1.0 / GAIN_SPAN)
    upper = search(_GAIN_RATIO, limit=GAIN_SPAN)
    return GainLimits(0.0 if lower is None else lower, math.inf if upper is None else upper)


POSTURES = 16
"""Number of instants, evenly spaced over the arm's default reference; 300 instants of the paper's reference
change a gain margin by 0.2 %."""
_PLANT_STEP = 1e-6  # rad and rad/s, of the central differences
# Step of the law's differences, relative to max(1, |s|) for its memory: an integral can move the torque by 5e8 N m per
# rad s, and a network may bend within 1e-6 rad. A measured angle and its remembered value have the same step, so that
# their differences stay exact.
_LAW_STEP = 1e-8
_TORQUE_STEP = 1.0  # N m; the plant is linear in the torque
_NEWTON_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)  # of a step
_NEWTON_STEPS, _NEWTON_TOLERANCE = 40, 1e-9  # the tolerance: change of a state [rad, rad/s] over one period
_SETTLING = 300  # control periods
_RESTING = 2000  # control periods, after which a strongly nonlinear law is near its equilibrium
_NEWTON_REACH = 0.1  # rad; an equilibrium farther from the posture belongs to another posture


class Linearisable(Predictor, Protocol):
    """An object that can be linearised: a `Policy`, or any other with `predict` and `without_dry_friction`."""

    def without_dry_friction(self) -> Predictor:
        """Return the policy for an arm without dry friction."""
        ...


def linearise_path(
    policy: Linearisable, parameters: AnyArm, control_period: float, payload: Payload | None = None
) -> list[LocalLoop]:
    """Return the loops of a policy at `POSTURES` instants of the default reference of the arm `parameters`.

    The policy's `predict` must accept batches. The plant carries `payload`, by default nothing; the control period is
    in s.

    Raises:
        TypeError: the policy's state is neither an array nor None, or its torque is not in double precision.
        ValueError: the policy has no equilibrium within the torque limits.
    """
    reference = default_reference(parameters)
    postures = reference.sample(np.linspace(0.0, reference.duration, POSTURES)).q
    smooth = policy.without_dry_friction()  # once for all postures: it may design an observer again
    arms = (_FrozenArm(smooth, parameters, posture, control_period, payload) for posture in postures)
    return [_linearise(arm, posture) for arm, posture in zip(arms, postures, strict=True)]


def linearise_at(
    policy: Linearisable,
    parameters: AnyArm,
    posture: np.ndarray,
    control_period: float,
    payload: Payload | None = None,
) -> tuple[LocalLoop, np.ndarray]:
    """Return the loop at one posture (r,) [rad], and the law's derivative (r + m, r) w.r.t. the reference angles.

    The memory has m entries. The other arguments and the errors are those of `linearise_path`.
    """
    arm = _FrozenArm(policy.without_dry_friction(), parameters, posture, control_period, payload)
    loop = _linearise(arm, posture)
    _, kept = arm.linearise(loop.equilibrium)
    by_reference = _differences(partial(arm.act_after, loop.equilibrium), np.zeros(arm.joints), np.array([_LAW_STEP]))
    rows = np.append(np.ones(arm.joints, dtype=bool), kept[arm.memory])
    return loop, by_reference[rows]


def _linearise(arm: _FrozenArm, posture: np.ndarray) -> LocalLoop:
    first = arm.start()
    loop = _equilibrium(arm, first, posture) or _equilibrium(arm, arm.settled(first, _RESTING), posture)
    if loop is None:
        raise ValueError(
            f"no equilibrium within {_NEWTON_REACH} rad of posture {posture} rad: torques may be clipped, or the "
            "policy may not come to rest there"
        )
    # The torque must stay below its limits within the steps of the differences as well: a clipped torque has no slope.
    slope = np.abs(loop.law[arm.torque, arm.plant]).max(axis=1)
    if np.any(np.abs(loop.torque) + _PLANT_STEP * slope >= arm.limit):
        limit = tuple(arm.limit.tolist())
        raise ValueError(
            f"posture {posture} rad needs the torques {loop.torque} N m, which are too near the torque limits {limit} "
            "N m: at a limit, the loop cannot be linearised"
        )
    return loop


def _equilibrium(arm: _FrozenArm, point: np.ndarray, posture: np.ndarray) -> LocalLoop | None:
    """Return the loop at the equilibrium near `posture` that Newton's method finds from a point; None if it fails."""
    for _ in range(_NEWTON_STEPS):
        loop, kept = arm.linearise(point)
        if not np.isfinite(loop.law).all():
            raise ValueError(f"the policy fails near posture {posture} rad: its torque or memory is not finite")
        matrix, change = loop.matrix(), (arm.advance(point) - point)[kept]
        if not (np.isfinite(matrix).all() and np.isfinite(change).all()):
            raise ValueError(
                f"the numbers overflow at posture {posture} rad: a joint may be too stiff, too damped or too light"
            )
        near = np.all(np.abs(point[arm.q_motor] - posture) <= _NEWTON_REACH)
        if np.all(np.abs(change) <= _NEWTON_TOLERANCE) and near:
            return dataclasses.replace(loop, half_plant=arm.plant_over(0.5 * arm.period, point, loop.torque))
        point = _nearer(arm, point, kept, np.linalg.lstsq(np.eye(len(change)) - matrix, change)[0])
    return None


def _nearer(arm: _FrozenArm, point: np.ndarray, kept: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return the point after a Newton `step` of the entries in the mask `kept`, shortened until the residual falls."""

    def unrest(at: np.ndarray) -> float:
        return float(np.linalg.norm((arm.advance(at) - at)[kept]))

    before = unrest(point)
    for share in _NEWTON_SHARES:
        moved = point.copy()
        moved[kept] += share * step
        if unrest(moved) < before:
            break
    return moved


class _FrozenArm:
    """The nonlinear loop with a held reference.

    A point is the plant's state, ordered as `State`, and the policy's memory; points are rows. The law maps a point to
    torque and next memory.
    """

    def __init__(
        self, policy: Predictor, parameters: AnyArm, posture: np.ndarray, control_period: float, payload: Payload | None
    ) -> None:
        physics, smooth = equations_of(parameters), without_dry_friction(parameters)
        carried = payload or Payload()
        place = physics.payload_place(carried, parameters)
        constants = physics.constants(physics.plant_of(smooth), carried.mass, place, 0.0)
        self.policy, self.physics, self.joints = policy, physics, physics.joints
        start = starts(self.joints)
        self.reference = np.append(posture, np.zeros(PARTS * self.joints - start.dq_reference))
        self.arm = np.array(flat(constants), dtype=float)[:, np.newaxis]
        self.period, self.limit = control_period, per_joint_of(parameters, "torque_limit")
        self.rate = fastest_rate([parameters])
        self.states, at = size(physics.State), columns(physics.State)
        self.plant, self.memory = slice(self.states), slice(self.states, None)
        self.torque, self.next_memory = slice(self.joints), slice(self.joints, None)
        self.q_motor, self.dq_motor = at.motor, at.motor_velocity

    def start(self) -> np.ndarray:
        """Return a first guess of the equilibrium: the arm at the posture, the memory after one call of the policy.

        If a torque is clipped there, return the point that the loop reaches `_SETTLING` periods later.
        """
        posture = self.reference[: self.joints]
        plant = np.concatenate([posture, posture, np.zeros(self.states - 2 * self.joints)])
        point = np.append(plant, self._act(plant[np.newaxis])[0, self.next_memory])
        clipped = np.any(np.abs(self._act(point[np.newaxis])[0, self.torque]) >= self.limit)
        return self.settled(point, _SETTLING) if clipped else point  # a clipped torque has no slope

    def settled(self, point: np.ndarray, periods: int) -> np.ndarray:
        """Return the point that the loop reaches from `point` in a number of control periods."""
        for _ in range(periods):
            point = self.advance(point)
        return point

    def linearise(self, point: np.ndarray) -> tuple[LocalLoop, np.ndarray]:
        """Return the loop at `point`, and a mask of the entries of `point` that are its states.

        The loop's `half_plant` is nan.
        """
        torque = self._act(point[np.newaxis])[0, self.torque]
        plant = self.plant_over(self.period, point, torque)
        memory = point[self.memory]
        law_steps = _LAW_STEP * np.append(np.ones(self.states), np.maximum(1.0, np.abs(memory)))
        law = _differences(self._act, point, law_steps)
        # Entries are kept if the torque depends on them, directly or through other memory. Unread entries have
        # differences of exactly 0.
        rows = np.append(np.ones(self.joints, dtype=bool), np.zeros(len(memory), dtype=bool))
        for _ in memory:
            rows[self.next_memory] |= np.any(law[rows, self.memory] != 0.0, axis=0)
        kept = np.append(np.ones(self.states, dtype=bool), rows[self.next_memory])
        return LocalLoop(plant, np.full_like(plant, np.nan), law[np.ix_(rows, kept)], point, torque), kept

    def plant_over(self, duration: float, point: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return [A B] (n, n + r) of the plant over a duration [s] around a point and a torque (r,) [N m]."""
        held = np.append(point[self.plant], torque)
        steps = np.append(np.full(self.states, _PLANT_STEP), np.full(self.joints, _TORQUE_STEP))
        return _differences(partial(self._move, duration), held, steps)

    def advance(self, point: np.ndarray) -> np.ndarray:
        """Return the point that the loop reaches from `point` in one control period."""
        law = self._act(point[np.newaxis])[0]
        moved = self._move(self.period, np.append(point[self.plant], law[self.torque])[np.newaxis])[0]
        return np.append(moved, law[self.next_memory])

    def act_after(self, point: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Return torques and next memory (lanes, r + m) at a point; `moved` (lanes, r) [rad] shifts the reference."""
        steps = np.pad(moved, ((0, 0), (0, len(self.reference) - self.joints)))
        return self._act(np.tile(point, (len(moved), 1)), steps)

    def _act(self, points: np.ndarray, moved: np.ndarray | float = 0.0) -> np.ndarray:
        """Return torques and next memory (lanes, r + m) at points (lanes, n + m).

        The plant has n states and r joints, the memory m entries. Points without memory (lanes, n) begin an episode.
        `moved` (lanes, 3 r) is added to the held reference, angles first.
        """
        reference = np.tile(self.reference, (len(points), 1)) + moved
        observation = np.hstack([points[:, self.q_motor], points[:, self.dq_motor], reference])
        memory = points[:, self.memory] if points.shape[1] > self.states else None
        torque, memory = self.policy.predict(observation, state=memory, deterministic=True)
        if torque.dtype != np.float64 or not isinstance(memory, np.ndarray | None):
            raise TypeError(
                f"the policy returned a torque of type {torque.dtype} and a state of type {type(memory).__name__}; it "
                "must return a float64 torque, and a NumPy array or None as state"
            )
        return torque if memory is None else np.hstack([torque, memory])

    def _move(self, duration: float, plant_and_torque: np.ndarray) -> np.ndarray:
        """Return the plant states (lanes, n) after `duration` [s], from states and held torques (lanes, n + r)."""
        state, torque = np.split(plant_and_torque.T.copy(), [self.states])
        lanes = state.shape[1]
        arm, no_force = np.tile(self.arm, lanes), np.zeros((size(force_line(self.physics.axes)), lanes))
        substeps = default_substeps(duration, self.rate)
        hold_of(self.physics)(state, torque, no_force, arm, duration / substeps, substeps)
        return np.transpose(state)


def _differences(function: Callable[[np.ndarray], np.ndarray], point: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the Jacobian of `function` at `point` by central differences, all columns from one batched call."""
    steps = np.broadcast_to(steps, point.shape)
    ahead, behind = np.split(function(point + np.vstack([np.diag(steps), -np.diag(steps)])), 2)
    with np.errstate(invalid="ignore"):  # `_linearise` refuses what is not finite
        return np.transpose((ahead - behind) / (2.0 * steps[:, np.newaxis]))


def remark_on(name: str, policy: Any, arm: AnyArm, period: float, share: float) -> str | None:
    """Return a line on a policy if a motor is often at its torque limit or its loop is unstable at rest, else None.

    The loop is linearised at rest, in postures of the default path of `arm`, which the policy knows. `period` is the
    control period [s], `share` [1] the share of the steps with a motor at its torque limit.
    """
    limited = f"a motor is at its torque limit in {100.0 * share:.0f} % of the steps; " if share > _LONG else ""
    try:
        if policy.action_period != period:
            raise ValueError("it holds each action for several control periods; use fuzzyarm margins")
        radius = largest_radius(linearise_path(policy, arm, period))
    except (AttributeError, TypeError, ValueError) as error:
        reason = f"it is unknown whether its loop is stable on this arm: {' '.join(str(error).split())}"
        return f"{name}: {limited}{reason}" if limited else None
    measured = f"spectral radius {radius:.3g} at rest, see fuzzyarm margins"
    if radius > 1.0 + _GROWTH:
        return f"{name}: {limited}its loop is unstable on this arm ({measured})"
    if limited:
        return f"{name}: {limited}its loop is stable ({measured}), but the motors lack the torque for the motion"
    return None
