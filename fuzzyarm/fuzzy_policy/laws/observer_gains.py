"""The gains of the elastic observer: K and L from the Riccati equations of the linearised arm.

The arm (motors, links, and a load d on the links) is linearised at rest and sampled over a control period. Gravity's
slope, Coriolis torques and dry friction are left out, so that it depends on the mass matrix M alone; the gains are
tabulated over the angles that M depends on most, see `gain_schedule`.

Near rest, a law with memory s is

    u = κ (D x + C s),    s⁺ = G x + F s,

where x is the plant's state (4 n,), κ a factor on the gain, and u is held over a period, at once or one period late.

`ObserverWeights` were tuned for the two-joint arm. If a robot's mass matrix depends on more angles than the table of
gains, the loop may be unstable in part of the range. The substitutions

    link_angle → σ link_angle,    link_velocity → √σ link_velocity

with a factor σ ≥ 1 weaken the feedback and make it more robust. The default is the smallest σ of `SOFTENINGS` for which
the loop is stable at random postures under all `_CONDITIONS`.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.common.checks import real
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import joints_of, per_joint_of, with_drives
from fuzzyarm.fuzzy_policy.laws._gain_schedule import GainSchedule, nearest_inertia, random_angles, schedule_of
from fuzzyarm.fuzzy_policy.laws._riccati import exponential, riccati
from fuzzyarm.numbers.linear import product, solved

__all__ = [
    "ONE_AT_A_TIME", "SOFTENINGS", "WEIGHT_RANGE", "Condition", "Estimate", "LinearLaw", "ObserverWeights", "Place",
    "designed_for", "estimate_parts", "feedback_gain", "found_at", "gain_tables", "linear_pid", "places_of", "softened",
    "weights_for", "worst_radius",
]  # fmt: skip

WEIGHT_RANGE = (1e-6, 1e6)  # far wider than any sensible weight; keeps all values finite


class Estimate(NamedTuple):
    """The elastic arm's state x and the load d, one entry per joint in each part, or the parts' slices in an array."""

    q_motor: Any  # θ, motor angles [rad]
    q_link: Any  # q, link angles [rad]
    dq_motor: Any  # θ̇ [rad/s]
    dq_link: Any  # q̇ [rad/s]
    load: Any  # d, unknown torques on the links [N m]

    @property
    def state(self) -> slice:
        """Slice of x in an array; x has 4 n entries in the order of `State`."""
        return slice(0, self.load.start)


def estimate_parts(joints: int) -> Estimate:
    """Return the slices of the parts of an `Estimate` in an array (5 n,), for n joints."""
    return Estimate(*consecutive(*[joints] * len(Estimate._fields)))


@dataclasses.dataclass(frozen=True)
class ObserverWeights:
    """The weights of the Riccati equations of regulator and observer, each in `WEIGHT_RANGE`.

    The first four defaults were chosen by ``python benchmarks/observer_tuning.py`` (commit 2839bc83) for the smallest
    tip error over random arms within stability margins. The last two are the encoder noise of the README's examples.
    """

    # link angle error [rad] that costs as much as the torque limit, weight 1/link_angle² against 1/Γ_max²
    link_angle: float = 0.0218
    link_velocity: float = 1.57  # link velocity error [rad/s] that costs as much as the torque limit
    load_walk: float = 0.075  # random walk of d, share of the torque limit per √s
    # white noise of the motor torque, share of the torque limit times √s; more noise makes the loop with the observer
    # more robust (loop transfer recovery)
    motor_torque: float = 5.57e-4
    # standard deviation of the measured angle [rad]; only its ratio to the other noises counts
    encoder_angle: float = 1e-5
    encoder_velocity: float = 1e-3  # standard deviation of the measured velocity [rad/s]

    def __post_init__(self) -> None:
        low, high = WEIGHT_RANGE
        for field in dataclasses.fields(self):
            real(f"ObserverWeights.{field.name}", getattr(self, field.name), low=low, high=high)


def _sampled_arm(arm: AnyArm, control_period: float, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A (..., 5 n, 5 n) and B (..., 5 n, n) of (x, d)⁺ = A (x, d) + B u over a period [s], u held, d constant.

    At rest, without gravity and dry friction, with M_b = `inertia` (..., n, n) [kg m²]:
    I_a θ̈ = u - Γ_t - f_v θ̇,  M_b q̈ = Γ_t + d,  Γ_t = K_t (θ - q) + B_t (θ̇ - q̇).
    """
    joints = joints_of(arm)
    part = estimate_parts(joints)
    state, load = part.state, part.load
    links, motors = solved(inertia, np.eye(joints)), 1.0 / per_joint_of(arm, "motor_inertia")
    stiffness, damping = np.diag(per_joint_of(arm, "stiffness")), np.diag(per_joint_of(arm, "damping"))
    joint_torque = np.hstack([stiffness, -stiffness, damping, -damping])
    given = slice(load.stop, load.stop + joints)  # u
    rate = np.zeros((*inertia.shape[:-2], given.stop, given.stop))  # of (x, d, u)
    rate[..., part.q_motor, part.dq_motor] = rate[..., part.q_link, part.dq_link] = np.eye(joints)
    rate[..., part.dq_motor, state] = -motors[:, np.newaxis] * joint_torque
    rate[..., part.dq_motor, given] = np.diag(motors)
    rate[..., part.dq_motor, part.dq_motor] -= np.diag(motors * per_joint_of(arm, "viscous_friction"))
    rate[..., part.dq_link, state], rate[..., part.dq_link, load] = product(links, joint_torque), links
    moved = exponential(rate * control_period)
    return moved[..., : load.stop, : load.stop], moved[..., : load.stop, given]


