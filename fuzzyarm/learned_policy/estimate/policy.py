"""`learned-observer`: the elastic observer, and beside it a recurrent network that knows sooner what loads the arm.

With (x̂, d̂), K, L, x_d and u_ff of `elastic_observer` and the network ρ of `network`,

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L ν,    ν = y - (θ̂, θ̂̇)⁻,
    act       u_o = u_ff - d̂ - K (x̂ - x_d),    u = u_o + ρ(z, c, h) R,
    predict   (x̂, d̂)⁻ = what the nominal elastic arm does of (x̂, d̂) under u within its limits.

A second observer differs by the weights of its L and K, `QUICK`: it expects loads that change sooner, and its regulator
is stiffer. It knows of a load sooner, and by itself does not bear noise, delay and other arms. What it would do, u_q,
is seen by the network as u_q - u_o; where that exceeds all torques by far, the second one goes on from the estimate of
the first. z and c are those of `signals`, R the torques there. Both observers are told of the residual torque ρ R, so
that they do not take it for a load. The network was trained by regression on a teacher that knows plant and load, see
`fuzzyarm.rl_baselines.estimate`.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import in_columns, in_list, reader
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.known_arm import constants_of, without_dry_friction
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget, memory_size
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, estimate_parts, gain_tables
from fuzzyarm.fuzzy_policy.laws.observer_steps import act_of, begin_of, correct_of, estimated_of, predict_of
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.estimate.network import EstimateNetwork, respond
from fuzzyarm.learned_policy.estimate.signals import CONTEXT, TORQUES, UNEXPLAINED, see_context, see_unexplained

__all__ = ["QUICK", "SEEN", "SEEN_PARTS", "LearnedObserverPolicy"]

QUICK = ObserverWeights(load_walk=10.0, link_angle=0.0027, link_velocity=0.55)
"""Weights of the second observer and of its regulator."""

_LOST = 1000.0  # size of u_q - u_o, in units of R, above which the second observer has lost the arm

_ESTIMATE = estimate_parts(JOINTS).load.stop
_TARGET, _STARTED, _PREDICTED, _QUICK, _RESIDUAL, _HIDDEN = consecutive(
    memory_size(JOINTS), 1, _ESTIMATE, _ESTIMATE, JOINTS, 1
)

SEEN_PARTS = consecutive(UNEXPLAINED, CONTEXT, JOINTS)
"""Where z, c and the observer's own u [N m], without residual, lie in what `observe` gives."""

SEEN: int = SEEN_PARTS[-1].stop
"""Numbers that `LearnedObserverPolicy.observe` gives."""


class LearnedObserverPolicy(Policy):
    """The law of the module's docstring; it remembers what both observers do, the last ρ, and h.

    Attributes:
        network: ρ.
        hidden: where h lies in a lane's memory.
        gains: K and L of the observer.
        quick: those of the second one.
    """

    def __init__(
        self,
        network: EstimateNetwork,
        parameters: ArmParameters | None = None,
        control_period: float = 1e-3,
        weights: ObserverWeights | None = None,
    ) -> None:
        """Design the observer's gains.

        Args:
            network: ρ.
            parameters: the arm, as the policy knows it.
            control_period: T [s].
            weights: of the observer's Riccati equations.

        Raises:
            ValueError: the control period is out of range, or there are no gains for these arguments.
        """
        arm = ArmParameters() if parameters is None else instance("parameters", parameters, ArmParameters)
        super().__init__(arm, control_period)
        self.network = network
        self.hidden = slice(_HIDDEN.start, _HIDDEN.start + network.hidden)
        self.memory_size = self.hidden.stop
        self._substeps = whole_substeps(control_period, None)
        weights = weights or ObserverWeights()
        self.gains = gain_tables(arm, self.control_period, weights)
        self.quick = gain_tables(arm, self.control_period, QUICK)
        self._know(arm)

    def with_network(self, network: EstimateNetwork) -> LearnedObserverPolicy:
        """Return this policy with another network of as many numbers in h."""
        other = copy.copy(self)
        other.network = network
        return other

    def without_dry_friction(self) -> LearnedObserverPolicy:
        """Return this policy, with the same gains and network, for the same arm without dry friction."""
        smooth = copy.copy(self)
        smooth._know(without_dry_friction(self.parameters))  # type: ignore[arg-type]
        return smooth

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        self.observe(observation, memory, torque, np.empty((len(observation), SEEN)))

    def observe(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, seen: np.ndarray) -> None:
        """Do what `act` does, and fill `seen` (lanes, `SEEN`) with what the network saw, see `SEEN_PARTS`."""
        target = np.empty((len(observation), self._target.size))
        self._target.advance(observation, memory[:, _TARGET], target, torque)
        _observe_and_act(observation, target, memory, torque, seen, *self._arguments, *self.network.arguments)

    def _know(self, arm: ArmParameters) -> None:
        """Take `arm` for the arm that is predicted; the gains stay."""
        self.parameters: ArmParameters = arm
        self._target = ElasticTarget(arm, self.control_period)
        schedule = self.gains.schedule
        self._arguments: tuple[Any, ...] = (
            *(
                self.gains.feedback,
                self.gains.observer,
                self.quick.feedback,
                self.quick.observer,
                schedule.kept,
                schedule.cosine,
                schedule.points,
            ),
            *(constants_of(arm), np.array(arm.stiffness), self._torque_limit, np.array(arm.length)),
            *(self.control_period / self._substeps, self._substeps),
        )


