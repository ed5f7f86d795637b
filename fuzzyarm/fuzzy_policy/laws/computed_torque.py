"""Computed torque on the rigid model, the classical alternative to the fuzzy policy.

    u = M(q) (q̈_d - 3ω ė - 3ω² e - ω³ x_I) + C(q, q̇) q̇ + g(q) + f_v q̇,      e = q_a - q_d,   x_I = ∫ e dt,

M includes the motor inertias, and q and q̇ are measured at the motors. The rigid arm's loop has a triple pole at -ω.
"""

import functools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import numbers_of
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy
from fuzzyarm.fuzzy_policy.laws import observer_gains
from fuzzyarm.fuzzy_policy.laws.observer_gains import ONE_AT_A_TIME, LinearLaw, Place, worst_radius

__all__ = ["ComputedTorquePolicy", "bandwidth_for"]

_BANDWIDTH = 70.0  # default ω [rad/s] of a two-joint arm, and the largest one of a robot
STEP = 5.0  # between two trial bandwidths [rad/s]


class ComputedTorquePolicy(LawPolicy):
    """Computed torque with integral action; the law is in the module's docstring."""

    integral_at: int | None = 0

    def __init__(
        self, parameters: AnyArm | None = None, control_period: float = 1e-3, bandwidth: float | None = None
    ) -> None:
        """Prepare the law for an arm (default Table 1), a period [s] and ω [rad/s] (default: see `bandwidth_for`)."""
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        chosen = bandwidth_for(self.parameters, self.control_period) if bandwidth is None else bandwidth
        self.bandwidth = real("bandwidth", chosen, "rad/s", above=0.0)

    @functools.cached_property
    def control_law(self) -> Law:
        """The computed-torque law; its memory is x_I."""
        arm, drives = numbers_of(self.parameters)
        constants = self.bandwidth, self.control_period, arm, drives
        return Law(_law_of(equations_of(self.parameters)), (0.0,) * self.joints, constants)


@functools.lru_cache(maxsize=32)
def bandwidth_for(arm: AnyArm, control_period: float) -> float:
    """Return the default bandwidth ω [rad/s] for an arm and a control period [s].

    The value for the two-joint arm was chosen by ``python benchmarks/computed_torque_tuning.py`` (commit 2839bc83): the
    largest that stays stable with twice the loop gain and with one sample of delay. The same rule applies to a robot at
    random postures of its range: the largest of 70, 65, ..., 5 rad/s that is stable, or else 5 rad/s.
    """
    if not isinstance(arm, Robot):
        return _BANDWIDTH
    places, bandwidth = observer_gains.places_of(arm, control_period), _BANDWIDTH
    while bandwidth > STEP and any(
        worst_radius(place, _linear_computed_torque(place, bandwidth), ONE_AT_A_TIME) >= 1.0 for place in places
    ):
        bandwidth -= STEP
    return bandwidth


def _linear_computed_torque(place: Place, bandwidth: float) -> LinearLaw:
    """Return computed torque with a bandwidth [rad/s], linearised near rest at a posture; its memory is x_I."""
    inertia = place.inertia + np.diag(place.robot.drive("motor_inertia"))
    return observer_gains.linear_pid(place, inertia, 3.0 * bandwidth**2, 3.0 * bandwidth, bandwidth**3)


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the law for arms with these equations; its constants are ω [rad/s], T [s], the links and the motors."""

    def computed_torque(x_I: Any, seen: Observation, constants: Any) -> tuple[Any, Any]:
        (w, period, arm, drives), asked, after = constants, [], []
        for q, dq, q_d, dq_d, ddq_d, x in zip(*seen, x_I, strict=True):
            e, de = q - q_d, dq - dq_d
            asked.append(ddq_d - w * (3.0 * de + w * (3.0 * e + w * x)))
            after.append(x + period * e)
        links = physics.inverse_dynamics(seen.q_motor, seen.dq_motor, physics.PerJoint(*asked), arm)
        I_a, f_v = drives.motor_inertia, drives.viscous_friction
        torque = (u + i * a + f * v for u, i, a, f, v in zip(links, I_a, asked, f_v, seen.dq_motor, strict=True))
        return tuple(after), tuple(torque)

    return computed_torque
