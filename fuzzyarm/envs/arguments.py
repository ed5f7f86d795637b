"""Checks and defaults of the arguments of the environments, the same for one arm, a batch and tensors.

An argument of a batch is one value for all lanes, or a sequence with one for each lane.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.tables import MAX_ACCELERATION
from fuzzyarm.envs.control_step import ANGLE_ROOM, VELOCITY_ROOM
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of, chosen_arm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import size
from fuzzyarm.envs.scenario.cases import Scenario, case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import Reference

__all__ = [
    "action_space", "arms_of", "check_options", "chosen_disturbance", "chosen_reference", "chosen_scenario",
    "each_lane", "initial_state", "initial_states", "observation_space", "per_lane", "real_numbers", "seeds_of",
]  # fmt: skip

_RESET_OPTIONS = ("initial_state", "reference", "case", "disturbance")  # keys that the `options` of `reset` may contain


def chosen_disturbance(case: str, disturbance: Disturbance | None, arm: AnyArm) -> Disturbance:
    """Return the given disturbance, or the one that the named case has for this arm."""
    if disturbance is None:
        return case_for(case, arm).disturbance
    checks.instance("disturbance", disturbance, Disturbance)
    if not (isinstance(case, str) and case == "nominal"):
        raise ValueError(f"give either case = {checks.shown(case)} or a disturbance, not both")
    return disturbance


def chosen_reference(reference: Reference | None, randomisation: DomainRandomisation, arm: AnyArm) -> Reference | None:
    """Return the given reference, the default one for this arm, or None if each episode draws a reference."""
    if reference is None:
        return None if randomisation.references else default_reference(arm)
    checks.instance("reference", reference, Reference)  # type: ignore[type-abstract]
    if randomisation.references:
        raise ValueError("give either a reference or a randomisation that draws references, not both")
    return reference


def check_options(options: dict[str, Any]) -> None:
    """Raise ValueError for a reset option that does not exist, TypeError for options that are not a dictionary."""
    unknown = sorted(set(map(str, checks.instance("options", options, dict))) - set(_RESET_OPTIONS))
    if unknown:
        raise ValueError(f"unknown reset option {checks.listed(unknown)}; known: {', '.join(_RESET_OPTIONS)}")


def chosen_scenario(options: dict[str, Any], own: Scenario, arm: AnyArm) -> Scenario:
    """Return the scenario that reset options request for an arm; what they omit is as in `own`."""
    check_options(options)
    disturbance, reference = own
    if "case" in options or "disturbance" in options:
        disturbance = chosen_disturbance(options.get("case", "nominal"), options.get("disturbance"), arm)
    if "reference" in options:
        reference = checks.instance("reference", options["reference"], Reference)  # type: ignore[type-abstract]
    return Scenario(disturbance, reference)


def initial_state(given: Any, arm: AnyArm) -> np.ndarray:
    """Return a given initial state (4 × joints,), angles [rad] and velocities [rad/s], checked against the limits."""
    low, high, speed, _ = bounds_of(arm)
    lowest, highest = (np.concatenate(part) for part in ((low, low, -speed, -speed), (high, high, speed, speed)))
    state = real_numbers("initial_state", given)
    if state.shape != lowest.shape or not np.all((state >= lowest) & (state <= highest)):
        numbers = checks.shown(np.asarray(given).tolist())
        raise ValueError(
            f"initial_state = {numbers} must be {len(lowest)} finite numbers: motor angles and link angles "
            f"({_range('q', low, high)} rad), then motor velocities and link velocities "
            f"({_range('dq', -speed, speed)} rad/s)"
        )
    return state


def real_numbers(name: str, given: Any) -> np.ndarray:
    """Return real numbers as a new array of float64, of any shape and unit; TypeError for anything else."""
    array = checks.array_of(name, given)
    if array.dtype.kind == "O":
        entries = [checks.real(name, entry) if checks.is_real(entry) else entry for entry in array.ravel()]
        array = np.reshape(np.asarray(entries), array.shape)
    checks.real_entries(name, array)
    try:
        return np.array(array, dtype=np.float64, order="C")
    except MemoryError:
        raise ValueError(f"{name} has shape {array.shape}, which does not fit in memory") from None


def action_space(arms: Sequence[AnyArm]) -> spaces.Box:
    """Return the space of motor torques [N m] up to the largest limit that any of these arms has, joint by joint."""
    limit = np.max([bounds_of(arm).torque for arm in arms], axis=0).astype(np.float32)
    return spaces.Box(-limit, limit)


def observation_space(arms: Sequence[AnyArm]) -> spaces.Box:
    """Return the space that contains every observation of these arms."""
    bounds = [bounds_of(arm) for arm in arms]
    low, high = np.min([each.low for each in bounds], axis=0), np.max([each.high for each in bounds], axis=0)
    dq = np.max([each.velocity for each in bounds], axis=0)
    # Motor readings get room beyond the limits: the observation that ends an episode lies outside the limits.
    room = ANGLE_ROOM * np.max([each.high - each.low for each in bounds], axis=0)
    ddq = np.full_like(dq, MAX_ACCELERATION)
    lowest = np.concatenate([low - room, -VELOCITY_ROOM * dq, low, -dq, -ddq])
    highest = np.concatenate([high + room, VELOCITY_ROOM * dq, high, dq, ddq])
    return spaces.Box(lowest, highest, dtype=np.float64)


def _range(name: str, low: np.ndarray, high: np.ndarray) -> str:
    """Return the range of a quantity as text for a message, from its bounds (joints,)."""
    if np.array_equal(low, -high):
        return f"|{name}| <= {tuple(high.tolist())}"
    return f"{tuple(low.tolist())} <= {name} <= {tuple(high.tolist())}"


def per_lane(name: str, value: Any, lanes: int) -> list[Any]:
    """Return an argument as a list with a single entry for all lanes, or with one entry per lane."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        return [value]
    if len(value) != lanes:
        raise ValueError(f"{name} has {len(value)} entries for {lanes} environments; give one, or one for each")
    return list(value)


