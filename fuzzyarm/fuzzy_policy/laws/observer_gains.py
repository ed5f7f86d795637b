"""The gains of the elastic observer: K and L from the Riccati equations of the linearised arm.

The arm, motors and links with a load d on the links, is linearised at rest and held over a control period. Gravity's
slope, the Coriolis torques and dry friction are left out, so it depends on the mass matrix M alone; the gains are
tabulated over the angles that M depends on most, see `gain_schedule`. How they are used is in `elastic_observer`.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from fuzzyarm.common.checks import real
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.fuzzy_policy.known_arm import joints_of, per_joint_of
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, schedule_of

__all__ = [
    "Estimate", "GainTables", "ObserverWeights", "estimate_parts", "feedback_gain", "gain_tables", "observer_gain",
    "sampled_arm", "state_part",
]  # fmt: skip

WEIGHT_RANGE = (1e-6, 1e6)  # far wider than any sensible weight; keeps the numbers finite


class Estimate(NamedTuple):
    """The parts of (x, d), one number per joint in each, or where they lie in an array.

    Attributes:
        q_motor: θ, motor angles [rad].
        q_link: q, link angles [rad].
        dq_motor: θ̇ [rad/s].
        dq_link: q̇ [rad/s].
        load: d, unknown torques on the links [N m].
    """

    q_motor: Any
    q_link: Any
    dq_motor: Any
    dq_link: Any
    load: Any


class GainTables(NamedTuple):
    """The gains at the points of a schedule.

    Attributes:
        schedule: over which angles, and at which points.
        feedback: K (points, n, 4 n).
        observer: L (points, 5 n, 2 n).
    """

    schedule: GainSchedule
    feedback: np.ndarray
    observer: np.ndarray


def estimate_parts(joints: int) -> Estimate:
    """Return where the parts of (x, d), 5 n numbers, lie in an array, for n joints."""
    return Estimate(*consecutive(*[joints] * len(Estimate._fields)))


def state_part(joints: int) -> slice:
    """Return where x, 4 n numbers in the order of `State`, lies in (x, d)."""
    return slice(0, estimate_parts(joints).load.start)


@dataclasses.dataclass(frozen=True)
class ObserverWeights:
    """The weights of both Riccati equations.

    The first four defaults were chosen by ``python benchmarks/observer_tuning.py`` for the smallest tip error
    over random arms within stability margins. The last two are the encoder noise of the README's examples.

    Torques are shares of the arm's `torque_limit`, joint by joint, so that the same weights fit arms of another size.

    Attributes:
        link_angle: link error [rad] that costs as much as the whole torque, weight 1/link_angle² against 1/Γ_max².
        link_velocity: link velocity error [rad/s] that costs as much as the whole torque.
        load_walk: random walk of d, share of the torque limit per √s.
        motor_torque: white noise of the motor torque, share of the torque limit times √s. More of it makes the loop
            with the observer more robust (loop transfer recovery).
        encoder_angle: standard deviation of the measured angle [rad]; only its ratio to the other noises counts.
        encoder_velocity: standard deviation of the measured velocity [rad/s].

    Raises:
        TypeError: a weight is no number.
        ValueError: a weight lies outside `WEIGHT_RANGE`.
    """

    link_angle: float = 0.0218
    link_velocity: float = 1.57
    load_walk: float = 0.075
    motor_torque: float = 5.57e-4
    encoder_angle: float = 1e-5
    encoder_velocity: float = 1e-3

    def __post_init__(self) -> None:
        """Check the weights."""
        low, high = WEIGHT_RANGE
        for field in dataclasses.fields(self):
            real(f"ObserverWeights.{field.name}", getattr(self, field.name), low=low, high=high)


def sampled_arm(arm: AnyArm, control_period: float, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A (5 n, 5 n) and B (5 n, n) of (x, d)⁺ = A (x, d) + B u over one control period [s], u held, d constant.

    At rest, without gravity and dry friction, with M_b = `inertia` (n, n) [kg m²]:
    I_a θ̈ = u - Γ_t - f_v θ̇,  M_b q̈ = Γ_t + d,  Γ_t = K_t (θ - q) + B_t (θ̇ - q̇).
    """
    joints = joints_of(arm)
    part, state, load = estimate_parts(joints), state_part(joints), estimate_parts(joints).load
    links = np.linalg.inv(inertia)
    motors = np.diag(1.0 / per_joint_of(arm, "motor_inertia"))
    stiffness, damping = np.diag(per_joint_of(arm, "stiffness")), np.diag(per_joint_of(arm, "damping"))
    joint_torque = np.hstack([stiffness, -stiffness, damping, -damping])
    given = slice(load.stop, load.stop + joints)  # u
    rate = np.zeros((given.stop, given.stop))  # of (x, d, u)
    rate[part.q_motor, part.dq_motor] = rate[part.q_link, part.dq_link] = np.eye(joints)
    rate[part.dq_motor, state], rate[part.dq_motor, given] = -motors @ joint_torque, motors
    rate[part.dq_motor, part.dq_motor] -= motors @ np.diag(per_joint_of(arm, "viscous_friction"))
    rate[part.dq_link, state], rate[part.dq_link, load] = links @ joint_torque, links
    moved = expm(rate * control_period)
    return moved[: load.stop, : load.stop], moved[: load.stop, given]


