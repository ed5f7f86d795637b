"""The steps of tuning an arm: one for each policy, each by its rule in ``rules.json``.

For a `Robot`, of any number of joints, a policy's parameters start from the limits found at random postures
(`design_scheduled`, `bandwidth_for`, `weights_for`). The policy is then slowed down until its loop is stable in every
condition of `fuzzyarm margins` along the default reference. In the elastic observer only the estimate of the load is
slowed down, because softer joints destabilise it.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Iterable
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.eval.stability._linearisation import Linearisable
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.tuning._adaptive_search import ADAPTIVE_SEARCH, find_adaptive
from fuzzyarm.eval.tuning._finding import PERIOD, SCHEMA, Finding, finite, halving_radius
from fuzzyarm.eval.tuning._fuzzy_gains import FUZZY, GRID, RULES, find_gains
from fuzzyarm.eval.tuning._observer_search import OBSERVER_SEARCH, find_observer
from fuzzyarm.eval.tuning._search import Context, Found, measured_radii, motor_error, nothing
from fuzzyarm.fuzzy_policy.laws.computed_torque import STEP, ComputedTorquePolicy, bandwidth_for
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import SOFTENINGS, weights_for
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.policies.registry import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER
from fuzzyarm.synthesis import ScheduledSpecification, design_scheduled
from fuzzyarm.synthesis.specification import ALPHAS

__all__ = ["TuningStep", "steps_for"]

_RULES: dict[str, dict[str, str]] = json.loads(resources.files(__package__).joinpath("rules.json").read_text("utf-8"))


class TuningStep(NamedTuple):
    """A step that finds a policy's parameters by the rule for this kind of arm, among `total` candidates."""

    policy: str
    total: int
    choose: Callable[[Context], Found]

    def find(self, context: Context) -> Finding:
        """Return the finding of the step; it has no parameters if the loop with the best ones is unstable."""
        found = self.choose(context)
        nominal = found.radii.get("nominal")
        if found.chosen is not None and (nominal is None or nominal >= 1.0):
            found = nothing("Even with the best numbers found, the loop is unstable.", found.tried)
        rule = _RULES["two joints" if isinstance(context.arm, ArmParameters) else "robots"][self.policy]
        found = found._replace(measured=finite(found.measured), notes=tuple(found.notes))
        return Finding(SCHEMA, robot_of(context.arm).digest, self.policy, rule=rule, **found._asdict())


_UNTUNED = "It is not tuned for robots: under its own name, it already uses softened weights of Table 1."


def steps_for(arm: AnyArm) -> tuple[TuningStep, ...]:
    """Return the steps of tuning an arm, in their order."""
    if isinstance(arm, ArmParameters):
        return (
            TuningStep(FUZZY, GRID, find_gains),
            TuningStep(COMPUTED_TORQUE, len(_BANDWIDTHS), _find_bandwidth),
            TuningStep(ELASTIC_OBSERVER, OBSERVER_SEARCH.total, find_observer),
            TuningStep(ADAPTIVE_OBSERVER, ADAPTIVE_SEARCH.total, find_adaptive),
        )
    return (
        TuningStep(FUZZY, 1, _robot_gains),
        TuningStep(COMPUTED_TORQUE, 1, _robot_bandwidth),
        TuningStep(ELASTIC_OBSERVER, 1, _robot_observer),
        TuningStep(ADAPTIVE_OBSERVER, 1, lambda context: nothing(_UNTUNED, 0)),
    )


# The bandwidth of computed torque for two joints. A rollout alone does not show that a loop is unstable: the torque
# limits keep it in a small limit cycle, and the episode ends regularly.

_BANDWIDTHS = [float(omega) for omega in range(5, 161, 5)]  # rad/s
_LEAST_GAIN_MARGIN = 2.0  # 6 dB


def _find_bandwidth(context: Context) -> Found:
    """Return the bandwidth ω [rad/s] of computed torque that `_bandwidth_of` selects for a two-joint arm."""
    arm: ArmParameters = context.arm
    row = _bandwidth_of(context.run(functools.partial(_assessed_bandwidth, arm), _BANDWIDTHS), halving_radius(arm))
    if row is None:
        reason = f"No bandwidth from {_BANDWIDTHS[0]:g} to {_BANDWIDTHS[-1]:g} rad/s has these margins."
        return nothing(reason, len(_BANDWIDTHS))
    measured = {
        "joint_error_rms_mrad": row["motor_error"],
        "gain_margin_upper": row["loop_gain"]["upper"],
        "gain_margin_upper_delayed": row["loop_gain"]["upper_one_sample_later"],
    }
    return Found({"bandwidth": row["bandwidth"]}, measured, row["spectral_radius"], len(_BANDWIDTHS))


