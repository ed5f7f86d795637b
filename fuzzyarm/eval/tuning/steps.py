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
import functools
import json
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.stability.linearisation import Linearisable
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.tuning import adaptive_search, bandwidth, fuzzy_gains, observer_search
from fuzzyarm.eval.tuning.finding import PERIOD, SCHEMA, Finding, finite
from fuzzyarm.eval.tuning.search import found_weights, run_in_order, sobol_points
from fuzzyarm.eval.tuning.tip_bounds import measured_bounds
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.computed_torque import STEP, ComputedTorquePolicy, bandwidth_for
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import SOFTENINGS, ObserverWeights, weights_for
from fuzzyarm.fuzzy_policy.laws.scheduled import ScheduledPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies.registry import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, ELASTIC_OBSERVER
from fuzzyarm.synthesis import DesignFailed, ScheduledSpecification, design, design_scheduled
from fuzzyarm.synthesis.scheduled_design import ALPHAS

__all__ = ["FUZZY", "RULES", "Context", "Step", "step", "steps_for"]

RULES = 4
"""Rules of the fuzzy controller."""
FUZZY = f"fuzzy-{RULES}"
"""The name of the fuzzy controller; models that keep more premises are alike, and have its γ and fastest pole."""
_RULES: dict[str, dict[str, str]] = json.loads(resources.files(__package__).joinpath("rules.json").read_text("utf-8"))


@dataclasses.dataclass(frozen=True)
class Context:
    """What a step works with."""

    arm: Any
    folder: Path  # of the tuning; a step may write its controller file there
    engine: Engine  # runs candidates on several processes
    advance: Callable[[int], None]  # called with the number of candidates that were done
    earlier: dict[str, Finding]  # findings of the steps before, by policy

    def run(self, work: Callable[[Any], Any], candidates: Sequence[Any]) -> list[Any]:
        """Return what `work` makes of each candidate, done on the engine."""
        return run_in_order(self.engine, lambda number: work(candidates[number]), len(candidates), self.advance)


class Step(NamedTuple):
    """A step finds the numbers of a policy; `total` candidates are known before."""

    policy: str
    total: int
    find: Callable[[Context], Finding]


def _measured_radii(policy: Linearisable, arm: AnyArm) -> dict[str, float | None]:
    """Return the spectral radius by condition of `fuzzyarm margins`."""
    return finite(policy_margins(policy, arm, PERIOD)["spectral_radius"])


class _NothingFound(Exception):
    """There are no numbers for a policy: why, and the number of candidates that were assessed."""


_Found = tuple[dict[str, float | None], Mapping[str, float | None], dict[str, float | None], int, Sequence[str]]
"""The fields `chosen`, `measured`, `radii`, `tried` and `notes` of a `Finding`."""


def step(policy: str, total: int, choose: Callable[[Context], _Found]) -> Step:
    """Return the step that finds the numbers of a policy by the rule for its arm."""

    def find(context: Context) -> Finding:
        rule = _RULES["two joints" if isinstance(context.arm, ArmParameters) else "robots"][policy]
        begin = SCHEMA, robot_of(context.arm).digest, policy
        try:
            chosen, measured, radii, tried, notes = choose(context)
            nominal = radii.get("nominal")
            if nominal is None or nominal >= 1.0:
                raise _NothingFound("With the best numbers its loop is unstable.", tried)
        except _NothingFound as error:
            reason, tried = error.args
            return Finding(*begin, None, {}, {}, tried, rule, (reason,))
        return Finding(*begin, chosen, finite(measured), radii, tried, rule, tuple(notes))

    return Step(policy, total, find)


