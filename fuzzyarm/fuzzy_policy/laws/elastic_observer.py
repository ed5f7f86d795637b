"""Output feedback on the elastic arm: an observer of the hidden link side, and a state feedback to the elastic target.

Every policy measures only the motors, y = (θ, θ̇) with noise. The observer estimates x = (θ, q, θ̇, q̇), motors
and links, and an unknown torque d on the links (a tip force, a payload), modelled as a random walk:

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L (y - (θ̂, θ̂̇)⁻),
    act       u = u_ff - d̂ - K (x̂ - x_d),      x_d = (θ_d - K_t⁻¹ d̂, q_d, θ̇_d, q̇_d),
    predict   (x̂, d̂)⁻ = what the nominal elastic arm, friction and stick included, does of (x̂, d̂) under u.

θ_d and u_ff are those of `elastic_target`; K_t⁻¹ d̂ is the bending that the joints need not provide because d̂ supports
the links. The prediction uses the torque within its limits, which is what the motors apply, so nothing winds up at a
limit.

K and L are tabulated by `observer_gains` over the angles of `gain_schedule` and interpolated. The integral action is in
d̂: a constant torque on the links leaves no error at the tip.
"""

from __future__ import annotations

import copy
import functools
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_columns, in_list, reader, writer
from fuzzyarm.fuzzy_policy.known_arm import (
    constants_of,
    per_joint_of,
    without_dry_friction,
)
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget, memory_size, target_parts
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    Estimate,
    ObserverWeights,
    estimate_parts,
    gain_tables,
    state_part,
)
from fuzzyarm.fuzzy_policy.laws.observer_weights import weights_for
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["ElasticObserverPolicy"]

STATICS_STEPS = 20  # iterations of the fixed point for the first estimate; for Table 1 each gains three digits


class ElasticObserverPolicy(Policy):
    """Observer, state feedback and elastic target; the law is in the module's docstring.

    It remembers what `ElasticTarget` does, whether there was a sample before, and the prediction (x̂, d̂)⁻.

    Attributes:
        weights: of the Riccati equations.
        feedback: K (points, n, 4 n) at the points of the schedule.
        observer: L (points, 5 n, 2 n), likewise.
    """

    def __init__(
        self,
        parameters: AnyArm | None = None,
        control_period: float = 1e-3,
        weights: ObserverWeights | None = None,
    ) -> None:
        """Design the gains.

        Args:
            parameters: the arm or the robot, as the controller knows it.
            control_period: T [s], at most 0.1 s.
            weights: of the Riccati equations; None for those of `observer_weights.weights_for`.

        Raises:
            ValueError: the control period is out of range, or there are no gains for these arguments.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        self.weights = weights or weights_for(self.parameters, self.control_period)
        self._substeps = whole_substeps(control_period, None)
        self._schedule, self.feedback, self.observer = gain_tables(self.parameters, self.control_period, self.weights)
        self._target_part, _, self._predicted = _memory_parts(self.joints)
        self.memory_size = self._predicted.stop
        self._know(self.parameters)

    def without_dry_friction(self) -> ElasticObserverPolicy:
        """Return this policy, with the same gains, for the same arm without dry friction."""
        smooth = copy.copy(self)
        smooth._know(without_dry_friction(self.parameters))
        return smooth

    def estimate(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x̂ (..., 4 n) [rad, rad/s] and d̂ (..., n) [N m] for the next sample, from a state of `predict`."""
        predicted = np.asarray(state)[..., self._predicted]
        return predicted[..., state_part(self.joints)], predicted[..., estimate_parts(self.joints).load]

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        target = np.empty((len(observation), self._target.size))
        self._target.advance(observation, memory[:, self._target_part], target, torque)
        self._law(observation, target, memory, torque, *self._arguments)

    @functools.cached_property
    def _law(self) -> Any:
        return _law_of(equations_of(self.parameters))

    def _know(self, parameters: AnyArm) -> None:
        """Take `parameters` for the arm that is predicted; the gains stay."""
        self.parameters = parameters
        self._target = ElasticTarget(parameters, self.control_period)
        schedule = self._schedule.kept, self._schedule.cosine, self._schedule.points
        arm, substep = constants_of(parameters), self.control_period / self._substeps
        stiffness = per_joint_of(parameters, "stiffness")
        gains = self.feedback, self.observer
        self._arguments = (*gains, *schedule, arm, stiffness, self._torque_limit, substep, self._substeps)


