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
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.compiled import kernel, kernel_for
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import BLOCK, in_columns, in_list, reader
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw
from fuzzyarm.fuzzy_policy.known_arm import (
    constants_of,
    per_joint_of,
    without_dry_friction,
)
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget, memory_size
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    ObserverWeights,
    estimate_parts,
    gain_tables,
    state_part,
)
from fuzzyarm.fuzzy_policy.laws.observer_steps import act_of, begin_of, correct_of, prediction_of
from fuzzyarm.fuzzy_policy.laws.observer_weights import weights_for
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["ElasticObserverPolicy"]


class ElasticObserverPolicy(Policy):
    """Observer, state feedback and elastic target; the law is in the module's docstring.

    It remembers what `ElasticTarget` does, whether there was a sample before, and the prediction (x̂, d̂)⁻.

    Attributes:
        weights: of the Riccati equations.
        feedback: K (points, n, 4 n) at the points of the schedule.
        observer: L (points, 5 n, 2 n), likewise.
        load: where d̂ lies in a lane's memory.
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
        self._substeps = default_substeps(self.control_period, fastest_rate([self.parameters]))
        self._schedule, self.feedback, self.observer = gain_tables(self.parameters, self.control_period, self.weights)
        self._target_part, self._started, self._predicted = _memory_parts(self.joints)
        self.memory_size = self._predicted.stop
        self.load = slice(self._predicted.stop - self.joints, self._predicted.stop)
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

    def compiled(self) -> CompiledLaw:
        """Return the law for compiled loops."""
        advance, of_target = self._target.compiled
        act = _compiled_of(equations_of(self.parameters), advance, self._law)
        return CompiledLaw("elastic_observer", act, (of_target, self._arguments))

    def act_beside(self, observation: np.ndarray, memory: np.ndarray, extra: np.ndarray, torque: np.ndarray) -> None:
        """Do what `act` does, with `extra` (lanes, n) [N m] added to u, of which the prediction knows."""
        target = np.empty((len(observation), self._target.size))
        self._target.advance(observation, memory[:, self._target_part], target, torque)
        torque += extra
        self._law(observation, target, memory, torque, *self._arguments)

    def innovation(self, observation: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Return ν = y - (θ̂, θ̂̇)⁻ (lanes, 2 n) [rad, rad/s] before `act`; 0 where an episode begins."""
        predicted, found = memory[:, self._predicted], np.empty((len(observation), 2 * self.joints))
        velocities = predicted[:, estimate_parts(self.joints).dq_motor]
        _innovation(observation, memory[:, self._started], predicted, velocities, found)
        return found

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


@kernel
def _innovation(
    observation: np.ndarray, started: np.ndarray, angles: np.ndarray, velocities: np.ndarray, innovation: np.ndarray
) -> None:
    """Fill ν (lanes, 2 n) from what is predicted of the motors; the first n `angles` are theirs."""
    joints = velocities.shape[1]
    for lane in range(len(observation)):
        for i in range(joints):
            if started[lane, 0] == 0.0:
                innovation[lane, i] = innovation[lane, joints + i] = 0.0
            else:
                innovation[lane, i] = observation[lane, i] - angles[lane, i]
                innovation[lane, joints + i] = observation[lane, joints + i] - velocities[lane, i]


def _memory_parts(joints: int) -> list[slice]:
    """Return where the target's memory, the flag of a sample before, and (x̂, d̂)⁻ lie in a lane's memory."""
    return consecutive(memory_size(joints), 1, estimate_parts(joints).load.stop)


@functools.cache
def _compiled_of(physics: Physics, advance: Any, law: Any) -> Any:
    """Return `ElasticObserverPolicy.act` for compiled loops, of the target's function and the law's."""
    target_part, target_size = _memory_parts(physics.joints)[0], 3 * physics.joints

    @register_jitable
    def act(observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, arguments: Any) -> None:
        of_target, own = arguments
        target = np.empty((len(observation), target_size))
        advance(observation, memory[:, target_part], target, torque, *of_target)
        law(observation, target, memory, torque, *own)

    return act


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the compiled law for arms with these equations."""
    joints, (_, started_part, predicted_part) = physics.joints, _memory_parts(physics.joints)
    arm_in, per_joint = reader(physics.Arm, in_list), reader(physics.PerJoint, in_columns)
    begin, correct, act = begin_of(physics), correct_of(joints), act_of(joints)
    room_size, put, advance, take = prediction_of(physics)

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
        innovation, error = np.empty(2 * joints), np.empty(4 * joints)
        index, weight = np.empty(1 << len(kept), dtype=np.int64), np.empty(1 << len(kept))
        applied, room = np.empty((1, joints)), np.empty(room_size)
        for first in range(0, len(observation), BLOCK):
            lanes = min(BLOCK, len(observation) - first)
            for place in range(lanes):
                lane = first + place
                if started[lane, 0] == 0.0:
                    started[lane, 0] = 1.0
                    begin(lane, o.q_motor, o.dq_motor, predicted, stiffness, arm)
                place_in_schedule(o.q_motor[lane], kept, cosine, points, index, weight)
                correct(lane, o, predicted, observer, index, weight, innovation)
                act(lane, o, target, predicted, stiffness, feedback, index, weight, error, torque)
                for i in range(joints):
                    applied[0, i] = min(max(torque[lane, i], -torque_limit[i]), torque_limit[i])
                put(room, place, predicted, lane, per_joint(applied, 0))
            advance(room, lanes, arm, h, substeps)
            for place in range(lanes):
                take(room, place, predicted, first + place)

    return observe_and_act
