"""`learned-observer`: the elastic observer at rest, the adaptive observer in motion, and a network that corrects it.

Two laws run beside each other on the same measurements. With (x̂, d̂), K, L, x_d and u_ff of `elastic_observer`, the
torque u_a of `adaptive.policy`, m and g of `network`, and the network ρ,

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L ν,    ν = y - (θ̂, θ̂̇)⁻,    and the filter of the adaptive observer by y,
    act       u_o = u_ff - d̂ - K (x̂ - x_d),    u_b = u_o + m g (u_a - u_o),    u = u_b + R ρ(z, c, h),
    predict   (x̂, d̂)⁻ and the filter's prediction under u within its limits.

At rest m = 0, and without a load g is next to 0: there the elastic observer acts alone, whose loop is locally stable
without knowing of late torques and wrong loop gains. In motion under a load the adaptive observer takes over, which
knows of loads within milliseconds. Both are told of the torque that is applied. Where its filter has diverged, u_a is
u_o. z and c are those of `signals`, R the torques there. The network was trained by regression on a teacher that knows
plant, load and lateness, see `fuzzyarm.rl_baselines.estimate`.
"""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import in_columns, in_list, reader
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.known_arm import constants_of
from fuzzyarm.fuzzy_policy.laws.adaptive.law import steps_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import KEPT, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy, Beliefs
from fuzzyarm.fuzzy_policy.laws.adaptive.room import room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget, memory_size
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, gain_tables
from fuzzyarm.fuzzy_policy.laws.observer_steps import act_of, begin_of, correct_of, estimated_of, predict_of
from fuzzyarm.fuzzy_policy.laws.observer_weights import weights_for
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.estimate.network import EstimateNetwork, heard, respond
from fuzzyarm.learned_policy.estimate.signals import (
    CONTEXT,
    UNEXPLAINED,
    see_beliefs,
    see_context,
    see_innovation,
    see_unexplained,
    units_of,
)

__all__ = ["SEEN", "SEEN_PARTS", "LearnedObserverPolicy"]

_TARGET, _STARTED, _PREDICTED, _RESIDUAL, _FILTER = consecutive(
    memory_size(JOINTS), 1, estimate_parts(JOINTS).load.stop, JOINTS, 1
)

SEEN_PARTS = consecutive(UNEXPLAINED, CONTEXT, JOINTS)
"""Where z, c and u_b [N m] lie in what `observe` gives."""

SEEN: int = SEEN_PARTS[-1].stop
"""Numbers that `LearnedObserverPolicy.observe` gives."""


class _Known(NamedTuple):
    """What the kernel takes of the elastic observer: gains, their schedule, and the arm."""

    feedback: Any
    observer: Any
    kept: Any
    cosine: Any
    points: Any
    constants: Any
    stiffness: Any
    torque_limit: Any
    length: Any
    substep: Any
    substeps: Any
    units: Any


class LearnedObserverPolicy(Policy):
    """The law of the module's docstring; it remembers what both laws do, the last ρ, and h.

    Attributes:
        network: ρ.
        adaptive: the law of u_a.
        filter: where its memory lies in a lane's.
        hidden: where h lies in a lane's memory.
    """

    def __init__(
        self, network: EstimateNetwork, parameters: ArmParameters | None = None, control_period: float = 1e-3
    ) -> None:
        """Design the gains of both laws.

        Args:
            network: ρ.
            parameters: the arm, as the policy knows it.
            control_period: T [s].

        Raises:
            ValueError: the control period is out of range, or there are no gains for these arguments.
        """
        arm = ArmParameters() if parameters is None else instance("parameters", parameters, ArmParameters)
        super().__init__(arm, control_period)
        self.parameters: ArmParameters = arm
        self.network, self.adaptive = network, AdaptiveObserverPolicy(arm, control_period)
        self.filter, self.hidden = consecutive(_FILTER.start, self.adaptive.memory.noise.stop, network.hidden)[1:]
        self.memory_size = self.hidden.stop
        self._target, substeps = ElasticTarget(arm, self.control_period), whole_substeps(control_period, None)
        schedule, feedback, observer = gain_tables(arm, self.control_period, weights_for(arm, self.control_period))
        self._known = _Known(
            feedback,
            observer,
            *(schedule.kept, schedule.cosine, schedule.points),
            *(constants_of(arm), np.array(arm.stiffness), self._torque_limit, np.array(arm.length)),
            *(self.control_period / substeps, substeps),
            units_of(arm),
        )

    def with_network(self, network: EstimateNetwork) -> LearnedObserverPolicy:
        """Return this policy with another network of as many numbers in h."""
        other = copy.copy(self)
        other.network = network
        return other

    def without_dry_friction(self) -> ElasticObserverPolicy:
        """Return what acts at rest, where m is 0 whatever is measured: the elastic observer, for a smooth arm."""
        return ElasticObserverPolicy(self.parameters, self.control_period).without_dry_friction()

    def beliefs(self, state: np.ndarray) -> Beliefs:
        """Return what its adaptive observer believes at the next sample, from a state (..., memory_size) of `predict`.

        Where that one's filter has diverged, the elastic observer and the network act.
        """
        return self.adaptive.beliefs(np.asarray(state)[..., self.filter])

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        self.observe(observation, memory, torque, np.empty((len(observation), SEEN)))

    def observe(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, seen: np.ndarray) -> None:
        """Do what `act` does, and fill `seen` (lanes, `SEEN`) with what the network saw, see `SEEN_PARTS`."""
        target = np.empty((len(observation), self._target.size))
        self._target.advance(observation, memory[:, _TARGET], target, torque)
        _observe_and_act(
            *(observation, target, memory, torque, seen),
            *(self.adaptive.settings, self._known, self.filter.start, self.hidden.start),
            *self.network.arguments,
        )