def feedback_gain(arm: AnyArm, control_period: float, inertia: np.ndarray, weights: Any) -> np.ndarray:
    """Return the gain K (..., n, 4 n) of the linear quadratic regulator u = -K x for mass matrices `inertia`.

    x = (θ, q, θ̇, q̇) is sampled every `control_period` [s]; K is nan where no regulator exists. The regulator
    minimises Σ |q/link_angle|² + |q̇/link_velocity|² + |u/Γ_max|². The weights are `ObserverWeights` or the
    `AdaptiveWeights` of `adaptive.belief`.
    """
    (A, B), limit = _sampled_arm(arm, control_period, inertia), per_joint_of(arm, "torque_limit")
    joints, state = len(limit), estimate_parts(len(limit)).state
    A, B = A[..., state, state], B[..., state, :]
    Bt, square = np.swapaxes(B, -1, -2), limit * limit
    Q = np.diag(np.repeat([0.0, weights.link_angle**-2, 0.0, weights.link_velocity**-2], joints))
    P = riccati(A, product(B * square, Bt), np.broadcast_to(Q, A.shape))
    return solved(np.diag(1.0 / square) + product(product(Bt, P), B), product(product(Bt, P), A))


def _observer_gain(arm: AnyArm, control_period: float, inertia: np.ndarray, weights: ObserverWeights) -> np.ndarray:
    """Return L (..., 5 n, 2 n), the stationary Kalman gain for mass matrices `inertia`; nan if none exists."""
    (A, B), limit = _sampled_arm(arm, control_period, inertia), per_joint_of(arm, "torque_limit")
    joints, part = len(limit), estimate_parts(len(limit))
    measured = np.r_[part.q_motor, part.dq_motor]
    R = np.repeat([weights.encoder_angle**2, weights.encoder_velocity**2], joints)
    Q = product(B * ((weights.motor_torque * limit) ** 2 / control_period), np.swapaxes(B, -1, -2))
    Q[..., part.load, part.load] += np.diag((weights.load_walk * limit) ** 2) * control_period
    G = np.zeros_like(A)
    G[..., measured, measured] = 1.0 / R
    of_measured = riccati(np.swapaxes(A, -1, -2), G, Q)[..., measured, :]
    return np.swapaxes(solved(of_measured[..., measured] + np.diag(R), of_measured), -1, -2)


