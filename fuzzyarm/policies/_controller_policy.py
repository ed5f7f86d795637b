"""Policies from controllers and controller files, for the robot of the design; loading repeats the proof."""

import os
from pathlib import Path

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.physics.equations import AnyArm, chosen_arm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController, load_controller
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.proof.certificate import certify

__all__ = ["controller_policy"]


def controller_policy(
    given: Path | Controller | ScheduledController,
    robot: AnyArm | str | os.PathLike[str] | None,
    control_period: float,
    allow_unproven: bool = False,
) -> Policy:
    """Return the policy of a controller, or of its file, after proving its inequalities; see `load_policy`.

    The policy is for `robot` (None: the robot for which the controller was designed) and a control period [s].
    """
    name, controller = (str(given), load_controller(given)) if isinstance(given, Path) else ("the controller", given)
    if not isinstance(controller, Controller | ScheduledController):
        raise TypeError(f"a policy must be a name, a path or a controller, not {type(controller).__name__}")
    designed = controller.model.parameters if isinstance(controller, Controller) else controller.robot
    _check_arm(name, designed, designed if robot is None else chosen_arm(robot, None))
    if isinstance(controller, Controller):
        certificate = None if allow_unproven else certify(controller)
        policy: Policy = FuzzyPolicy(controller, control_period)
    else:
        # The generated equations and the proof of this form are loaded only for a file that needs them.
        from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
        from fuzzyarm.proof.scheduled_certificate import certify_scheduled

        certificate = None if allow_unproven else certify_scheduled(controller)
        policy = ScheduledPolicy(controller, control_period)
    failed = [claim.name for claim in certificate.claims if not claim.proven] if certificate else []
    if failed:
        raise ControllerFileError(
            f"{name} is not proven (failed inequalities: {len(failed)}, the first: {failed[0]}): it was changed after "
            "its design, or was never valid; design it again (load_policy(..., allow_unproven=True) needs no proof)"
        )
    return policy


def _check_arm(name: str, designed: AnyArm, arm: AnyArm) -> None:
    if not isinstance(designed, ArmParameters):
        own, given = robot_of(designed), robot_of(arm)
        if own.digest != given.digest:
            raise ControllerFileError(
                f"{name} was designed for the robot {shown(own.name)} ({own.digest[:12]}), not for {shown(given.name)} "
                f"({given.digest[:12]}): give the robot that it was designed for (robot=, --robot), or design a "
                "controller for this robot with fuzzyarm design --robot"
            )
    elif not isinstance(arm, ArmParameters):
        raise ControllerFileError(
            f"{name} was designed for the two-joint arm, not for {arm.name}: use computed-torque or "
            "elastic-observer, or design a controller with fuzzyarm design --robot"
        )
    elif designed != arm:
        values = designed.to_dict()
        differing = [key for key, value in arm.to_dict().items() if values[key] != value]
        raise ControllerFileError(
            f"{name} was designed for another robot (different: {', '.join(differing)}): give that robot (robot=, "
            "--robot), or design a controller for this one with fuzzyarm design --robot FILE"
        )
