"""The law of a controller of the form "semidefinite", see `fuzzy_policy.scheduled_controller`, as a policy.

The Coriolis torques are computed from the measured velocity, so that they leave no term in the error's equation. The
policy measures q and q̇ at the motors.
"""

import functools
from typing import Any

from fuzzyarm.common.checks import instance
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.known_arm import numbers_of
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import LinearLaw, Place, linear_pid
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController

__all__ = ["ScheduledPolicy", "linear_scheduled"]


class ScheduledPolicy(LawPolicy):
    """The law of a `ScheduledController` as a policy; see `fuzzy_policy.scheduled_controller`."""

    integral_at: int | None = 0

    def __init__(self, controller: ScheduledController, control_period: float = 1e-3) -> None:
        """Store the controller and T [s], which must be in range; TypeError for a controller of another form."""
        super().__init__(instance("controller", controller, ScheduledController).robot, control_period)
        self.controller = controller

    @functools.cached_property
    def control_law(self) -> Law:
        """The law of `fuzzy_policy.scheduled_controller`; its memory is x_I."""
        own, (arm, drives) = self.controller, numbers_of(self.controller.robot)
        premises = tuple((one.joint, float(one.turns), one.function.startswith("sin")) for one in own.premises)
        inertia = tuple(tuple(tuple(map(float, row)) for row in rule) for rule in own.inertia)
        constants = arm, drives, inertia, tuple(map(float, own.feedback)), self.control_period
        return Law(_law_of(equations_of(own.robot), premises), (0.0,) * self.joints, constants)


@functools.cache
def _law_of(physics: Physics, premises: tuple[tuple[int, float, bool], ...]) -> Any:
    """Return the law for robots with these equations; a premise (joint, turns, is_sine) is sin or cos turns · q_joint.

    The law's constants are the links, the motors, M̂ of each rule [kg m²], (k_p, k_d, k_i), and T [s].
    """

    def scheduled(x_I: Any, seen: Observation, constants: Any) -> tuple[Any, Any]:
        arm, drives, rules, (k_p, k_d, k_i), period = constants
        wanted, after = [], []
        for q, dq, q_d, dq_d, _, x in zip(*seen, x_I, strict=True):
            e, de = q - q_d, dq - dq_d
            wanted.append(k_p * e + k_d * de + k_i * x)
            after.append(x + period * e)
        links = physics.inverse_dynamics(seen.q_motor, seen.dq_motor, seen.ddq_reference, arm)
        I_a, f_v = drives.motor_inertia, drives.viscous_friction
        motors = zip(links, I_a, seen.ddq_reference, f_v, seen.dq_motor, strict=True)
        torque = [u + i * a + f * v for u, i, a, f, v in motors]
        ratio = []
        for joint, turns, is_sine in premises:
            sine, cosine = sine_cosine(turns * seen.q_motor[joint])
            ratio.append(0.5 * (1.0 + (sine if is_sine else cosine)))
        for rule, inertia in enumerate(rules):
            h = 1.0
            for place, share in enumerate(ratio):  # the first premise changes fastest with the rule
                h = h * (share if (rule >> place) & 1 else 1.0 - share)
            for joint, row in enumerate(inertia):
                for m, w in zip(row, wanted, strict=True):
                    torque[joint] = torque[joint] - h * m * w
        return tuple(after), tuple(torque)

    return scheduled


def linear_scheduled(controller: ScheduledController, place: Place) -> LinearLaw:
    """Return the controller's law linearised near rest at the posture `place`; its memory is x_I."""
    return linear_pid(place, controller.inertia_at(place.q), *controller.feedback.tolist())