def each_lane(make: Callable[..., Any], *columns: Sequence[Any]) -> list[Any]:
    """Return make(*row) for each lane; a row has one entry per column, and a single entry serves all lanes.

    An error names its lane if there are several.
    """
    count = max(map(len, columns))
    rows = zip(*(list(column) * count if len(column) == 1 else column for column in columns), strict=True)
    made = []
    for lane, row in enumerate(rows):
        try:
            made.append(make(*row))
        except (TypeError, ValueError) as error:
            raise type(error)(f"environment {lane}: {error}" if count > 1 else str(error)) from None
    return made


def arms_of(robot: Any, parameters: Any, lanes: int) -> list[AnyArm]:
    """Return the arms given by these arguments, one for all lanes or one per lane; errors as in `chosen_arm`."""
    given = per_lane("parameters", parameters, lanes)
    if parameters is not None:
        each_lane(lambda one: checks.instance("parameters", one, ArmParameters), given)
    return each_lane(chosen_arm, per_lane("robot", robot, lanes), given)


def initial_states(given: Any, plants: Sequence[AnyArm], lanes: int) -> np.ndarray:
    """Return initial states (lanes, 4 × joints) [rad, rad/s]; `given` is one for all lanes or one for each lane."""
    states = real_numbers("initial_state", given)
    numbers = size(equations_of(plants[0]).State)
    one, all_lanes = (numbers,), (lanes, numbers)
    if states.shape not in (one, all_lanes):
        raise ValueError(f"initial_state has shape {states.shape}; allowed: {one} or {all_lanes}")
    rows = [states] if states.ndim == 1 else list(states)
    checked = each_lane(initial_state, rows, plants)
    return np.array(checked * lanes if len(checked) == 1 else checked)


def seeds_of(given: Any, lanes: int) -> list[int | None] | None:
    """Return one seed per lane: the given ones, or seed, seed + 1, ... for a single seed.

    A lane with the seed None continues its random stream; None instead of a list: every lane does.
    """
    if given is None:
        return None
    if isinstance(given, Sequence | np.ndarray):
        if len(given) != lanes:
            raise ValueError(f"{len(given)} seeds were given for {lanes} environments; give one, or one for each")
        return each_lane(_seed, list(given))
    first = _seed(given)
    return [first + lane for lane in range(lanes)]


def _seed(given: Any) -> Any:
    return None if given is None else checks.whole("seed", given)