@functools.lru_cache(maxsize=32)
def gain_tables(
    arm: AnyArm, control_period: float, weights: ObserverWeights
) -> tuple[GainSchedule, np.ndarray, np.ndarray]:
    """Return the schedule, and for its points the gains K (points, n, 4 n) and L (points, 5 n, 2 n).

    ValueError if there are no gains for this control period [s].
    """
    schedule = schedule_of(arm)
    given: Any = arm, control_period, schedule.inertia, weights
    feedback, observer = (
        found_at(schedule, gain(*given), control_period, weights) for gain in (feedback_gain, _observer_gain)
    )
    return schedule, feedback, observer


def found_at(schedule: GainSchedule, gains: np.ndarray, control_period: float, weights: Any) -> np.ndarray:
    """Return `gains` (points, ...); if one is nan, raise a ValueError that names the point and the settings."""
    for place, gain in zip(schedule.places, gains, strict=True):
        if not np.isfinite(gain).all():
            raise ValueError(
                f"no gains were found at {place} for control_period = {control_period!r} s, {weights} and this arm: "
                "the Riccati equation has no accurate solution; choose a shorter period or other weights"
            )
    return gains


class Condition(NamedTuple):
    """A deviation from the nominal loop: factor κ on its gain, samples of delay, and factor on the stiffness."""

    loop_gain: float = 1.0
    delay: int = 0
    stiffness: float = 1.0


ONE_AT_A_TIME = (Condition(), Condition(loop_gain=2.0), Condition(delay=1))
"""The margins required of computed torque to find its bandwidth: 6 dB, and one sample of delay."""

_CONDITIONS = (
    *(Condition(gain, delay) for gain in (1.0, 0.67, 1.5) for delay in (0, 1)),
    *(Condition(stiffness=factor) for factor in (0.9, 1.1)),
)
"""The margins required of the elastic observer to find its weights."""

_COUNT = 16  # postures


