"""A controller file as a policy: of the robot that it was designed for, with every inequality proven anew."""

from __future__ import annotations

from pathlib import Path

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.controller_files import load_controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.proof.certificate import Certificate, certify
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError

__all__ = ["controller_policy"]

_SHOWN = 12  # digits of a digest that messages show


def controller_policy(path: Path, robot: AnyArm, control_period: float, allow_unproven: bool = False) -> Policy:
    """Return the policy of a controller file of any form.

    Args:
        path: of the file.
        robot: the arm the policy is for.
        control_period: time between two calls of `predict` [s].
        allow_unproven: take a file whose inequalities are not all proven, for experiments.

    Raises:
        ControllerFileError: the file is damaged, not proven, or was designed for another robot.
        OSError: the file cannot be read.
    """
    controller = load_controller(path)
    if isinstance(controller, Controller):
        _check_arm(path, controller, robot)
        if not allow_unproven:
            _check_proven(path, certify(controller))
        return FuzzyPolicy(controller, control_period)
    # The generated equations and the proof of this form are loaded where a file needs them.
    from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
    from fuzzyarm.fuzzy_policy.proof.scheduled_certificate import certify_scheduled

    _check_robot(path, controller, robot)
    if not allow_unproven:
        _check_proven(path, certify_scheduled(controller))
    return ScheduledPolicy(controller, control_period)


def _check_arm(path: Path, controller: Controller, robot: AnyArm) -> None:
    if not isinstance(robot, ArmParameters):
        raise ControllerFileError(
            f"{path} was designed for the two-joint arm, not for {robot.name}: take computed-torque or "
            "elastic-observer, or design one with fuzzyarm design --robot"
        )
    if controller.model.parameters != robot:
        designed_for = controller.model.parameters.to_dict()
        differing = [key for key, value in robot.to_dict().items() if designed_for[key] != value]
        raise ControllerFileError(
            f"{path} was designed for another robot ({', '.join(differing)} differ): pass robot=, or design it anew "
            "with fuzzyarm design --robot FILE"
        )


def _check_robot(path: Path, controller: ScheduledController, arm: AnyArm) -> None:
    designed, given = controller.robot, robot_of(arm)
    if designed.digest != given.digest:
        raise ControllerFileError(
            f"{path} was designed for the robot {shown(designed.name)} ({designed.digest[:_SHOWN]}), not for "
            f"{shown(given.name)} ({given.digest[:_SHOWN]}): give the one that it was designed for (robot=, --robot), "
            "or design one for the other with fuzzyarm design --robot"
        )


def _check_proven(path: Path, certificate: Certificate) -> None:
    failed = [claim.name for claim in certificate.claims if not claim.proven]
    if failed:
        raise ControllerFileError(
            f"{path} is not proven ({len(failed)} inequalities fail, first: {failed[0]}): it was changed after "
            "its design, or never held; load_policy(..., allow_unproven=True) takes it all the same"
        )
