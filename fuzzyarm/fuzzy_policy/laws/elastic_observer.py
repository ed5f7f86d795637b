"""Output feedback on the elastic arm: an observer of the hidden link side, and a state feedback to the elastic target.

Every policy measures only the motors, y = (θ, θ̇) with noise. The observer estimates x = (θ, q, θ̇, q̇), motors
and links, and an unknown torque d on the links (a tip force, a payload), modelled as a random walk:

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L (y - (θ̂, θ̂̇)⁻),
    act       u = u_ff - d̂ - K (x̂ - x_d),      x_d = (θ_d - K_t⁻¹ d̂, q_d, θ̇_d, q̇_d),
    predict   (x̂, d̂)⁻ = what the nominal elastic arm, friction and stick included, does of (x̂, d̂) under u.

θ_d and u_ff are those of `elastic_target`; K_t⁻¹ d̂ is the bending that the joints need not provide because d̂ supports
the links. The prediction uses the torque within its limits, which is what the motors apply, so nothing winds up at a
limit.

K and L are tabulated over cos q2 by `observer_gains` and interpolated. The integral action is in d̂: a constant torque
on the links leaves no error at the tip.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import Arm, arm_constants, arm_in, gravity_torque
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.integrator import drifted, kick_twice
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, State, in_columns, reader, writer
from fuzzyarm.fuzzy_policy.laws import elastic_target
from fuzzyarm.fuzzy_policy.laws.elastic_target import TARGET, TARGET_SIZE, ElasticTarget
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    ESTIMATE,
    ESTIMATES,
    LOAD,
    STATE,
    STATES,
    Estimate,
    ObserverWeights,
    gain_tables,
)
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["ElasticObserverPolicy"]

_TARGET_PART, _STARTED, _PREDICTED = consecutive(elastic_target.MEMORY_SIZE, 1, ESTIMATES)  # of a lane's memory

_read_state, _write_state = reader(State, in_columns), writer(State, in_columns)

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits


class ElasticObserverPolicy(Policy):
    """Observer, state feedback and elastic target; the law is in the module's docstring.

    It remembers what `ElasticTarget` does, whether there was a sample before, and the prediction (x̂, d̂)⁻.

    Attributes:
        weights: of the Riccati equations.
        feedback: K (9, 2, 8) at cos q2 = `GRID`.
        observer: L (9, 10, 4), likewise.
    """

    memory_size = _PREDICTED.stop

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
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
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
        predicted = np.asarray(state)[..., _PREDICTED]
        return predicted[..., STATE], predicted[..., LOAD]

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        target = np.empty((len(observation), TARGET_SIZE))
        self._target.advance(observation, memory[:, _TARGET_PART], target, torque)
        _observe_and_act(observation, target, memory, torque, *self._arguments)

    def _know(self, parameters: ArmParameters) -> None:
        """Take `parameters` for the arm that is predicted; the gains stay."""
        self.parameters = parameters
        self._target = ElasticTarget(parameters, self.control_period)
        arm, substep = np.array(arm_constants(parameters)), self.control_period / self._substeps
        self._arguments = (self.feedback, self.observer, arm, self._torque_limit, substep, self._substeps)


@kernel
def _observe_and_act(
    observation: np.ndarray,
    target: np.ndarray,
    memory: np.ndarray,
    torque: np.ndarray,
    feedback: np.ndarray,
    observer: np.ndarray,
    constants: np.ndarray,
    torque_limit: np.ndarray,
    h: float,
    substeps: int,
) -> None:
    """Correct, act and predict in every lane; `torque` holds u_ff and becomes u, unclipped."""
    arm = arm_in(constants, 0)
    stiffness = (arm.stiffness1, arm.stiffness2)
    o, started, predicted = observed(observation), memory[:, _STARTED], memory[:, _PREDICTED]
    theta_d, dtheta_d, estimate = target[:, TARGET.q], target[:, TARGET.dq], _estimated(predicted)
    innovation, error = np.empty(observer.shape[-1]), np.empty(STATES)
    of_motor, of_link, of_dmotor, of_dlink = _parts_of_state(error)
    for lane in range(len(observation)):
        if started[lane, 0] == 0.0:
            started[lane, 0] = 1.0
            _begin(lane, o.q_motor, o.dq_motor, predicted, arm)
        place = 0.5 * (np.cos(o.q_motor[lane, 1]) + 1.0) * (len(feedback) - 1)
        left = min(max(int(place), 0), len(feedback) - 2)  # min and max also map a cosine that is nan into the table
        share = place - left
        for i in range(JOINTS):
            innovation[i] = o.q_motor[lane, i] - estimate.q_motor[lane, i]
            innovation[JOINTS + i] = o.dq_motor[lane, i] - estimate.dq_motor[lane, i]
        for i in range(ESTIMATES):
            for k in range(len(innovation)):
                gain = (1.0 - share) * observer[left, i, k] + share * observer[left + 1, i, k]
                predicted[lane, i] += gain * innovation[k]
        for i in range(JOINTS):
            unbent = estimate.load[lane, i] / stiffness[i]
            of_motor[i] = estimate.q_motor[lane, i] - (theta_d[lane, i] - unbent)
            of_link[i] = estimate.q_link[lane, i] - o.q_reference[lane, i]
            of_dmotor[i] = estimate.dq_motor[lane, i] - dtheta_d[lane, i]
            of_dlink[i] = estimate.dq_link[lane, i] - o.dq_reference[lane, i]
        for i in range(JOINTS):
            torque[lane, i] -= estimate.load[lane, i]
            for k in range(STATES):
                gain = (1.0 - share) * feedback[left, i, k] + share * feedback[left + 1, i, k]
                torque[lane, i] -= gain * error[k]
        applied1 = min(max(torque[lane, 0], -torque_limit[0]), torque_limit[0])
        applied2 = min(max(torque[lane, 1], -torque_limit[1]), torque_limit[1])
        state, load = _read_state(predicted, lane), PerJoint(estimate.load[lane, 0], estimate.load[lane, 1])
        for _ in range(substeps):
            state = _loaded_step(state, PerJoint(applied1, applied2), load, arm, h)
        _write_state(predicted, lane, state)


@register_jitable
def _estimated(array: np.ndarray) -> Estimate:
    """Return the parts of (x, d) (..., `ESTIMATES`) as views."""
    return Estimate(
        array[..., ESTIMATE.q_motor],
        array[..., ESTIMATE.q_link],
        array[..., ESTIMATE.dq_motor],
        array[..., ESTIMATE.dq_link],
        array[..., ESTIMATE.load],
    )


@register_jitable
def _parts_of_state(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return θ, q, θ̇, q̇ of x (8,) as views."""
    return x[ESTIMATE.q_motor], x[ESTIMATE.q_link], x[ESTIMATE.dq_motor], x[ESTIMATE.dq_link]


