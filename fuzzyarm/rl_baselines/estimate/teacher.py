"""The teacher: regulator and target of the student's observers, for the true state, plant and load.

    u* = u_ff - d - ½ T ḋ - K (x - x_d),    x_d = (θ_d - K_t⁻¹ (d - B_t K_t⁻¹ ḋ), q_d, θ̇_d - K_t⁻¹ ḋ, q̇_d),

with u_ff and θ_d of `elastic_target` for the plant as it is, payload included, the load d = Jᵀ F of the links by the
force F, and its rate ḋ from a control period before to one after. Without ḋ the motors follow a force too late. What
the student lacks of u* is what it has to learn. K is that of the second, stiffer observer in lanes whose torques are on
time, and that of the first one in the others. Elementwise over lanes.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.batch.layout import CLOCK
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.dynamics import Arm, rigid_inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import columns
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, gain_tables
from fuzzyarm.learned_policy.estimate.policy import QUICK
from fuzzyarm.rl_baselines.estimate.courses import Courses

__all__ = ["Teacher"]

_STATES = 4 * JOINTS
_ROW = columns(row_record(JOINTS, JOINTS))


class Teacher:
    """The labels of the lanes of `Courses`.

    Args:
        arm: as the student knows it.
        courses: the lanes.
    """

    def __init__(self, arm: ArmParameters, courses: Courses) -> None:
        """Take the gains that the student's observers have."""
        lanes = courses.lanes
        self._lanes, self._arm, self._period = lanes, arm, lanes.period
        soft, stiff = (gain_tables(arm, lanes.period, weights).feedback for weights in (ObserverWeights(), QUICK))
        self._feedback = np.stack([soft, stiff])
        self._stiff = (courses.delay == 0.0).astype(np.int64)
        self._limit = np.array(arm.torque_limit)
        self._past = np.zeros((3, lanes.count, JOINTS))
        self._smooth = np.zeros((lanes.count, JOINTS))
        self._fresh = np.ones(lanes.count, dtype=bool)

    def begin(self, which: np.ndarray) -> None:
        """Forget the past of the lanes whose episodes begin; shape of `which` (lanes,), no unit."""
        self._fresh[which] = True

    def torque(self, observation: np.ndarray) -> np.ndarray:
        """Return u* (lanes, 2) [N m], within its limits, before the step for observations (lanes, 10)."""
        o = observed(observation)
        q, dq, ddq = o.q_reference, o.dq_reference, o.ddq_reference
        arm, state = self._plants(), self._lanes.numbers(slice(_STATES)).T
        tau = rigid_inverse_dynamics(q, dq, ddq, arm)
        motion, motor, smooth = self._target(dq, ddq, tau, arm)
        before, load, after = (self._load(ahead) for ahead in (-1, 0, 1))
        rate = (after - before) / (2.0 * self._period)
        k, damping = np.stack([arm.stiffness1, arm.stiffness2], 1), np.stack([arm.damping1, arm.damping2], 1)
        desired = np.hstack([q + motion - (load - damping / k * rate) / k, q, motor - rate / k, dq])
        place = 0.5 * (np.cos(state[:, 1]) + 1.0) * (self._feedback.shape[1] - 1)
        left = np.clip(place.astype(np.int64), 0, self._feedback.shape[1] - 2)
        share = (place - left)[:, np.newaxis, np.newaxis]
        gain = (1.0 - share) * self._feedback[self._stiff, left] + share * self._feedback[self._stiff, left + 1]
        fed_back = np.einsum("lij,lj->li", gain, state - desired)
        wanted: np.ndarray = np.clip(smooth - load - 0.5 * self._period * rate - fed_back, -self._limit, self._limit)
        return wanted

    def _plants(self) -> Arm:
        """Return the constants of every lane's arm as it is, payload included."""
        return Arm(*self._lanes.numbers(columns(self._lanes.layout.Lane).arm))

    def _load(self, ahead: int) -> np.ndarray:
        """Return Jᵀ F (lanes, 2) [N m] so many control periods from now, within the episode, on the reference."""
        clock, lanes = self._lanes.clock, self._lanes
        rows = lanes.arrays[2][np.clip(clock[CLOCK.row] + ahead, clock[CLOCK.first], clock[CLOCK.last])]
        mean, change = np.split(rows[:, _ROW.force], 2, axis=1)
        force = lanes.numbers(columns(lanes.layout.Lane).force_factor).T * (mean - 0.5 * change)
        jacobian = tip_jacobian(rows[:, _ROW.reference][:, :JOINTS], self._arm.length)
        load: np.ndarray = np.einsum("lai,la->li", jacobian, force)
        return load

    def _target(
        self, dq: np.ndarray, ddq: np.ndarray, tau: np.ndarray, arm: Arm
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return θ_d - q_d, θ̇_d and u_ff, each (lanes, 2), for torques τ_d (lanes, 2); as `ElasticTarget` does."""
        fresh, period = self._fresh, self._period
        self._past[:, fresh] = tau[fresh]
        latest, second, third = self._past
        rate = (11.0 * tau - 18.0 * latest + 9.0 * second - 2.0 * third) / (6.0 * period)
        curvature = (2.0 * tau - 5.0 * latest + 4.0 * second - third) / (period * period)
        self._past = np.stack([tau, latest, second])
        k, damping = np.stack([arm.stiffness1, arm.stiffness2], 1), np.stack([arm.damping1, arm.damping2], 1)
        b = damping / k
        velocity, acceleration = dq + (rate - b * curvature) / k, ddq + curvature / k
        inertia, viscous = (
            np.stack([arm.motor_inertia1, arm.motor_inertia2], 1),
            np.stack([arm.viscous1, arm.viscous2], 1),
        )
        smooth = inertia * acceleration + viscous * velocity + tau
        before = np.where(fresh[:, np.newaxis], smooth, self._smooth)
        self._smooth = smooth
        middle = velocity + 0.5 * period * acceleration
        coulomb, static = np.stack([arm.coulomb1, arm.coulomb2], 1), np.stack([arm.static1, arm.static2], 1)
        slip = stribeck_magnitude(middle, coulomb, static, arm.stribeck_velocity[:, np.newaxis]) * np.sign(middle)
        self._fresh = np.zeros(len(fresh), dtype=bool)
        return (tau - b * (rate - b * curvature)) / k, velocity, smooth + 0.5 * (smooth - before) + slip
