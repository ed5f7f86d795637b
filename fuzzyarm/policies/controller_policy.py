"""A controller or its file as a policy: of the robot that it was designed for, with every inequality proven again."""

from __future__ import annotations

import os
from pathlib import Path

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.physics.equations import AnyArm, chosen_arm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController, load_controller
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.proof.certificate import Certificate, certify

__all__ = ["controller_policy", "file_policy"]

_SHOWN = 12  # digits of a digest that messages show


def file_policy(path: Path, robot: AnyArm, control_period: float, allow_unproven: bool = False) -> Policy:
    """Return the policy of a controller file of any form for T [s], once it is proven, see `load_policy`."""
    return _policy(str(path), load_controller(path), robot, control_period, allow_unproven)


def controller_policy(
    controller: Controller | ScheduledController,
    robot: AnyArm | str | os.PathLike[str] | None,
    control_period: float,
    allow_unproven: bool = False,
) -> Policy:
    """Return the policy of a controller of any form for T [s], without a robot for the one that it was designed for."""
    if not isinstance(controller, Controller | ScheduledController):
        raise TypeError(f"a policy is a name, a path or a controller; {type(controller).__name__} was given")
    designed = controller.model.parameters if isinstance(controller, Controller) else controller.robot
    arm = designed if robot is None else chosen_arm(robot, None)
    return _policy("the controller", controller, arm, control_period, allow_unproven)


def _policy(
    name: str, controller: Controller | ScheduledController, robot: AnyArm, control_period: float, allow_unproven: bool
) -> Policy:
    if isinstance(controller, Controller):
        _check_arm(name, controller, robot)
        if not allow_unproven:
            _check_proven(name, certify(controller))
        return FuzzyPolicy(controller, control_period)
    # The generated equations and the proof of this form are loaded where a file needs them.
    from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
    from fuzzyarm.proof.scheduled_certificate import certify_scheduled

    _check_robot(name, controller, robot)
    if not allow_unproven:
        _check_proven(name, certify_scheduled(controller))
    return ScheduledPolicy(controller, control_period)


def _check_arm(name: str, controller: Controller, robot: AnyArm) -> None:
    if not isinstance(robot, ArmParameters):
        raise ControllerFileError(
            f"{name} was designed for the two-joint arm, not for {robot.name}: take computed-torque or "
            "elastic-observer, or design one with fuzzyarm design --robot"
        )
    if controller.model.parameters != robot:
        designed_for = controller.model.parameters.to_dict()
        differing = [key for key, value in robot.to_dict().items() if designed_for[key] != value]
        raise ControllerFileError(
            f"{name} was designed for another robot ({', '.join(differing)} differ): pass robot=, or design it again "
            "with fuzzyarm design --robot FILE"
        )


def _check_robot(name: str, controller: ScheduledController, arm: AnyArm) -> None:
    designed, given = controller.robot, robot_of(arm)
    if designed.digest != given.digest:
        raise ControllerFileError(
            f"{name} was designed for the robot {shown(designed.name)} ({designed.digest[:_SHOWN]}), not for "
            f"{shown(given.name)} ({given.digest[:_SHOWN]}): give the one that it was designed for (robot=, --robot), "
            "or design one for the other with fuzzyarm design --robot"
        )


def _check_proven(name: str, certificate: Certificate) -> None:
    failed = [claim.name for claim in certificate.claims if not claim.proven]
    if failed:
        raise ControllerFileError(
            f"{name} is not proven ({len(failed)} inequalities fail, first: {failed[0]}): it was changed after "
            "its design, or never held; load_policy(..., allow_unproven=True) takes it all the same"
        )
