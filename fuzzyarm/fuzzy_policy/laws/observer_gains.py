"""The gains of the elastic observer: K and L from the Riccati equations of the linearised arm.

The arm, motors and links with a load d on the links, is linearised at rest and held over a control period. Gravity's
slope, the Coriolis torques and dry friction are left out, so it depends on the mass matrix M alone; the gains are
tabulated over the angles that M depends on most, see `gain_schedule`. How they are used is in `elastic_observer`.

Default gains are those that hold on the sampled elastic robot anywhere in its range. At random postures the robot is
linearised without gravity and dry friction, see `sampled_arm`, and a law near rest is, with its memory s,

    u = κ (D x + C s),    s⁺ = G x + F s,

with x the plant's 4 n states, u held over a period or one period late. `fuzzyarm.eval.stability` measures the same of
any policy, with gravity, at postures of a path.

`ObserverWeights` were tuned for the two-joint arm. Where a robot's mass matrix depends on more angles than gains are
tabulated over, they are too sharp, and the loop may be unstable in part of its range. With a factor s ≥ 1,

    link_angle → s link_angle,    link_velocity → √s link_velocity

weaken the feedback and make it more robust. The smallest s of `SOFTENINGS` is taken with which the loop is stable at
random postures in all of `CONDITIONS`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.common.checks import real
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import joints_of, per_joint_of, with_drives
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, nearest_inertia, random_angles, schedule_of

__all__ = [
    "CONDITIONS", "ONE_AT_A_TIME", "SOFTENINGS", "Condition", "Estimate", "LinearLaw", "ObserverWeights", "Place",
    "at_points", "estimate_parts", "feedback_gain", "gain_tables", "largest_radius", "linear_observer", "linear_pid",
    "places_of", "sampled_arm", "softened", "state_part", "weights_for", "worst_radius",
]  # fmt: skip

Gains = TypeVar("Gains")
WEIGHT_RANGE = (1e-6, 1e6)  # far wider than any sensible weight; keeps the numbers finite


class Estimate(NamedTuple):
    """The parts of (x, d), one number per joint in each, or where they lie in an array."""

    q_motor: Any  # θ, motor angles [rad]
    q_link: Any  # q, link angles [rad]
    dq_motor: Any  # θ̇ [rad/s]
    dq_link: Any  # q̇ [rad/s]
    load: Any  # d, unknown torques on the links [N m]


def estimate_parts(joints: int) -> Estimate:
    """Return where the parts of (x, d), 5 n numbers, lie in an array, for n joints."""
    return Estimate(*consecutive(*[joints] * len(Estimate._fields)))


def state_part(joints: int) -> slice:
    """Return where x, 4 n numbers in the order of `State`, lies in (x, d)."""
    return slice(0, estimate_parts(joints).load.start)


@dataclasses.dataclass(frozen=True)
class ObserverWeights:
    """The weights of both Riccati equations.

    The first four defaults were chosen by ``python benchmarks/observer_tuning.py`` (commit 2839bc83) for the smallest
    tip error over random arms within stability margins. The last two are the encoder noise of the README's examples.

    Torques are shares of the arm's `torque_limit`, joint by joint, so that the same weights fit arms of another size.

    Raises:
        TypeError: a weight is no number.
        ValueError: a weight lies outside `WEIGHT_RANGE`.
    """

    # link error [rad] that costs as much as the whole torque, weight 1/link_angle² against 1/Γ_max²
    link_angle: float = 0.0218
    link_velocity: float = 1.57  # link velocity error [rad/s] that costs as much as the whole torque
    load_walk: float = 0.075  # random walk of d, share of the torque limit per √s
    # white noise of the motor torque, share of the torque limit times √s. More of it makes the loop with the observer
    # more robust (loop transfer recovery).
    motor_torque: float = 5.57e-4
    # standard deviation of the measured angle [rad]; only its ratio to the other noises counts
    encoder_angle: float = 1e-5
    encoder_velocity: float = 1e-3  # standard deviation of the measured velocity [rad/s]

    def __post_init__(self) -> None:
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
    """Return K (n, 4 n) that minimises Σ |q/link_angle|² + |q̇/link_velocity|² + |u/Γ_max|² [N m], d = 0."""
    joints = len(torque_limit)
    state = state_part(joints)
    a, b = A[state, state], B[state]
    Q = np.diag(np.repeat([0.0, weights.link_angle**-2, 0.0, weights.link_velocity**-2], joints))
    R = np.diag(torque_limit**-2)
    P = solve_discrete_are(a, b, Q, R)
    gain: np.ndarray = np.linalg.solve(R + b.T @ P @ b, b.T @ P @ a)
    return gain


def _both_gains(
    arm: AnyArm, control_period: float, weights: ObserverWeights, inertia: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return K (n, 4 n) and L (5 n, 2 n), the stationary Kalman gain, of `sampled_arm`."""
    (A, B), limit = sampled_arm(arm, control_period, inertia), per_joint_of(arm, "torque_limit")
    joints, part = len(limit), estimate_parts(len(limit))
    C = np.concatenate([np.eye(len(A))[part.q_motor], np.eye(len(A))[part.dq_motor]])
    Q = B @ np.diag((weights.motor_torque * limit) ** 2) @ B.T / control_period
    Q[part.load, part.load] += np.diag((weights.load_walk * limit) ** 2) * control_period
    R = np.diag(np.repeat([weights.encoder_angle**2, weights.encoder_velocity**2], joints))
    P = solve_discrete_are(A.T, C.T, Q, R)
    return feedback_gain(A, B, limit, weights), np.linalg.solve(C @ P @ C.T + R, C @ P).T