@dataclasses.dataclass(frozen=True)
class Place:
    """A robot at a posture, and its control period."""

    q: np.ndarray  # the angles (n,) [rad]
    inertia: np.ndarray  # M (n, n) [kg m²]
    robot: Robot  # the nominal robot
    control_period: float  # T [s]

    def plant(self, stiffness: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return A (5 n, 5 n) and B (5 n, n) of `_sampled_arm`, with all joints `stiffness` times as stiff."""
        arm = with_drives(self.robot, stiffness=stiffness * self.robot.drive("stiffness"))
        return _sampled_arm(arm, self.control_period, self.inertia)


class LinearLaw(NamedTuple):
    """A law near rest, u = D x + C s, s⁺ = G x + F s: torques u (n,) [N m], deviation x (4 n,), memory s (m,)."""

    D: np.ndarray
    C: np.ndarray
    G: np.ndarray
    F: np.ndarray


def linear_pid(place: Place, inertia: np.ndarray, k_p: float, k_d: float, k_i: float) -> LinearLaw:
    """Return u = f_v q̇ - M̂ (k_p e + k_d ė + k_i x_I) near rest, for M̂ = `inertia` (n, n) [kg m²]; its memory is x_I."""
    joints = len(place.robot)
    part = estimate_parts(joints)
    D, G = np.zeros((2, joints, part.state.stop))
    D[:, part.q_motor] = -k_p * inertia
    D[:, part.dq_motor] = -k_d * inertia + np.diag(place.robot.drive("viscous_friction"))
    G[:, part.q_motor] = place.control_period * np.eye(joints)
    return LinearLaw(D, -k_i * inertia, G, np.eye(joints))


def places_of(robot: Robot, control_period: float, count: int = _COUNT) -> list[Place]:
    """Return `count` random postures, the same at every call, each with M and the control period [s]."""
    angles = random_angles(robot)[:count]
    return [Place(q, M, robot, control_period) for q, M in zip(angles, mass_matrix(robot, angles), strict=True)]


def worst_radius(place: Place, law: LinearLaw, conditions: tuple[Condition, ...]) -> float:
    """Return the largest |eigenvalue| of the sampled loop over the conditions; inf if a gain of the law is nan."""
    if not all(np.isfinite(part).all() for part in law):
        return math.inf
    plants = {factor: place.plant(factor) for factor in {condition.stiffness for condition in conditions}}
    return max(float(np.abs(np.linalg.eigvals(_matrix(plants[c.stiffness], law, c))).max()) for c in conditions)


def designed_for(robot: Robot, places: Sequence[Place]) -> np.ndarray:
    """Return, for each place, the mass matrix at the nearest point of the gain tables, (places, n, n) [kg m²]."""
    schedule = schedule_of(robot)
    return np.array([nearest_inertia(schedule, place.q) for place in places])


def _matrix(plant: tuple[np.ndarray, np.ndarray], law: LinearLaw, condition: Condition) -> np.ndarray:
    """Return the loop's matrix for (x, s), or (x, s, u) if `condition` delays u; `plant` is (A, B) of `Place.plant`."""
    joints, states = law.D.shape
    state = estimate_parts(joints).state
    A, B = plant[0][state, state], plant[1][state]
    D, C, memory = condition.loop_gain * law.D, condition.loop_gain * law.C, len(law.F)
    if not condition.delay:
        return np.block([[A + B @ D, B @ C], [law.G, law.F]])
    of_state, of_memory = [A, np.zeros((states, memory)), B], [law.G, law.F, np.zeros((memory, joints))]
    return np.block([of_state, of_memory, [D, C, np.zeros((joints, joints))]])


SOFTENINGS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # factors σ, tried in this order


@functools.lru_cache(maxsize=32)
def weights_for(arm: AnyArm, control_period: float) -> ObserverWeights:
    """Return the default weights for an arm and a control period [s]; for a two-joint arm those tuned for Table 1.

    If no factor of `SOFTENINGS` makes the loop stable, the one with the smallest `worst_radius` is used.
    """
    weights = ObserverWeights()
    if not isinstance(arm, Robot):
        return weights
    places, smallest = places_of(arm, control_period), math.inf
    for factor in SOFTENINGS:
        trial: ObserverWeights = softened(ObserverWeights(), factor)
        given = arm, control_period, designed_for(arm, places), trial
        laws = map(_linear_observer, places, feedback_gain(*given), _observer_gain(*given))
        radius = max(worst_radius(place, law, _CONDITIONS) for place, law in zip(places, laws, strict=True))
        if radius < 1.0:
            return trial
        if radius < smallest:
            weights, smallest = trial, radius
    return weights


def softened(weights: Any, factor: float) -> Any:
    """Return the weights with `link_angle` times `factor` and `link_velocity` times √factor, for weaker feedback."""
    link_angle, link_velocity = factor * weights.link_angle, math.sqrt(factor) * weights.link_velocity
    return dataclasses.replace(weights, link_angle=link_angle, link_velocity=link_velocity)


def _linear_observer(place: Place, K: np.ndarray, L: np.ndarray) -> LinearLaw:
    """Return the observer linearised at rest, with K (n, 4 n), L (5 n, 2 n) and, as memory, the predicted (x, d)."""
    robot, joints = place.robot, len(place.robot)
    part = estimate_parts(joints)
    state = part.state
    A, B = place.plant()  # the plant with which the observer predicts
    measured = np.eye(len(A))[np.r_[part.q_motor, part.dq_motor]]
    acts = np.zeros((joints, len(A)))  # u = acts (x̂, d̂)
    acts[:, state] = -K
    acts[:, part.load] = -np.eye(joints) - K[:, part.q_motor] / per_joint_of(robot, "stiffness")
    from_plant, from_memory = L @ measured[:, state], np.eye(len(A)) - L @ measured
    predicts = A + B @ acts
    return LinearLaw(acts @ from_plant, acts @ from_memory, predicts @ from_plant, predicts @ from_memory)
