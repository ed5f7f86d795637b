"""Output feedback on the elastic arm: an observer of the hidden link side, and a state feedback to the elastic target.

What every policy sees of the arm is the motors, y = (θ, θ̇) with noise. The observer estimates x = (θ, q, θ̇, q̇), motors
and links, and a torque d on the links that nobody told it of (a tip force, a payload), taken for a random walk:

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L (y - (θ̂, θ̂̇)⁻),
    act       u = u_ff - d̂ - K (x̂ - x_d),      x_d = (θ_d - K_t⁻¹ d̂, q_d, θ̇_d, q̇_d),
    predict   (x̂, d̂)⁻ = what the nominal elastic arm, friction and stick included, does of (x̂, d̂) under u.

θ_d and u_ff are those of `elastic_target`; K_t⁻¹ d̂ is how much less the joints have to bend where d̂ carries the links.
The prediction is under the torque that was really applied, within the limits, so nothing winds up at a limit.

K and L solve the discrete Riccati equations of the linearised arm, held over a control period. Gravity's slope, the
Coriolis torques and dry friction are left out of the linearisation, so it depends on cos q2 alone; the gains are
tabulated over it and interpolated. Integral action is in d̂: a constant torque on the links leaves no error at the tip.
"""

from __future__ import annotations

import copy
import dataclasses
import numbers

import numpy as np
from numba.extending import register_jitable
from scipy.linalg import expm, solve_discrete_are

from fuzzyarm.envs.arguments import whole_substeps
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import Arm, State, arm_constants, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.integrator import kick_twice
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws import elastic_target
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget
from fuzzyarm.fuzzy_policy.policy import Policy

GRID = np.linspace(-1.0, 1.0, 9)  # cos q2 of the gain tables
STATE, LOAD = slice(0, 8), slice(8, 10)  # x in the order of `State`, and d
MEASURED = [0, 1, 4, 5]  # θ and θ̇ in x
WEIGHT_RANGE = (1e-6, 1e6)  # far beyond what makes sense; keeps the numbers finite
STATICS_STEPS = 20  # of the fixed-point iteration for the first estimate; each gains three digits on Table 1


@dataclasses.dataclass(frozen=True)
class ObserverWeights:
    """The weights of both Riccati equations.

    The first four defaults are the choice of ``python benchmarks/observer_tuning.py``: the smallest tip error over
    random arms within margins. The last two are the encoder noise of the README's examples.

    Torques are shares of the arm's `torque_limit`, joint by joint, so that the same weights fit arms of another size.

    Attributes:
        link_angle: link error [rad] that is worth the whole torque, weight 1/link_angle² against 1/Γ_max².
        link_velocity: link velocity error [rad/s] that is worth the whole torque.
        load_walk: random walk of d, share of the torque limit per √s.
        motor_torque: white noise of the motor torque, share of the torque limit times √s. More of it makes the loop
            with the observer more robust (loop transfer recovery).
        encoder_angle: standard deviation of the measured angle [rad]; only its ratio to the other noises counts.
        encoder_velocity: standard deviation of the measured velocity [rad/s].

    Raises:
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
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
            low, high = WEIGHT_RANGE
            if not (is_number and low <= value <= high):
                raise ValueError(
                    f"ObserverWeights.{field.name} = {value!r} is out of range; allowed: [{low:g}, {high:g}]"
                )


def sampled_arm(parameters: ArmParameters, control_period: float, cos2: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A (10, 10) and B (10, 2) of (x, d)⁺ = A (x, d) + B u over one control period, u held, d constant.

    At rest, without gravity and dry friction, at cos q2 = `cos2`:
    I_a θ̈ = u - Γ_t - f_v θ̇,  M_b q̈ = Γ_t + d,  Γ_t = K_t (θ - q) + B_t (θ̇ - q̇).
    """
    m11, m12, m22 = mass_matrix(cos2, arm_constants(parameters))
    links = np.linalg.inv([[m11, m12], [m12, m22]])
    motors = np.diag(1.0 / np.array(parameters.motor_inertia))
    stiffness, damping = np.diag(parameters.stiffness), np.diag(parameters.damping)
    joint_torque = np.hstack([stiffness, -stiffness, damping, -damping])
    rate = np.zeros((12, 12))  # of (x, d, u)
    rate[0:4, 4:8] = np.eye(4)
    rate[4:6, STATE], rate[4:6, 10:12] = -motors @ joint_torque, motors
    rate[4:6, 4:6] -= motors @ np.diag(parameters.viscous_friction)
    rate[6:8, STATE], rate[6:8, LOAD] = links @ joint_torque, links
    moved = expm(rate * control_period)
    return moved[:10, :10], moved[:10, 10:]