_PHYSICS = two_joints()
_ARM_IN, _PER_JOINT = reader(_PHYSICS.Arm, in_list), reader(_PHYSICS.PerJoint, in_columns)
_ESTIMATED, _BEGIN, _PREDICT = estimated_of(JOINTS), begin_of(_PHYSICS), predict_of(_PHYSICS)
_CORRECT, _ACT = correct_of(JOINTS), act_of(JOINTS)
_ESTIMATE_ADAPTIVE, _PREDICT_ADAPTIVE = steps_of(_PHYSICS)
_Z, _C, _BASE = SEEN_PARTS


@kernel
def _observe_and_act(
    observation: np.ndarray,
    target: np.ndarray,
    memory: np.ndarray,
    torque: np.ndarray,
    seen: np.ndarray,
    settings: Settings,
    k: _Known,
    first_filter: int,
    first_hidden: int,
    of_z: np.ndarray,
    of_h: np.ndarray,
    of_c: np.ndarray,
    bias: np.ndarray,
    V: np.ndarray,
    G: np.ndarray,
    D: np.ndarray,
    W: np.ndarray,
) -> None:
    """Correct, act and predict in every lane; `torque` holds u_ff and becomes u, unclipped."""
    arm, o = _ARM_IN(k.constants, 0), observed(observation)
    started, predicted, residual = memory[:, _STARTED], memory[:, _PREDICTED], memory[:, _RESIDUAL]
    load, room, axes = _ESTIMATED(predicted).load, room_for(settings), len(settings.reopening) - 1
    innovation, error, applied = np.empty(2 * JOINTS), np.empty(4 * JOINTS), np.empty((1, JOINTS))
    adaptive, gap, known = np.empty(JOINTS), np.empty(JOINTS), np.zeros((KEPT + 1, axes))
    index, weight = np.empty(1 << len(k.kept), dtype=np.int64), np.empty(1 << len(k.kept))
    for lane in range(len(observation)):
        if started[lane, 0] == 0.0:
            started[lane, 0] = 1.0
            _BEGIN(lane, o.q_motor, o.dq_motor, predicted, k.stiffness, arm)
        m = remembered(memory[lane, first_filter:], JOINTS, len(settings.guess), axes + 1)
        z, c, h = seen[lane, _Z], seen[lane, _C], memory[lane, first_hidden:]
        see_context(lane, o, torque[lane], k.torque_limit, k.length, c)
        see_innovation(lane, o, m, innovation, z)
        _ESTIMATE_ADAPTIVE(lane, o, m, settings, room, known, adaptive)
        place_in_schedule(o.q_motor[lane], k.kept, k.cosine, k.points, index, weight)
        _CORRECT(lane, o, predicted, k.observer, index, weight, innovation)
        _ACT(lane, o, target, predicted, k.stiffness, k.feedback, index, weight, error, torque)
        for i in range(JOINTS):
            gap[i] = adaptive[i] - torque[lane, i] if np.isfinite(adaptive[i]) else 0.0
        see_unexplained(innovation, load[lane], gap, residual[lane], k.units, z)
        see_beliefs(m, settings, k.units, z, c)
        share = heard(z, c)
        for i in range(JOINTS):
            torque[lane, i] += share * gap[i]
            seen[lane, _BASE][i] = torque[lane, i]
        respond(z, c, h, gap, k.units.torque, residual[lane], of_z, of_h, of_c, bias, V, G, D, W)
        for i in range(JOINTS):
            torque[lane, i] += k.units.torque[i] * residual[lane, i]
            applied[0, i] = m.commands[0, i] = min(max(torque[lane, i], -k.torque_limit[i]), k.torque_limit[i])
        _PREDICT(predicted, lane, _PER_JOINT(applied, 0), _PER_JOINT(load, lane), arm, k.substep, k.substeps)
        _PREDICT_ADAPTIVE(m, settings, room, adaptive)