@functools.lru_cache(maxsize=32)
def gain_tables(
    arm: AnyArm, control_period: float, weights: ObserverWeights
) -> tuple[GainSchedule, np.ndarray, np.ndarray]:
    """Return the schedule, K (points, n, 4 n) and L (points, 5 n, 2 n) for T [s]; ValueError where there are none."""
    schedule, both = schedule_of(arm), functools.partial(_both_gains, arm, control_period, weights)
    gains = at_points(both, schedule.places, schedule.inertia, f"control_period = {control_period!r} s, {weights}")
    feedback, observer = zip(*gains, strict=True)
    return schedule, np.array(feedback), np.array(observer)


def at_points(
    gains_of: Callable[[np.ndarray], Gains], places: Sequence[str], inertia: np.ndarray, settings: str
) -> list[Gains]:
    """Return the gains for each inertia (points, n, n); ValueError with place and settings where there are none."""
    gains = []
    for place, M in zip(places, inertia, strict=True):
        try:
            gains.append(gains_of(M))
        except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
            raise ValueError(
                f"no gains at {place} for {settings} and this arm ({error}): take a shorter period, or other weights"
            ) from None
    return gains


class Condition(NamedTuple):
    """How the loop differs from what the law expects: factor κ on its gain, late samples, factor on the stiffness."""

    loop_gain: float = 1.0
    delay: int = 0
    stiffness: float = 1.0


ONE_AT_A_TIME = (Condition(), Condition(loop_gain=2.0), Condition(delay=1))
"""The margins of the bandwidth of computed torque: 6 dB, and one sample of delay."""

CONDITIONS = (
    *(Condition(gain, delay) for gain in (1.0, 0.67, 1.5) for delay in (0, 1)),
    *(Condition(stiffness=factor) for factor in (0.9, 1.1)),
)
"""The margins of the observer's weights."""

_COUNT = 16  # postures