def feedback_gain(A: np.ndarray, B: np.ndarray, torque_limit: np.ndarray, weights: ObserverWeights) -> np.ndarray:
    """Return K (2, 8) that minimises Σ |q/link_angle|² + |q̇/link_velocity|² + |u/Γ_max|² of `sampled_arm`, d = 0."""
    a, b = A[STATE, STATE], B[STATE]
    Q = np.diag(np.repeat([0.0, weights.link_angle**-2, 0.0, weights.link_velocity**-2], 2))
    R = np.diag(torque_limit**-2)
    P = solve_discrete_are(a, b, Q, R)
    gain: np.ndarray = np.linalg.solve(R + b.T @ P @ b, b.T @ P @ a)
    return gain


def observer_gain(
    A: np.ndarray, B: np.ndarray, control_period: float, torque_limit: np.ndarray, weights: ObserverWeights
) -> np.ndarray:
    """Return L (10, 4), the stationary Kalman gain of `sampled_arm` that corrects (x̂, d̂) by what is measured now."""
    C = np.eye(10)[MEASURED]
    Q = B @ np.diag((weights.motor_torque * torque_limit) ** 2) @ B.T / control_period
    Q[LOAD, LOAD] += np.diag((weights.load_walk * torque_limit) ** 2) * control_period
    R = np.diag(np.repeat([weights.encoder_angle**2, weights.encoder_velocity**2], 2))
    P = solve_discrete_are(A.T, C.T, Q, R)
    gain: np.ndarray = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return gain


def gain_tables(
    parameters: ArmParameters, control_period: float, weights: ObserverWeights
) -> tuple[np.ndarray, np.ndarray]:
    """Return K (9, 2, 8) and L (9, 10, 4) at cos q2 = `GRID`.

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


class ElasticObserverPolicy(Policy):
    """Observer, state feedback and elastic target; see the module for the law.

    Its memory: that of `ElasticTarget`, whether there was a sample before, and the prediction (x̂, d̂)⁻.
    """

    memory_size = elastic_target.MEMORY_SIZE + 11

    def __init__(
        self,
        parameters: ArmParameters | None = None,
        control_period: float = 1e-3,
        weights: ObserverWeights | None = None,
    ) -> None:
        """Design the gains.

        Args:
            parameters: the arm, as the controller knows it.
            control_period: T [s], at most 0.1 s.
            weights: of the Riccati equations.

        Raises:
            ValueError: the control period is out of range, or there are no gains for these arguments.
        """
        super().__init__(parameters or ArmParameters(), control_period)
        self.weights, self._substeps = weights or ObserverWeights(), whole_substeps(control_period, None)
        self.feedback, self.observer = gain_tables(self.parameters, control_period, self.weights)
        self._know(self.parameters)

    def without_dry_friction(self) -> ElasticObserverPolicy:
        """Return this policy, with the same gains, for the same arm without dry friction."""
        smooth = copy.copy(self)
        smooth._know(dataclasses.replace(self.parameters, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0)))
        return smooth

    def estimate(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x̂ (..., 8) [rad, rad/s] and d̂ (..., 2) [N m] for the next sample, from a state that `predict` gave."""
        predicted = np.asarray(state)[..., elastic_target.MEMORY_SIZE + 1 :]
        return predicted[..., STATE], predicted[..., LOAD]

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        target, own = np.empty((len(observation), 6)), elastic_target.MEMORY_SIZE
        self._target.advance(observation, memory[:, :own], target, torque)
        _observe_and_act(observation, target, memory[:, own:], torque, *self._arguments)

    def _know(self, parameters: ArmParameters) -> None:
        """Take `parameters` for the arm that moves; the gains stay."""
        self.parameters = parameters
        self._target = ElasticTarget(parameters, self.control_period)
        arm, substep = arm_constants(parameters), self.control_period / self._substeps
        self._arguments = (self.feedback, self.observer, arm, self._torque_limit, substep, self._substeps)