def _fuzzy(context: Context) -> _Found:
    """Choose α, γ and the fastest pole; write the controller file."""
    arm: ArmParameters = context.arm
    row, tried, notes, assess = None, 0, list[str](), functools.partial(fuzzy_gains.assess, arm, rules=RULES)
    for alpha in fuzzy_gains.ALPHAS:
        points = fuzzy_gains.points_of(arm, RULES, alpha)
        gentle, others = points[-len(fuzzy_gains.POLES) :], points[: -len(fuzzy_gains.POLES)]
        rows = context.run(assess, gentle)
        if any(one is not None and one["bears"] for one in rows):
            rows = [*context.run(assess, others), *rows]
        tried += len(rows)
        made = [one for one in rows if one is not None]
        row = fuzzy_gains.choice_of(made)
        if row is not None:
            break
        notes.append(f"No design with alpha = {alpha:g} 1/s bears what is asked on the sampled elastic arm.")
    if row is None:
        raise _NothingFound(f"No design bears what is asked, down to alpha = {alpha:g} 1/s.", tried)
    chosen = {name: row[name] for name in ("alpha", "gamma", "fastest_pole")}
    controller = design(fuzzy_gains.specification_of(RULES, *chosen.values()), arm).controller
    controller.save(context.folder / f"{FUZZY}.json")
    names = ("case_1_joint_error_rms_mrad", "tip_deviation_mm", "radius_worst_condition", "gain_margin_upper")
    measured = {name: row[name] for name in (*names, "gain_margin_upper_1_sample_later")}
    policy = FuzzyPolicy(controller, PERIOD)
    bounds, without = measured_bounds(TipPolicy(policy), arm)
    notes += [fuzzy_gains.equals_in_words(made, row), *without]
    return chosen, measured | bounds, _measured_radii(policy, arm), tried, notes


def _bandwidth(context: Context) -> _Found:
    """Choose ω."""
    arm, omegas = context.arm, bandwidth.BANDWIDTHS
    row = bandwidth.choice_of(context.run(functools.partial(bandwidth.assess, arm), omegas))
    if row is None:
        reason = f"No bandwidth from {omegas[0]:g} to {omegas[-1]:g} rad/s has these margins."
        raise _NothingFound(reason, len(omegas))
    measured = {name: row[name] for name in ("joint_error_rms_mrad", "gain_margin_upper", "gain_margin_upper_delayed")}
    radii = _measured_radii(ComputedTorquePolicy(arm, PERIOD, row["bandwidth"]), arm)
    return {"bandwidth": row["bandwidth"]}, measured, radii, len(omegas), ()


def _searched(
    context: Context,
    search: Any,
    usual: Any,
    law: Callable[[Any], Linearisable],
    objective_for: Any,
    notes: tuple[str, ...] = (),
) -> _Found:
    """Return the weights that the `search` of a module finds from the guess `usual`, for the policy `law(weights)`."""
    points = sobol_points(list(search.BOX.values()), search.FULL.sobol, search.SEED)
    budget = search.SHORT
    begin = search.logarithms_of(usual), points, search.FIRST_STEP, budget
    best, guess = found_weights(objective_for, context.arm, *begin, engine=context.engine, advance=context.advance)
    weights = usual if best == guess else search.weights_of(best.point)
    try:
        radii = _measured_radii(law(weights), context.arm)
    except ValueError as error:
        raise _NothingFound(f"There are no gains: {error}.", budget.total) from None
    if best.cost >= search.UNFIT:
        notes = (*notes, "No weights have the margins that the rule asks for; these come nearest.")
    first = None if guess.cost >= search.UNFIT else guess.cost
    measured = {"objective_mm": best.cost, "objective_of_table_1_weights_mm": first}
    return dataclasses.asdict(weights), measured, radii, budget.total, notes


def _observer(context: Context) -> _Found:
    """Choose the weights of the elastic observer."""
    law = functools.partial(ElasticObserverPolicy, context.arm, PERIOD)
    return _searched(context, observer_search, ObserverWeights(), law, observer_search.objective_for)


