"""The steps of tuning a serial robot of any number of joints: what the mathematics allows of those of two joints.

The fuzzy controller is of the form "semidefinite", whose decay rate follows from margins at random postures. Computed
torque and the elastic observer begin at what random postures allow (`computed_torque.bandwidth_for`,
`observer_weights.weights_for`) and are weakened further until they are stable in every condition of `fuzzyarm margins`
along the default reference. The adaptive observer is tuned for two-joint arms alone.
"""

from __future__ import annotations

import dataclasses

from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.eval.tuning.conditions import PERIOD
from fuzzyarm.eval.tuning.finding import Finding
from fuzzyarm.eval.tuning.steps import FUZZY, RULES, Context, Step, found, measured_radii, nothing_found
from fuzzyarm.fuzzy_policy.laws.computed_torque import STEP, ComputedTorquePolicy, bandwidth_for
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_weights import FACTORS, softened, weights_for
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.policies.tuned import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER
from fuzzyarm.synthesis import DesignFailed, ScheduledSpecification, design_scheduled

__all__ = ["ROBOT_STEPS"]


def _stable(radii: dict[str, float | None]) -> bool:
    return all(radius is not None and radius < 1.0 for radius in radii.values())


def _fuzzy(context: Context) -> Finding:
    """Design a controller of the form "semidefinite"; write its file."""
    robot: Robot = context.arm
    rule = (
        "Semidefinite form: the largest decay rate with which the loop bears twice its gain and a sample of delay at "
        "random postures, the fastest pole 1.5 times the smallest possible one."
    )
    try:
        controller = design_scheduled(ScheduledSpecification(rules=min(RULES, 2 ** (len(robot) - 1))), robot).controller
    except (DesignFailed, ValueError) as error:
        return nothing_found(robot, FUZZY, rule, 1, f"There is no proven controller: {error}.")
    controller.save(context.folder / f"{FUZZY}.json")
    context.advance(1)
    chosen: dict[str, float | None] = {
        "alpha": controller.alpha,
        "gamma": controller.gamma,
        "fastest_pole": controller.fastest_pole,
    }
    radii = measured_radii(ScheduledPolicy(controller, PERIOD), robot)
    return found(robot, FUZZY, chosen, {}, radii, tried=1, rule=rule)


def _bandwidth(context: Context) -> Finding:
    """Choose ω."""
    robot: Robot = context.arm
    rule = (
        "Largest bandwidth of 70, 65, ... rad/s that bears twice the loop gain and a sample of delay at random "
        "postures, lowered until the loop is stable in every condition along the default path."
    )
    omega, tried = bandwidth_for(robot, PERIOD), 1
    radii = measured_radii(ComputedTorquePolicy(robot, PERIOD, omega), robot)
    while omega > STEP and not _stable(radii):
        omega, tried = omega - STEP, tried + 1
        radii = measured_radii(ComputedTorquePolicy(robot, PERIOD, omega), robot)
        context.advance(1)
    return found(robot, COMPUTED_TORQUE, {"bandwidth": omega}, {}, radii, tried=tried, rule=rule)


def _observer(context: Context) -> Finding:
    """Choose the weights of the elastic observer."""
    robot: Robot = context.arm
    rule = (
        "The weights of Table 1, softened until the loop is stable at random postures with another loop gain, a sample "
        "of delay and stiffness 10 % off, and in every condition along the default path."
    )
    first = weights_for(robot, PERIOD)
    weights, radii, tried = first, measured_radii(ElasticObserverPolicy(robot, PERIOD, first), robot), 1
    for factor in FACTORS[1:]:
        if _stable(radii):
            break
        softer = softened(first, factor)
        softer_radii = measured_radii(ElasticObserverPolicy(robot, PERIOD, softer), robot)
        tried += 1
        context.advance(1)
        if _worst(softer_radii) < _worst(radii):
            weights, radii = softer, softer_radii
    return found(robot, ELASTIC_OBSERVER, dataclasses.asdict(weights), {}, radii, tried=tried, rule=rule)


def _worst(radii: dict[str, float | None]) -> float:
    return max(float("inf") if radius is None else radius for radius in radii.values())


def _adaptive(context: Context) -> Finding:
    rule = "None: its weights are searched for two-joint arms alone."
    return nothing_found(context.arm, ADAPTIVE_OBSERVER, rule, 0, "By its name alone it has the weights of Table 1.")


ROBOT_STEPS = (
    Step(FUZZY, 1, _fuzzy),
    Step(COMPUTED_TORQUE, 1, _bandwidth),
    Step(ELASTIC_OBSERVER, 1, _observer),
    Step(ADAPTIVE_OBSERVER, 1, _adaptive),
)
"""The steps of a robot, in their order."""