_PHYSICS = two_joints()
_ARM_IN, _PER_JOINT = reader(_PHYSICS.Arm, in_list), reader(_PHYSICS.PerJoint, in_columns)
_ESTIMATED, _BEGIN, _PREDICT = estimated_of(JOINTS), begin_of(_PHYSICS), predict_of(_PHYSICS)
_CORRECT, _ACT = correct_of(JOINTS), act_of(JOINTS)
_Z, _C, _OWN = SEEN_PARTS
_FIRST_HIDDEN = _HIDDEN.start


@kernel
def _observe_and_act(
    observation: np.ndarray,
    target: np.ndarray,
    memory: np.ndarray,
    torque: np.ndarray,
    seen: np.ndarray,
    feedback: np.ndarray,
    observer: np.ndarray,
    quick_feedback: np.ndarray,
    quick_observer: np.ndarray,
    kept: np.ndarray,
    cosine: bool,
    points: int,
    constants: np.ndarray,
    stiffness: np.ndarray,
    torque_limit: np.ndarray,
    length: np.ndarray,
    h: float,
    substeps: int,
    of_z: np.ndarray,
    of_h: np.ndarray,
    of_c: np.ndarray,
    bias: np.ndarray,
    V: np.ndarray,
    D: np.ndarray,
    W: np.ndarray,
) -> None:
    """Correct, act and predict in every lane; `torque` holds u_ff and becomes u, unclipped."""
    arm, o = _ARM_IN(constants, 0), observed(observation)
    started, predicted, residual = memory[:, _STARTED], memory[:, _PREDICTED], memory[:, _RESIDUAL]
    quick = memory[:, _QUICK]
    load, quick_load = _ESTIMATED(predicted).load, _ESTIMATED(quick).load
    innovation, error, applied = np.empty(2 * JOINTS), np.empty(4 * JOINTS), np.empty((1, JOINTS))
    gap, quick_torque = np.empty(JOINTS), torque.copy()
    index, weight = np.empty(1 << len(kept), dtype=np.int64), np.empty(1 << len(kept))
    for lane in range(len(observation)):
        if started[lane, 0] == 0.0:
            started[lane, 0] = 1.0
            _BEGIN(lane, o.q_motor, o.dq_motor, predicted, stiffness, arm)
            quick[lane] = predicted[lane]
        place_in_schedule(o.q_motor[lane], kept, cosine, points, index, weight)
        z, c = seen[lane, _Z], seen[lane, _C]
        see_context(lane, o, torque[lane], torque_limit, length, c)
        _CORRECT(lane, o, quick, quick_observer, index, weight, innovation)
        _ACT(lane, o, target, quick, stiffness, quick_feedback, index, weight, error, quick_torque)
        _CORRECT(lane, o, predicted, observer, index, weight, innovation)
        _ACT(lane, o, target, predicted, stiffness, feedback, index, weight, error, torque)
        seen[lane, _OWN] = torque[lane]
        for i in range(JOINTS):
            gap[i] = quick_torque[lane, i] - torque[lane, i]
            if not abs(gap[i]) < _LOST * TORQUES[i]:
                quick[lane] = predicted[lane]
        see_unexplained(innovation, load[lane], gap, residual[lane], z)
        respond(z, c, memory[lane, _FIRST_HIDDEN:], residual[lane], of_z, of_h, of_c, bias, V, D, W)
        for i in range(JOINTS):
            torque[lane, i] += TORQUES[i] * residual[lane, i]
            applied[0, i] = min(max(torque[lane, i], -torque_limit[i]), torque_limit[i])
        _PREDICT(predicted, lane, _PER_JOINT(applied, 0), _PER_JOINT(load, lane), arm, h, substeps)
        _PREDICT(quick, lane, _PER_JOINT(applied, 0), _PER_JOINT(quick_load, lane), arm, h, substeps)
