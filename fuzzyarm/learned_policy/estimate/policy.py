"""`learned-observer`: the elastic observer at rest, the adaptive observer in motion, and a network that corrects it.

Two laws run beside each other on the same measurements. With (x̂, d̂), K, L, x_d and u_ff of `elastic_observer`, the
torque u_a of `adaptive.policy`, m and g of `network`, and the network ρ,

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L ν,    ν = y - (θ̂, θ̂̇)⁻,    and the filter of the adaptive observer by y,
    act       u_o = u_ff - d̂ - K (x̂ - x_d),    u_b = u_o + m g (u_a - u_o),    u = u_b + R ρ(z, c, h),
    predict   (x̂, d̂)⁻ and the filter's prediction under u within its limits.

At rest m = 0, and without a load g is next to 0: there the elastic observer acts alone, whose loop is locally stable
without knowing of late torques and wrong loop gains. In motion under a load the adaptive observer takes over, which
knows of loads within milliseconds. Both are told of the torque that is applied. u_a counts up to four torque limits;
where its filter has diverged, or the commands swing from limit to limit (`AdaptiveWeights.largest_swing`), u = u_o. z
and c are those of `signals`, R the torques there. The network was trained by regression on a teacher that knows plant,
load and lateness, see `fuzzyarm.rl_baselines.estimate`.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_columns, in_list, reader
from fuzzyarm.fuzzy_policy.known_arm import constants_of, per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.law import steps_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, KEPT, remembered
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy, Beliefs
from fuzzyarm.fuzzy_policy.laws.adaptive.robot_weights import adaptive_weights_for
from fuzzyarm.fuzzy_policy.laws.adaptive.room import room_for
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget, memory_size
from fuzzyarm.fuzzy_policy.laws.gain_schedule import place_in_schedule
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, gain_tables
from fuzzyarm.fuzzy_policy.laws.observer_steps import act_of, begin_of, correct_of, estimated_of, predict_of
from fuzzyarm.fuzzy_policy.laws.observer_weights import weights_for
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.estimate.network import EstimateNetwork, Layers, residual_of
from fuzzyarm.learned_policy.estimate.signals import context_parts, signals_of, unexplained_parts
from fuzzyarm.learned_policy.estimate.units import turns_of, units_of

__all__ = ["LearnedObserverPolicy", "SeenParts", "seen_parts"]


# Of the adaptive observer, as the networks know it: at rest the elastic one acts, so that it needs no soft start.
_WEIGHTS = {"first_gain": 1.0, "scale_doubt": 3e-3}
_FARTHEST = 4.0  # torque limits, of u_a: that of a filter which is about to diverge would be any number


class SeenParts(NamedTuple):
    """Where z, c and u_b [N m] lie in what `LearnedObserverPolicy.observe` gives."""

    z: slice
    c: slice
    base: slice


@functools.cache
def seen_parts(physics: Physics) -> SeenParts:
    """Return these places for arms with these equations."""
    joints, axes = physics.joints, physics.axes
    return SeenParts(
        *consecutive(unexplained_parts(joints, axes).belief.stop, context_parts(joints, axes).motion.stop, joints)
    )


class _MemoryParts(NamedTuple):
    """Where the memory of the elastic target, a flag of a sample before, (x̂, d̂)⁻ and the last ρ lie; then a filter."""

    target: slice
    started: slice
    predicted: slice
    residual: slice


def _memory_parts(joints: int) -> _MemoryParts:
    return _MemoryParts(*consecutive(memory_size(joints), 1, estimate_parts(joints).load.stop, joints))


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
    turns: Any
    substep: Any
    substeps: Any
    units: Any


class LearnedObserverPolicy(Policy):
    """The law of the module's docstring; it remembers what both laws do, the last ρ, and h.

    Attributes:
        network: ρ.
        adaptive: the law of u_a.
        seen: where the parts of what `observe` gives lie.
        filter: where its memory lies in a lane's.
        hidden: where h lies in a lane's memory.
    """

    def __init__(
        self, network: EstimateNetwork, parameters: AnyArm | None = None, control_period: float = 1e-3
    ) -> None:
        """Design the gains of both laws.

        Args:
            network: ρ.
            parameters: the arm or the robot, as the policy knows it.
            control_period: T [s].

        Raises:
            ValueError: the control period is out of range, there are no gains for these arguments, or the network is
                for another number of joints or axes.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        arm, physics = self.parameters, equations_of(self.parameters)
        if (network.joints, network.axes) != (physics.joints, physics.axes):
            raise ValueError(
                f"the network is for {network.joints} joints and a tip in {network.axes} axes, the arm has "
                f"{physics.joints} and {physics.axes}"
            )
        weights = dataclasses.replace(adaptive_weights_for(arm, self.control_period), **_WEIGHTS)
        self.network, self.adaptive = network, AdaptiveObserverPolicy(arm, control_period, weights)
        self.seen, self._parts = seen_parts(physics), _memory_parts(self.joints)
        first = self._parts.residual.stop
        self.filter, self.hidden = consecutive(first, self.adaptive.memory.noise.stop, network.hidden)[1:]
        self.memory_size = self.hidden.stop
        self._target = ElasticTarget(arm, self.control_period)
        substeps = default_substeps(self.control_period, fastest_rate([arm]))
        schedule, feedback, observer = gain_tables(arm, self.control_period, weights_for(arm, self.control_period))
        self._known = _Known(
            feedback,
            observer,
            *(schedule.kept, schedule.cosine, schedule.points),
            *(constants_of(arm), per_joint_of(arm, "stiffness"), self._torque_limit, turns_of(arm)),
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

        Where that one's filter has diverged, or the commands have swung, the elastic observer acts alone.

        Raises:
            TypeError: the state holds something else than real numbers.
            ValueError: it has another shape.
        """
        return self.adaptive.beliefs_of(self.checked_state(state)[..., self.filter])

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        self.observe(observation, memory, torque, np.empty((len(observation), self.seen.base.stop)))

    def observe(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, seen: np.ndarray) -> None:
        """Do what `act` does, and fill `seen` (lanes, numbers of `SeenParts`) with what the network saw."""
        target = np.empty((len(observation), self._target.size))
        self._target.advance(observation, memory[:, self._parts.target], target, torque)
        self._law(
            *(observation, target, memory, torque, seen),
            *(self.adaptive.settings, self._known, self.filter.start, self.hidden.start),
            self.network.layers,
        )

    @functools.cached_property
    def _law(self) -> Any:
        return _law_of(equations_of(self.parameters))


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the compiled law for arms with these equations."""
    joints, (at_z, at_c, at_base) = physics.joints, seen_parts(physics)
    _, started_part, predicted_part, residual_part = _memory_parts(joints)
    arm_in, per_joint = reader(physics.Arm, in_list), reader(physics.PerJoint, in_columns)
    begin, correct, act = begin_of(physics), correct_of(joints), act_of(joints)
    estimated, predict, (heard, respond) = estimated_of(joints), predict_of(physics), residual_of(joints, physics.axes)
    correct_adaptive, act_adaptive, predict_adaptive = steps_of(physics)
    see_innovation, see_unexplained, see_beliefs, see_context = signals_of(physics)

    @kernel_for(physics.digest)
    def observe_and_act(
        observation: np.ndarray,
        target: np.ndarray,
        memory: np.ndarray,
        torque: np.ndarray,
        seen: np.ndarray,
        settings: Settings,
        k: _Known,
        first_filter: int,
        first_hidden: int,
        layers: Layers,
    ) -> None:
        """Correct, act and predict in every lane; `torque` holds u_ff and becomes u, unclipped."""
        arm, o = arm_in(k.constants, 0), observed(observation)
        started, predicted, residual = memory[:, started_part], memory[:, predicted_part], memory[:, residual_part]
        load, room, axes = estimated(predicted).load, room_for(settings), len(settings.reopening) - 1
        innovation, error, applied = np.empty(2 * joints), np.empty(4 * joints), np.empty((1, joints))
        adaptive, gap, known = np.empty(joints), np.empty(joints), np.zeros((KEPT + 1, axes))
        index, weight = np.empty(1 << len(k.kept), dtype=np.int64), np.empty(1 << len(k.kept))
        for lane in range(len(observation)):
            if started[lane, 0] == 0.0:
                started[lane, 0] = 1.0
                begin(lane, o.q_motor, o.dq_motor, predicted, k.stiffness, arm)
            m = remembered(memory[lane, first_filter:], joints, len(settings.guess), axes + 1)
            z, c, h = seen[lane, at_z], seen[lane, at_c], memory[lane, first_hidden:]
            see_context(lane, o, torque[lane], k.torque_limit, k.turns, arm, k.units, c)
            see_innovation(lane, o, m, k.units, innovation, z)
            correct_adaptive(lane, o, m, settings, room)
            act_adaptive(room.acted, m, settings, room, known, adaptive)
            place_in_schedule(o.q_motor[lane], k.kept, k.cosine, k.points, index, weight)
            correct(lane, o, predicted, k.observer, index, weight, innovation)
            act(lane, o, target, predicted, k.stiffness, k.feedback, index, weight, error, torque)
            for i in range(joints):
                far = _FARTHEST * k.torque_limit[i]
                aim = min(max(adaptive[i], -far), far)
                gap[i] = aim - torque[lane, i] if np.isfinite(adaptive[i]) else 0.0
            see_unexplained(innovation, load[lane], gap, residual[lane], k.units, z)
            see_beliefs(m, settings, k.units, z, c)
            share = heard(z, c)
            for i in range(joints):
                torque[lane, i] += share * gap[i]
                seen[lane, at_base][i] = torque[lane, i]
            respond(z, c, h, gap, k.units.torque, residual[lane], layers)
            for i in range(joints):
                if m.flags[FLAG.lost] != 0.0:
                    residual[lane, i] = 0.0
                torque[lane, i] += k.units.torque[i] * residual[lane, i]
                applied[0, i] = m.commands[0, i] = min(max(torque[lane, i], -k.torque_limit[i]), k.torque_limit[i])
            predict(predicted, lane, per_joint(applied, 0), per_joint(load, lane), arm, k.substep, k.substeps)
            predict_adaptive(m, settings, room, adaptive)

    return observe_and_act
