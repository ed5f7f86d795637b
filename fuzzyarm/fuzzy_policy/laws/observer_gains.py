"""The gains of the elastic observer: K and L from the Riccati equations of the linearised arm.

The arm, motors and links with a load d on the links, is linearised at rest and held over a control period. Gravity's
slope, the Coriolis torques and dry friction are left out, so it depends on cos q2 alone; the gains are tabulated over
it. How they are used is in `elastic_observer`.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from fuzzyarm.common.checks import real
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, mass_matrix
from fuzzyarm.envs.physics.parameters import ArmParameters

__all__ = [
    "ESTIMATE",
    "ESTIMATES",
    "GRID",
    "LOAD",
    "MEASURED",
    "STATE",
    "STATES",
    "Estimate",
    "ObserverWeights",
    "feedback_gain",
    "gain_tables",
    "observer_gain",
    "sampled_arm",
]

GRID = np.linspace(-1.0, 1.0, 9)  # cos q2 of the gain tables
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


*_SIZES, _INPUT = consecutive(*[JOINTS] * (len(Estimate._fields) + 1))
# Where the parts of (x, d) lie, and which of its numbers are measured.
ESTIMATE = Estimate(*_SIZES)
STATE, LOAD = slice(0, ESTIMATE.load.start), ESTIMATE.load  # x in the order of `State`, and d
STATES, ESTIMATES = STATE.stop, LOAD.stop  # how many numbers x and (x, d) are
MEASURED = [index for part in (ESTIMATE.q_motor, ESTIMATE.dq_motor) for index in range(part.start, part.stop)]


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


def sampled_arm(
    parameters: ArmParameters, control_period: float, cos2: float, payload: Payload | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return A (10, 10) and B (10, 2) of (x, d)⁺ = A (x, d) + B u over one control period [s], u held, d constant.

    At rest, without gravity and dry friction, at cos q2 = `cos2`, with a payload if there is one:
    I_a θ̈ = u - Γ_t - f_v θ̇,  M_b q̈ = Γ_t + d,  Γ_t = K_t (θ - q) + B_t (θ̇ - q̇).
    """
    m11, m12, m22 = mass_matrix(cos2, arm_constants(parameters, payload))
    links = np.linalg.inv([[m11, m12], [m12, m22]])
    motors = np.diag(1.0 / np.array(parameters.motor_inertia))
    stiffness, damping = np.diag(parameters.stiffness), np.diag(parameters.damping)
    joint_torque = np.hstack([stiffness, -stiffness, damping, -damping])
    motor_rows, link_rows = ESTIMATE.dq_motor, ESTIMATE.dq_link
    rate = np.zeros((_INPUT.stop, _INPUT.stop))  # of (x, d, u)
    rate[ESTIMATE.q_motor, ESTIMATE.dq_motor] = rate[ESTIMATE.q_link, ESTIMATE.dq_link] = np.eye(JOINTS)
    rate[motor_rows, STATE], rate[motor_rows, _INPUT] = -motors @ joint_torque, motors
    rate[motor_rows, motor_rows] -= motors @ np.diag(parameters.viscous_friction)
    rate[link_rows, STATE], rate[link_rows, LOAD] = links @ joint_torque, links
    moved = expm(rate * control_period)
    return moved[:ESTIMATES, :ESTIMATES], moved[:ESTIMATES, _INPUT]


def feedback_gain(A: np.ndarray, B: np.ndarray, torque_limit: np.ndarray, weights: ObserverWeights) -> np.ndarray:
    """Return K (2, 8) that minimises Σ |q/link_angle|² + |q̇/link_velocity|² + |u/Γ_max|² of `sampled_arm`, d = 0.

    Γ_max is `torque_limit` (2,) [N m].
    """
    a, b = A[STATE, STATE], B[STATE]
    Q = np.diag(np.repeat([0.0, weights.link_angle**-2, 0.0, weights.link_velocity**-2], JOINTS))
    R = np.diag(torque_limit**-2)
    P = solve_discrete_are(a, b, Q, R)
    gain: np.ndarray = np.linalg.solve(R + b.T @ P @ b, b.T @ P @ a)
    return gain


def observer_gain(
    A: np.ndarray, B: np.ndarray, control_period: float, torque_limit: np.ndarray, weights: ObserverWeights
) -> np.ndarray:
    """Return L (10, 4), the stationary Kalman gain of `sampled_arm` that corrects (x̂, d̂) by what is measured now.

    `torque_limit` (2,) [N m] and `control_period` [s] scale the weights.
    """
    C = np.eye(ESTIMATES)[MEASURED]
    Q = B @ np.diag((weights.motor_torque * torque_limit) ** 2) @ B.T / control_period
    Q[LOAD, LOAD] += np.diag((weights.load_walk * torque_limit) ** 2) * control_period
    R = np.diag(np.repeat([weights.encoder_angle**2, weights.encoder_velocity**2], JOINTS))
    P = solve_discrete_are(A.T, C.T, Q, R)
    gain: np.ndarray = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return gain


def gain_tables(
    parameters: ArmParameters, control_period: float, weights: ObserverWeights
) -> tuple[np.ndarray, np.ndarray]:
    """Return K (9, 2, 8) and L (9, 10, 4) at cos q2 = `GRID`, for a control period [s].

    Raises:
        ValueError: a Riccati equation has no solution in double precision.
    """
    limit = np.array(parameters.torque_limit)
    feedback, observer = [], []
    for cos2 in GRID:
        A, B = sampled_arm(parameters, control_period, float(cos2))
        try:
            feedback.append(feedback_gain(A, B, limit, weights))
            observer.append(observer_gain(A, B, control_period, limit, weights))
        except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
            raise ValueError(
                f"no gains at cos q2 = {cos2:g} for control_period = {control_period!r} s, {weights} and this arm "
                f"({error}): take a shorter period, or other weights"
            ) from None
    return np.array(feedback), np.array(observer)
