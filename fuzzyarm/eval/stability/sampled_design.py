"""Designs with stability margins on the sampled elastic arm, and changes to arm or period that would give them."""

from collections.abc import Iterator, Sequence

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.stability._linearisation import Linearisable, largest_radius, linearise_path
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, with_drives
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController
from fuzzyarm.policies import load_policy
from fuzzyarm.synthesis import Design, DesignFailed, Specification, design
from fuzzyarm.synthesis.specification import gamma_for

__all__ = ["first_with_margins", "why_unstable"]

_CONDITIONS = ((2.0, 0.0), (1.0, 1.0))  # factor on the loop gain and samples of delay
_FACTORS = (2.0, 4.0, 8.0, 16.0)  # on a parameter of the arm


def first_with_margins(
    candidates: Sequence[Specification], arm: ArmParameters, control_period: float, ends: Sequence[AnyArm] = ()
) -> Design:
    """Return the first design whose loop on the sampled elastic arm tolerates twice its gain and one sample of delay.

    The loop on each arm in `ends`, at the ends of ranges, must tolerate the same. If no design qualifies, the last one
    that exists is returned; a single candidate is not measured. `control_period` is in [s].

    Raises:
        DesignFailed: there is no design for any candidate; the message concerns the first.
    """
    found = None
    for wanted in candidates:
        try:
            found = design(wanted, arm, explain=len(candidates) == 1)
        except DesignFailed:
            if len(candidates) == 1:
                raise
            continue
        policy = _policy(found.controller, control_period)
        if len(candidates) == 1 or all(_bears(policy, plant, control_period) for plant in (arm, *ends)):
            break
    return design(candidates[0], arm) if found is None else found  # or its error, which states why there is no design


def why_unstable(controller: Controller | ScheduledController, arm: AnyArm, control_period: float) -> str:
    """Return in words which changes, and how large, would each give a controller the margins of `first_with_margins`.

    One parameter is changed at a time, with the gains unchanged: the control period [s], the rotors, the springs or the
    torque limits. The text names no change if none suffices alone.
    """

    def enough() -> Iterator[str]:
        for name, words in {"motor_inertia": "rotors", "stiffness": "springs", "torque_limit": "torque limits"}.items():
            for factor in _FACTORS:
                numbers = factor * per_joint_of(arm, name)
                changed = with_drives(arm, **{name: numbers})
                if _bears(_policy(controller, control_period), changed, control_period):
                    listed = ", ".join(f"{number:.3g}" for number in numbers)
                    yield f"{words} {factor:g} times as large, {name} = [{listed}]"
                    break
        for factor in _FACTORS:
            period = control_period / factor
            if _bears(_policy(controller, period), arm, period):
                yield f"a control period of {1e3 * period:g} ms"
                break

    ways, text = " or ".join(enough()), ""
    if isinstance(controller, Controller) and controller.form == "consistent":
        usual = gamma_for(controller.model.parameters, controller.alpha)
        if controller.gamma < 0.5 * usual:
            text = f" gamma = {controller.gamma:.3g} is strict for this arm; for its inertia, {usual:.3g} is usual."
    enough_alone = f" With these gains, one change alone would give the loop the required margins: {ways}."
    return (enough_alone if ways else "") + text


def _policy(controller: Controller | ScheduledController, control_period: float) -> Linearisable:
    policy: Linearisable = load_policy(controller, control_period=control_period, allow_unproven=True)
    return policy


def _bears(policy: Linearisable, arm: AnyArm, control_period: float) -> bool:
    try:
        loops = linearise_path(policy, arm, control_period)
    except ValueError:  # a torque limit, or no equilibrium
        return False
    return all(largest_radius(loops, gain, delay) < 1.0 for gain, delay in _CONDITIONS)