def _assessed_bandwidth(arm: ArmParameters, bandwidth: float) -> dict[str, Any]:
    """Return the motor error [mrad] and the margins of computed torque with a bandwidth [rad/s], by name."""
    policy = ComputedTorquePolicy(arm, PERIOD, bandwidth)
    return {"bandwidth": bandwidth, "motor_error": motor_error(policy, arm), **policy_margins(policy, arm, PERIOD)}


def _bandwidth_of(rows: list[dict[str, Any]], allowed: float) -> dict[str, Any] | None:
    """Return the row with the least motor error among those that qualify; None if none does.

    A row qualifies if its gain margin is large enough and none of its spectral radii exceeds `allowed`.
    """
    eligible = [
        row
        for row in rows
        if row["motor_error"] < math.inf
        and (row["loop_gain"]["upper"] or 0.0) >= _LEAST_GAIN_MARGIN
        and all(radius is not None and radius <= allowed for radius in row["spectral_radius"].values())
    ]
    return min(eligible, key=lambda row: float(row["motor_error"]), default=None)


# Robots of any number of joints ---------------------------------------------------------------------------------------


def _worst(radii: dict[str, float | None]) -> float:
    return max(math.inf if radius is None else radius for radius in radii.values())


def _slowed_down(context: Context, candidates: Iterable[tuple[Any, Linearisable]]) -> list[tuple[Any, dict[str, Any]]]:
    """Try (settings, policy) candidates in order until the loop of one is stable in all conditions.

    Return (settings, spectral radii by condition) for each candidate tried.
    """
    tried: list[tuple[Any, dict[str, Any]]] = []
    for made_from, policy in candidates:
        tried.append((made_from, measured_radii(policy, context.arm)))
        context.advance()
        if _worst(tried[-1][1]) < 1.0:
            break
    return tried


def _robot_gains(context: Context) -> Found:
    """Return α, γ and the fastest pole of the design with the largest α whose loop is stable; write its file.

    If no loop is stable, it is the design with the smallest α.
    """
    robot: Robot = context.arm
    rules, alpha, tried = min(RULES, 2 ** (len(robot) - 1)), None, 0
    while True:
        tried += 1
        try:
            controller = design_scheduled(ScheduledSpecification(rules=rules, alpha=alpha), robot).controller
        except ValueError as error:
            return nothing(f"There is no proven controller: {error}.", tried)
        radii = measured_radii(ScheduledPolicy(controller, PERIOD), robot)
        context.advance()
        alpha = next((slower for slower in ALPHAS if slower < controller.alpha), None)
        if alpha is None or _worst(radii) < 1.0:
            break
    controller.save(context.folder / f"{FUZZY}.json")
    return Found({key: getattr(controller, key) for key in ("alpha", "gamma", "fastest_pole")}, {}, radii, tried)


def _robot_bandwidth(context: Context) -> Found:
    """Return the largest bandwidth ω [rad/s] whose loop is stable in all conditions; if none, the smallest tried."""
    robot: Robot = context.arm
    omegas = np.arange(bandwidth_for(robot, PERIOD), 0.0, -STEP).tolist()
    tried = _slowed_down(context, ((omega, ComputedTorquePolicy(robot, PERIOD, omega)) for omega in omegas))
    omega, radii = tried[-1]
    return Found({"bandwidth": omega}, {}, radii, len(tried))


def _robot_observer(context: Context) -> Found:
    """Return the weights of the elastic observer with the largest `load_walk` for which the loop is stable.

    If no loop is stable, return the weights with the smallest spectral radius.
    """
    robot: Robot = context.arm
    first = weights_for(robot, PERIOD)
    slower = (dataclasses.replace(first, load_walk=first.load_walk / factor) for factor in SOFTENINGS)
    tried = _slowed_down(context, ((weights, ElasticObserverPolicy(robot, PERIOD, weights)) for weights in slower))
    weights, radii = min(tried, key=lambda one: _worst(one[1]))
    return Found(dataclasses.asdict(weights), {}, radii, len(tried))