def _adaptive(context: Context) -> _Found:
    """Choose the weights of the adaptive observer."""
    arm = context.arm
    lawful = context.earlier.get(COMPUTED_TORQUE)
    omega = None if lawful is None or lawful.chosen is None else lawful.chosen["bandwidth"]
    try:
        adaptive_search.feasible_references(arm)
    except ValueError as error:
        raise _NothingFound(f"It was not tuned: {error}.", 0) from None
    note = (
        "Its margins are those of the loop with its adaptation frozen, which knows nothing of the change; it bears "
        "other loops by adapting to them, which is tried on random arms and not measured by a margin."
    )

    def law(weights: AdaptiveWeights) -> Linearisable:
        return AdaptiveObserverPolicy(arm, PERIOD, weights, TipPolicy(ComputedTorquePolicy(arm, PERIOD, omega)))

    objective_for = functools.partial(adaptive_search.objective_for, bandwidth=omega)
    return _searched(context, adaptive_search, AdaptiveWeights(), law, objective_for, (note,))


def _robot_fuzzy(context: Context) -> _Found:
    """Design a controller of the form "semidefinite"; write its file."""
    robot: Robot = context.arm
    rules, tried, alpha = min(RULES, 2 ** (len(robot) - 1)), 0, None
    while True:
        try:
            controller = design_scheduled(ScheduledSpecification(rules=rules, alpha=alpha), robot).controller
        except (DesignFailed, ValueError) as error:
            raise _NothingFound(f"There is no proven controller: {error}.", tried + 1) from None
        radii, tried = _measured_radii(ScheduledPolicy(controller, PERIOD), robot), tried + 1
        context.advance(1)
        alpha = next((slower for slower in ALPHAS if slower < controller.alpha), None)
        if alpha is None or _worst(radii) < 1.0:
            break
    controller.save(context.folder / f"{FUZZY}.json")
    return {key: getattr(controller, key) for key in ("alpha", "gamma", "fastest_pole")}, {}, radii, tried, ()


def _robot_bandwidth(context: Context) -> _Found:
    """Choose ω."""
    robot: Robot = context.arm
    omega, tried = bandwidth_for(robot, PERIOD), 1
    while True:
        radii = _measured_radii(ComputedTorquePolicy(robot, PERIOD, omega), robot)
        if omega <= STEP or _worst(radii) < 1.0:
            return {"bandwidth": omega}, {}, radii, tried, ()
        omega, tried = omega - STEP, tried + 1
        context.advance(1)


def _robot_observer(context: Context) -> _Found:
    """Choose the weights of the elastic observer."""
    robot: Robot = context.arm
    first = weights_for(robot, PERIOD)
    weights, radii, tried = first, _measured_radii(ElasticObserverPolicy(robot, PERIOD, first), robot), 1
    for factor in SOFTENINGS[1:]:
        if _worst(radii) < 1.0:
            break
        slower = dataclasses.replace(first, load_walk=first.load_walk / factor)
        slower_radii = _measured_radii(ElasticObserverPolicy(robot, PERIOD, slower), robot)
        tried += 1
        context.advance(1)
        if _worst(slower_radii) < _worst(radii):
            weights, radii = slower, slower_radii
    return dataclasses.asdict(weights), {}, radii, tried, ()


def _worst(radii: dict[str, float | None]) -> float:
    return max(float("inf") if radius is None else radius for radius in radii.values())


def _robot_adaptive(context: Context) -> _Found:
    raise _NothingFound("By its name it has those of Table 1, softened.", 0)


def steps_for(arm: AnyArm) -> tuple[Step, ...]:
    """Return the steps of tuning an arm, in their order."""
    if not isinstance(arm, ArmParameters):
        choices = (_robot_fuzzy, _robot_bandwidth, _robot_observer, _robot_adaptive)
        return tuple(step(policy, 1, choose) for policy, choose in zip(_RULES["robots"], choices, strict=True))
    return (
        step(FUZZY, len(fuzzy_gains.GAMMAS) * len(fuzzy_gains.POLES), _fuzzy),
        step(COMPUTED_TORQUE, len(bandwidth.BANDWIDTHS), _bandwidth),
        step(ELASTIC_OBSERVER, observer_search.SHORT.total, _observer),
        step(ADAPTIVE_OBSERVER, adaptive_search.SHORT.total, _adaptive),
    )