@register_jitable
def _begin(lane: int, q: np.ndarray, dq: np.ndarray, predicted: np.ndarray, arm: Arm) -> None:
    """Fill a lane's first (x̂, d̂)⁻: K_t (θ - q) = g(q) for the measured θ, links as fast as motors, d = 0."""
    stiffness, x = (arm.stiffness1, arm.stiffness2), _estimated(predicted)
    link = x.q_link[lane]
    for i in range(JOINTS):
        x.q_motor[lane, i] = link[i] = q[lane, i]
        x.dq_motor[lane, i] = x.dq_link[lane, i] = dq[lane, i]
        x.load[lane, i] = 0.0
    for _ in range(STATICS_STEPS):
        gravity = gravity_torque(np.sin(link[0]), np.sin(link[0] + link[1]), arm)
        for i in range(JOINTS):
            link[i] = q[lane, i] - gravity[i] / stiffness[i]


@register_jitable
def _loaded_step(state: State, torque: PerJoint, load: PerJoint, arm: Arm, h: float) -> State:
    """Do what `integrator.step` does, with torques [N m] on the links in place of a tip force."""
    half = 0.5 * h
    motor, link = drifted(state.motor, state.motor_velocity, half), drifted(state.link, state.link_velocity, half)
    sin1, cos1 = sine_cosine(link.joint1)
    sin2, cos2 = sine_cosine(link.joint2)
    gravity1, gravity2 = gravity_torque(sin1, sin1 * cos2 + cos1 * sin2, arm)
    outer = PerJoint(load.joint1 - gravity1, load.joint2 - gravity2)
    middle = State(motor, link, state.motor_velocity, state.link_velocity)
    after: State = kick_twice(state, middle, torque, outer, sin2, cos2, arm, h)
    return after