@kernel
def _observe_and_act(
    observation: np.ndarray,
    target: np.ndarray,
    memory: np.ndarray,
    torque: np.ndarray,
    feedback: np.ndarray,
    observer: np.ndarray,
    arm: Arm,
    torque_limit: np.ndarray,
    h: float,
    substeps: int,
) -> None:
    """Correct, act and predict in every lane; `torque` holds u_ff and becomes u, unclipped."""
    stiffness = (arm.stiffness1, arm.stiffness2)
    innovation, error = np.empty(4), np.empty(8)
    for lane in range(len(observation)):
        o, t, x = observation[lane], target[lane], memory[lane, 1:]
        if memory[lane, 0] == 0.0:
            memory[lane, 0] = 1.0
            _begin(o, x, arm)
        place = 0.5 * (np.cos(o[1]) + 1.0) * (len(feedback) - 1)
        left = min(max(int(place), 0), len(feedback) - 2)  # min and max also for a cosine that is no number
        share = place - left
        for i in range(2):
            innovation[i], innovation[2 + i] = o[i] - x[i], o[2 + i] - x[4 + i]
        for i in range(10):
            for k in range(4):
                gain = (1.0 - share) * observer[left, i, k] + share * observer[left + 1, i, k]
                x[i] += gain * innovation[k]
        for i in range(2):
            error[i] = x[i] - (t[i] - x[8 + i] / stiffness[i])
            error[2 + i] = x[2 + i] - o[4 + i]
            error[4 + i] = x[4 + i] - t[2 + i]
            error[6 + i] = x[6 + i] - o[6 + i]
        for i in range(2):
            torque[lane, i] -= x[8 + i]
            for k in range(8):
                gain = (1.0 - share) * feedback[left, i, k] + share * feedback[left + 1, i, k]
                torque[lane, i] -= gain * error[k]
        applied1 = min(max(torque[lane, 0], -torque_limit[0]), torque_limit[0])
        applied2 = min(max(torque[lane, 1], -torque_limit[1]), torque_limit[1])
        state = State(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7])
        for _ in range(substeps):
            state = _loaded_step(state, applied1, applied2, x[8], x[9], arm, h)
        for i in range(8):
            x[i] = state[i]


@register_jitable
def _begin(o: np.ndarray, x: np.ndarray, arm: Arm) -> None:
    """Fill the first (x̂, d̂)⁻: K_t (θ - q) = g(q) for the measured θ, links as fast as motors, d = 0."""
    x[0], x[1], x[2], x[3], x[8], x[9] = o[0], o[1], o[0], o[1], 0.0, 0.0
    for _ in range(STATICS_STEPS):
        gravity1, gravity2 = gravity_torque(np.sin(x[2]), np.sin(x[2] + x[3]), arm)
        x[2], x[3] = o[0] - gravity1 / arm.stiffness1, o[1] - gravity2 / arm.stiffness2
    x[4], x[5], x[6], x[7] = o[2], o[3], o[2], o[3]


@register_jitable
def _loaded_step(state: State, torque1: float, torque2: float, load1: float, load2: float, arm: Arm, h: float) -> State:
    """Do what `integrator.step` does, with torques [N m] on the links in place of a tip force."""
    half = 0.5 * h
    motor1, motor2 = state.motor1 + half * state.motor_velocity1, state.motor2 + half * state.motor_velocity2
    link1, link2 = state.link1 + half * state.link_velocity1, state.link2 + half * state.link_velocity2
    sin1, cos1 = sine_cosine(link1)
    sin2, cos2 = sine_cosine(link2)
    gravity1, gravity2 = gravity_torque(sin1, sin1 * cos2 + cos1 * sin2, arm)
    outer1, outer2 = load1 - gravity1, load2 - gravity2
    middle = State(motor1, motor2, link1, link2, state[4], state[5], state[6], state[7])
    after: State = kick_twice(state, middle, torque1, torque2, outer1, outer2, sin2, cos2, arm, h)
    return after