def feedback_gain(A: np.ndarray, B: np.ndarray, torque_limit: np.ndarray, weights: ObserverWeights) -> np.ndarray:
    """Return K (n, 4 n) that minimises Σ |q/link_angle|² + |q̇/link_velocity|² + |u/Γ_max|² of `sampled_arm`, d = 0.

    Γ_max is `torque_limit` (n,) [N m].
    """
    joints = len(torque_limit)
    state = state_part(joints)
    a, b = A[state, state], B[state]
    Q = np.diag(np.repeat([0.0, weights.link_angle**-2, 0.0, weights.link_velocity**-2], joints))
    R = np.diag(torque_limit**-2)
    P = solve_discrete_are(a, b, Q, R)
    gain: np.ndarray = np.linalg.solve(R + b.T @ P @ b, b.T @ P @ a)
    return gain


def observer_gain(
    A: np.ndarray, B: np.ndarray, control_period: float, torque_limit: np.ndarray, weights: ObserverWeights
) -> np.ndarray:
    """Return L (5 n, 2 n), the stationary Kalman gain of `sampled_arm` that corrects (x̂, d̂) by what is measured now.

    `torque_limit` (n,) [N m] and `control_period` [s] scale the weights.
    """
    joints = len(torque_limit)
    part = estimate_parts(joints)
    C = np.concatenate([np.eye(len(A))[part.q_motor], np.eye(len(A))[part.dq_motor]])
    Q = B @ np.diag((weights.motor_torque * torque_limit) ** 2) @ B.T / control_period
    Q[part.load, part.load] += np.diag((weights.load_walk * torque_limit) ** 2) * control_period
    R = np.diag(np.repeat([weights.encoder_angle**2, weights.encoder_velocity**2], joints))
    P = solve_discrete_are(A.T, C.T, Q, R)
    gain: np.ndarray = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return gain


@functools.lru_cache(maxsize=32)
def gain_tables(arm: AnyArm, control_period: float, weights: ObserverWeights) -> GainTables:
    """Return K and L at the points of the arm's schedule, for a control period [s].

    Raises:
        ValueError: a Riccati equation has no solution in double precision.
    """
    limit, schedule = per_joint_of(arm, "torque_limit"), schedule_of(arm)
    feedback, observer = [], []
    for place, inertia in zip(schedule.places, schedule.inertia, strict=True):
        A, B = sampled_arm(arm, control_period, inertia)
        try:
            feedback.append(feedback_gain(A, B, limit, weights))
            observer.append(observer_gain(A, B, control_period, limit, weights))
        except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
            raise ValueError(
                f"no gains at {place} for control_period = {control_period!r} s, {weights} and this arm "
                f"({error}): take a shorter period, or other weights"
            ) from None
    return GainTables(schedule, np.array(feedback), np.array(observer))
