"""The law of a controller of the form "semidefinite": as a policy, and in plain NumPy for states in lanes.

    u = M̄(q) q̈_d + C(q, q̇) q̇ + f_v q̇ + g(q) - M̂(q) (k_p e + k_d ė + k_i x_I),      M̄ = M + R,

with e = q - q_d, ė = q̇ - q̇_d, x_I = ∫ e dt. On the rigid arm M̄(q) ë = -M̂(q) (k_p e + k_d ė + k_i x_I) + d. The speed
in the Coriolis torques is the measured one, so that they leave no term in the error's equation. The policy measures q
and q̇ at the motors.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_columns, in_list, reader
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw, spread_of
from fuzzyarm.fuzzy_policy.known_arm import constants_of, drives_in, drives_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, state_part
from fuzzyarm.fuzzy_policy.laws.sampled_margins import LinearLaw, Place
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.proof.policy_certificate import PolicyCertificate
from fuzzyarm.fuzzy_policy.proof.scheduled_certificate import scheduled_policy_certificate
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController

__all__ = ["ScheduledPolicy", "linear_scheduled"]


class ScheduledPolicy(Policy):
    """The law of a controller file as a policy; it is in the module's docstring.

    Attributes:
        controller: the content of the file.
    """

    integral_at: int | None = 0

    def __init__(self, controller: ScheduledController, control_period: float = 1e-3) -> None:
        """Lay the controller out for the compiled law of its robot, at a control period T [s].

        Raises:
            TypeError: the controller is of another form, or the control period is no number.
            ValueError: the control period is out of range.
        """
        super().__init__(instance("controller", controller, ScheduledController).robot, control_period)
        self.controller = controller
        premises = controller.premises
        self._arguments = (
            constants_of(controller.robot),
            drives_of(controller.robot),
            np.array([premise.joint for premise in premises], dtype=np.int64),
            np.array([premise.turns for premise in premises], dtype=np.float64),
            np.array([premise.function.startswith("sin") for premise in premises], dtype=np.bool_),
            np.ascontiguousarray(controller.inertia),
            np.ascontiguousarray(controller.feedback),
            self.control_period,
        )

    def certificate(self, reference: Reference) -> PolicyCertificate:
        """Return what is proven of the controller, which is the same for every reference."""
        return scheduled_policy_certificate(self.controller)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        self._law(observation, memory, torque, *self._arguments)

    def compiled(self) -> CompiledLaw:
        """Return the law for compiled loops."""
        return CompiledLaw("scheduled", spread_of(self._law), self._arguments)

    @functools.cached_property
    def _law(self) -> Any:
        return _law_of(equations_of(self.controller.robot))


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the compiled law for robots with these equations."""
    joints, dynamics = physics.joints, physics.inverse_dynamics
    arm_in, per_joint = reader(physics.Arm, in_list), reader(physics.PerJoint, in_columns)

    @kernel_for(physics.digest)
    def scheduled_law(
        observation: np.ndarray,
        integral: np.ndarray,
        torque: np.ndarray,
        constants: np.ndarray,
        drives: np.ndarray,
        kept: np.ndarray,
        turns: np.ndarray,
        sine: np.ndarray,
        inertia: np.ndarray,
        gains: np.ndarray,
        period: float,
    ) -> None:
        """Evaluate the law for every lane and advance its integral; premise l is a cosine or sine of turns q_kept."""
        arm, drive, o = arm_in(constants, 0), drives_in(drives), observed(observation)
        k_p, k_d, k_i = gains[0], gains[1], gains[2]
        wanted, ratio = np.empty(joints), np.empty(len(kept))
        for lane in range(len(observation)):
            for joint in range(joints):
                error = o.q_motor[lane, joint] - o.q_reference[lane, joint]
                error_rate = o.dq_motor[lane, joint] - o.dq_reference[lane, joint]
                wanted[joint] = k_p * error + k_d * error_rate + k_i * integral[lane, joint]
                integral[lane, joint] += period * error
            q, dq = per_joint(o.q_motor, lane), per_joint(o.dq_motor, lane)
            links = dynamics(q, dq, per_joint(o.ddq_reference, lane), arm)
            for joint in range(joints):
                motor = drive.motor_inertia[joint] * o.ddq_reference[lane, joint]
                torque[lane, joint] = links[joint] + motor + drive.viscous_friction[joint] * o.dq_motor[lane, joint]
            for place in range(len(kept)):
                sin, cos = sine_cosine(turns[place] * o.q_motor[lane, kept[place]])
                ratio[place] = 0.5 * (1.0 + (sin if sine[place] else cos))
            for rule in range(len(inertia)):
                h = 1.0
                for place in range(len(kept)):  # the first premise changes fastest with the rule
                    h *= ratio[place] if (rule >> place) & 1 else 1.0 - ratio[place]
                for joint in range(joints):
                    for other in range(joints):
                        torque[lane, joint] -= h * inertia[rule, joint, other] * wanted[other]

    return scheduled_law


def linear_scheduled(controller: ScheduledController, place: Place) -> LinearLaw:
    """Return the law near rest, at a posture of its robot; its memory is x_I."""
    joints, (k_p, k_d, k_i) = len(place.robot), controller.feedback
    part, inertia = estimate_parts(joints), controller.inertia_at(place.q)
    D, G = np.zeros((2, joints, state_part(joints).stop))
    D[:, part.q_motor] = -k_p * inertia
    D[:, part.dq_motor] = -k_d * inertia + np.diag(place.robot.drive("viscous_friction"))
    G[:, part.q_motor] = place.control_period * np.eye(joints)
    return LinearLaw(D, -k_i * inertia, G, np.eye(joints))