def _memory_parts(joints: int) -> list[slice]:
    """Return where the target's memory, the flag of a sample before, and (x̂, d̂)⁻ lie in a lane's memory."""
    return consecutive(memory_size(joints), 1, estimate_parts(joints).load.stop)


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the compiled law for arms with these equations."""
    joints, (_, started_part, predicted_part) = physics.joints, _memory_parts(physics.joints)
    theta_part, dtheta_part, _ = target_parts(physics.joints)
    arm_in, per_joint = reader(physics.Arm, in_list), reader(physics.PerJoint, in_columns)
    estimated, begin, predict = _estimated_of(joints), _begin_of(physics), _predict_of(physics)

    @kernel_for(physics.digest)
    def observe_and_act(
        observation: np.ndarray,
        target: np.ndarray,
        memory: np.ndarray,
        torque: np.ndarray,
        feedback: np.ndarray,
        observer: np.ndarray,
        kept: np.ndarray,
        cosine: bool,
        points: int,
        constants: np.ndarray,
        stiffness: np.ndarray,
        torque_limit: np.ndarray,
        h: float,
        substeps: int,
    ) -> None:
        """Correct, act and predict in every lane; `torque` holds u_ff and becomes u, unclipped."""
        arm, o = arm_in(constants, 0), observed(observation)
        started, predicted = memory[:, started_part], memory[:, predicted_part]
        theta_d, dtheta_d, estimate = target[:, theta_part], target[:, dtheta_part], estimated(predicted)
        innovation, error = np.empty(2 * joints), np.empty(4 * joints)
        index, weight = np.empty(1 << len(kept), dtype=np.int64), np.empty(1 << len(kept))
        applied = np.empty((1, joints))
        for lane in range(len(observation)):
            if started[lane, 0] == 0.0:
                started[lane, 0] = 1.0
                begin(lane, o.q_motor, o.dq_motor, predicted, stiffness, arm)
            place_in_schedule(o.q_motor[lane], kept, cosine, points, index, weight)
            for i in range(joints):
                innovation[i] = o.q_motor[lane, i] - estimate.q_motor[lane, i]
                innovation[joints + i] = o.dq_motor[lane, i] - estimate.dq_motor[lane, i]
            _add_product(observer, index, weight, innovation, 1.0, predicted[lane])
            for i in range(joints):
                unbent = estimate.load[lane, i] / stiffness[i]
                error[i] = estimate.q_motor[lane, i] - (theta_d[lane, i] - unbent)
                error[joints + i] = estimate.q_link[lane, i] - o.q_reference[lane, i]
                error[2 * joints + i] = estimate.dq_motor[lane, i] - dtheta_d[lane, i]
                error[3 * joints + i] = estimate.dq_link[lane, i] - o.dq_reference[lane, i]
                torque[lane, i] -= estimate.load[lane, i]
            _add_product(feedback, index, weight, error, -1.0, torque[lane])
            for i in range(joints):
                applied[0, i] = min(max(torque[lane, i], -torque_limit[i]), torque_limit[i])
            predict(predicted, lane, per_joint(applied, 0), per_joint(estimate.load, lane), arm, h, substeps)

    return observe_and_act


@register_jitable
def _add_product(
    table: np.ndarray, index: np.ndarray, weight: np.ndarray, x: np.ndarray, sign: float, y: np.ndarray
) -> None:
    """Add ±G x to y (rows,), G (rows, columns) interpolated between the points `index` of a table."""
    for corner in range(len(index)):
        gain, share = table[index[corner]], sign * weight[corner]
        for i in range(gain.shape[0]):
            product = 0.0
            for k in range(gain.shape[1]):
                product += gain[i, k] * x[k]
            y[i] += share * product


@functools.cache
def _estimated_of(joints: int) -> Any:
    """Return the compiled function that gives the parts of (x, d) (..., 5 n) as views."""
    q_motor, q_link, dq_motor, dq_link, load = estimate_parts(joints)

    @register_jitable
    def estimated(array: np.ndarray) -> Estimate:
        return Estimate(
            array[..., q_motor], array[..., q_link], array[..., dq_motor], array[..., dq_link], array[..., load]
        )

    return estimated


@functools.cache
def _begin_of(physics: Physics) -> Any:
    """Return the compiled function that fills a lane's first (x̂, d̂)⁻.

    It has K_t (θ - q) = g(q) for the measured θ, links as fast as motors, d = 0.
    """
    joints, gravity, estimated = physics.joints, physics.gravity, _estimated_of(physics.joints)
    per_joint = reader(physics.PerJoint, in_columns)

    @register_jitable
    def begin(lane: int, q: np.ndarray, dq: np.ndarray, predicted: np.ndarray, stiffness: np.ndarray, arm: Any) -> None:
        x = estimated(predicted)
        for i in range(joints):
            x.q_motor[lane, i] = x.q_link[lane, i] = q[lane, i]
            x.dq_motor[lane, i] = x.dq_link[lane, i] = dq[lane, i]
            x.load[lane, i] = 0.0
        for _ in range(STATICS_STEPS):
            weight = gravity(per_joint(x.q_link, lane), arm)
            for i in range(joints):
                x.q_link[lane, i] = q[lane, i] - weight[i] / stiffness[i]

    return begin


@functools.cache
def _predict_of(physics: Physics) -> Any:
    """Return the compiled function that advances x̂ of a lane over a control period, d̂ held."""
    loaded_step = physics.loaded_step
    read_state, write_state = reader(physics.State, in_columns), writer(physics.State, in_columns)

    @register_jitable
    def predict(predicted: np.ndarray, lane: int, torque: Any, load: Any, arm: Any, h: float, substeps: int) -> None:
        state = read_state(predicted, lane)
        for _ in range(substeps):
            state = loaded_step(state, torque, load, arm, h)
        write_state(predicted, lane, state)

    return predict