@dataclasses.dataclass(frozen=True)
class Place:
    """The robot at a posture."""

    q: np.ndarray  # the angles (n,) [rad]
    inertia: np.ndarray  # M (n, n) [kg m²]
    robot: Robot  # the nominal one
    control_period: float  # T [s]

    def plant(self, stiffness: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return A (5 n, 5 n) and B (5 n, n) of `sampled_arm`, with all joints `stiffness` times as stiff."""
        arm = with_drives(self.robot, stiffness=stiffness * self.robot.drive("stiffness"))
        return sampled_arm(arm, self.control_period, self.inertia)


class LinearLaw(NamedTuple):
    """A law near rest, see the module: D (n, 4 n), C (n, m), G (m, 4 n), F (m, m), torques in N m."""

    D: np.ndarray
    C: np.ndarray
    G: np.ndarray
    F: np.ndarray


def linear_pid(place: Place, inertia: np.ndarray, k_p: float, k_d: float, k_i: float) -> LinearLaw:
    """Return u = f_v q̇ - M̂ (k_p e + k_d ė + k_i x_I) near rest, for M̂ = `inertia` (n, n) [kg m²]; its memory is x_I."""
    joints = len(place.robot)
    part = estimate_parts(joints)
    D, G = np.zeros((2, joints, state_part(joints).stop))
    D[:, part.q_motor] = -k_p * inertia
    D[:, part.dq_motor] = -k_d * inertia + np.diag(place.robot.drive("viscous_friction"))
    G[:, part.q_motor] = place.control_period * np.eye(joints)
    return LinearLaw(D, -k_i * inertia, G, np.eye(joints))


def places_of(robot: Robot, control_period: float, count: int = _COUNT) -> list[Place]:
    """Return random postures, always the same, for a control period [s]."""
    angles = random_angles(robot)[:count]
    return [Place(q, M, robot, control_period) for q, M in zip(angles, mass_matrix(robot, angles), strict=True)]


def worst_radius(place: Place, law: LinearLaw, conditions: tuple[Condition, ...]) -> float:
    """Return the largest |λ| per control period of the loop, over conditions."""
    plants = {factor: place.plant(factor) for factor in {condition.stiffness for condition in conditions}}
    return max(float(np.abs(np.linalg.eigvals(_matrix(plants[c.stiffness], law, c))).max()) for c in conditions)


def largest_radius(
    places: Sequence[Place], law_at: Callable[[Place], LinearLaw], conditions: tuple[Condition, ...]
) -> float:
    """Return the largest radius over postures and conditions; inf where a Riccati equation has no solution."""
    try:
        return max(worst_radius(place, law_at(place), conditions) for place in places)
    except (np.linalg.LinAlgError, ValueError):  # scipy raises either
        return math.inf


def _matrix(plant: tuple[np.ndarray, np.ndarray], law: LinearLaw, condition: Condition) -> np.ndarray:
    """Return the map of (x, s), or of (x, s, u) if u acts one period late."""
    joints, states = law.D.shape
    state = state_part(joints)
    A, B = plant[0][state, state], plant[1][state]
    D, C, memory = condition.loop_gain * law.D, condition.loop_gain * law.C, len(law.F)
    if not condition.delay:
        return np.block([[A + B @ D, B @ C], [law.G, law.F]])
    of_state, of_memory = [A, np.zeros((states, memory)), B], [law.G, law.F, np.zeros((memory, joints))]
    return np.block([of_state, of_memory, [D, C, np.zeros((joints, joints))]])


SOFTENINGS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # factors s that are tried, one after the other


@functools.lru_cache(maxsize=32)
def weights_for(arm: AnyArm, control_period: float) -> ObserverWeights:
    """Return the default weights for an arm and a control period [s]; for a two-joint arm those of Table 1.

    If no factor gives the margins, it is the one whose largest radius is smallest.
    """
    weights = ObserverWeights()
    if not isinstance(arm, Robot):
        return weights
    places, schedule, smallest = places_of(arm, control_period), schedule_of(arm), math.inf
    for factor in SOFTENINGS:
        trial: ObserverWeights = softened(ObserverWeights(), factor)

        def observer(place: Place, trial: ObserverWeights = trial) -> LinearLaw:
            return linear_observer(place, nearest_inertia(schedule, place.q), trial)

        radius = largest_radius(places, observer, CONDITIONS)
        if radius < 1.0:
            return trial
        if radius < smallest:
            weights, smallest = trial, radius
    return weights


def softened(weights: Any, factor: float) -> Any:
    """Return `ObserverWeights` or the `AdaptiveWeights` of `adaptive.belief` softened by s = `factor`."""
    link_angle, link_velocity = factor * weights.link_angle, math.sqrt(factor) * weights.link_velocity
    return dataclasses.replace(weights, link_angle=link_angle, link_velocity=link_velocity)


def linear_observer(place: Place, designed_for: np.ndarray, weights: ObserverWeights) -> LinearLaw:
    """Return the elastic observer near rest, with gains designed for an inertia (n, n) [kg m²]; s is (x̂, d̂)⁻."""
    robot, joints = place.robot, len(place.robot)
    part, state = estimate_parts(joints), state_part(joints)
    K, L = _both_gains(robot, place.control_period, weights, designed_for)
    A, B = place.plant()  # what the observer predicts with
    measured = np.eye(len(A))[np.r_[part.q_motor, part.dq_motor]]
    acts = np.zeros((joints, len(A)))  # u = acts (x̂, d̂)
    acts[:, state] = -K
    acts[:, part.load] = -np.eye(joints) - K[:, part.q_motor] / per_joint_of(robot, "stiffness")
    from_plant, from_memory = L @ measured[:, state], np.eye(len(A)) - L @ measured
    predicts = A + B @ acts
    return LinearLaw(acts @ from_plant, acts @ from_memory, predicts @ from_plant, predicts @ from_memory)
