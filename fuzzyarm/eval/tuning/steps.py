"""The steps of tuning an arm: one for each policy, each by its rule in ``rules.json``.

Those of a serial robot of any number of joints are what the mathematics allows of those of two joints. Its fuzzy
controller is of the form "semidefinite", whose decay rate follows from margins at random postures. It, computed torque
and the elastic observer begin at what random postures allow (`computed_torque.bandwidth_for`,
`observer_gains.weights_for`) and are slowed down further until they are stable in every condition of `fuzzyarm margins`
along the default reference. What a softer joint destabilises in the elastic observer is its estimate of the load, so
that is slowed down. The adaptive observer is tuned for two-joint arms alone.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Iterator
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.eval.stability.linearisation import Linearisable
from fuzzyarm.eval.tuning.adaptive_search import ADAPTIVE_SEARCH, find_adaptive
from fuzzyarm.eval.tuning.bandwidth import BANDWIDTHS, find_bandwidth
from fuzzyarm.eval.tuning.finding import PERIOD, SCHEMA, Finding, finite
from fuzzyarm.eval.tuning.fuzzy_gains import FUZZY, GRID, RULES, find_gains
from fuzzyarm.eval.tuning.observer_search import OBSERVER_SEARCH, find_observer
from fuzzyarm.eval.tuning.search import Context, Found, measured_radii, nothing
from fuzzyarm.fuzzy_policy.laws.computed_torque import STEP, ComputedTorquePolicy, bandwidth_for
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import SOFTENINGS, weights_for
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController
from fuzzyarm.policies.registry import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER
from fuzzyarm.synthesis import ScheduledSpecification, design_scheduled
from fuzzyarm.synthesis.scheduled_design import ALPHAS

__all__ = ["Step", "steps_for"]

_RULES: dict[str, dict[str, str]] = json.loads(resources.files(__package__).joinpath("rules.json").read_text("utf-8"))


class Step(NamedTuple):
    """A step finds the numbers of a policy by the rule for its arm; `total` candidates are known before."""

    policy: str
    total: int
    choose: Callable[[Context], Found]

    def find(self, context: Context) -> Finding:
        """Return the finding of the step; it has no numbers if the loop with the best ones is unstable."""
        found = self.choose(context)
        nominal = found.radii.get("nominal")
        if found.chosen is not None and (nominal is None or nominal >= 1.0):
            found = nothing("With the best numbers its loop is unstable.", found.tried)
        return Finding(
            schema=SCHEMA,
            arm_sha256=robot_of(context.arm).digest,
            policy=self.policy,
            chosen=found.chosen,
            measured=finite(found.measured),
            radii=found.radii,
            tried=found.tried,
            rule=_RULES["two joints" if isinstance(context.arm, ArmParameters) else "robots"][self.policy],
            notes=tuple(found.notes),
        )


def steps_for(arm: AnyArm) -> tuple[Step, ...]:
    """Return the steps of tuning an arm, in their order."""
    if isinstance(arm, ArmParameters):
        return (
            Step(FUZZY, GRID, find_gains),
            Step(COMPUTED_TORQUE, len(BANDWIDTHS), find_bandwidth),
            Step(ELASTIC_OBSERVER, OBSERVER_SEARCH.total, find_observer),
            Step(ADAPTIVE_OBSERVER, ADAPTIVE_SEARCH.total, find_adaptive),
        )
    return (
        Step(FUZZY, 1, _robot_gains),
        Step(COMPUTED_TORQUE, 1, _robot_bandwidth),
        Step(ELASTIC_OBSERVER, 1, _robot_observer),
        Step(ADAPTIVE_OBSERVER, 1, lambda context: nothing("By its name it has those of Table 1, softened.", 0)),
    )


# Robots of any number of joints ---------------------------------------------------------------------------------------


class _Assessed(NamedTuple):
    """A candidate for a robot: what its policy is made from, and the spectral radius by condition."""

    made_from: Any
    radii: dict[str, float | None]

    @property
    def worst(self) -> float:
        """The largest spectral radius; inf where there is no loop."""
        return max(math.inf if radius is None else radius for radius in self.radii.values())


def _slowed_down(context: Context, candidates: Iterable[tuple[Any, Linearisable]]) -> list[_Assessed]:
    """Assess candidates, each with its policy, up to the first one that is stable in every condition."""
    tried: list[_Assessed] = []
    for made_from, policy in candidates:
        tried.append(_Assessed(made_from, measured_radii(policy, context.arm)))
        context.advance()
        if tried[-1].worst < 1.0:
            break
    return tried


def _robot_gains(context: Context) -> Found:
    """Return α, γ and the fastest pole of the fastest design, in semidefinite form, that is stable; write its file."""
    robot: Robot = context.arm
    rules, failed = min(RULES, 2 ** (len(robot) - 1)), ""

    def designs() -> Iterator[tuple[ScheduledController, Linearisable]]:
        nonlocal failed
        alpha: float | None = None
        while True:
            try:
                controller = design_scheduled(ScheduledSpecification(rules=rules, alpha=alpha), robot).controller
            except ValueError as error:
                failed = f"There is no proven controller: {error}."
                return
            yield controller, ScheduledPolicy(controller, PERIOD)
            alpha = next((slower for slower in ALPHAS if slower < controller.alpha), None)
            if alpha is None:
                return

    tried = _slowed_down(context, designs())
    if failed:
        return nothing(failed, len(tried) + 1)
    controller, radii = tried[-1]
    controller.save(context.folder / f"{FUZZY}.json")
    return Found({key: getattr(controller, key) for key in ("alpha", "gamma", "fastest_pole")}, {}, radii, len(tried))


def _robot_bandwidth(context: Context) -> Found:
    """Return the largest bandwidth ω [rad/s] that is stable."""
    robot: Robot = context.arm
    omegas = np.arange(bandwidth_for(robot, PERIOD), 0.0, -STEP).tolist()
    tried = _slowed_down(context, ((omega, ComputedTorquePolicy(robot, PERIOD, omega)) for omega in omegas))
    return Found({"bandwidth": tried[-1].made_from}, {}, tried[-1].radii, len(tried))


def _robot_observer(context: Context) -> Found:
    """Return the weights of the elastic observer with the fastest walk of the load that is stable."""
    robot: Robot = context.arm
    first = weights_for(robot, PERIOD)
    slower = (dataclasses.replace(first, load_walk=first.load_walk / factor) for factor in SOFTENINGS)
    tried = _slowed_down(context, ((weights, ElasticObserverPolicy(robot, PERIOD, weights)) for weights in slower))
    best = min(tried, key=lambda one: one.worst)
    return Found(dataclasses.asdict(best.made_from), {}, best.radii, len(tried))
