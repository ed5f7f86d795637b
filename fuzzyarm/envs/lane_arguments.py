"""Arguments of a batch, each one for all lanes or a sequence of one per lane."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.arguments import initial_state, real_numbers
from fuzzyarm.envs.physics.equations import AnyArm, checked_parameters, chosen_arm, equations_of
from fuzzyarm.envs.physics.records import size

__all__ = ["arms_of", "each_lane", "initial_states", "per_lane", "seeds_of"]


def per_lane(name: str, value: Any, lanes: int) -> list[Any]:
    """Return a list of one entry for all lanes, or of one per lane.

    Raises:
        ValueError: a sequence has another number of entries.
    """
    if isinstance(value, str) or not isinstance(value, Sequence):
        return [value]
    if len(value) != lanes:
        raise ValueError(f"{name} has {len(value)} entries for {lanes} lanes; give one, or one per lane")
    return list(value)


def each_lane(make: Callable[..., Any], *columns: Sequence[Any]) -> list[Any]:
    """Return make(*row) for each lane's row of the columns; a column of one entry is for all lanes.

    An error names its lane, if there are several.
    """
    count = max(map(len, columns))
    rows = zip(*(list(column) * count if len(column) == 1 else column for column in columns), strict=True)
    made = []
    for lane, row in enumerate(rows):
        try:
            made.append(make(*row))
        except (TypeError, ValueError) as error:
            raise type(error)(f"lane {lane}: {error}" if count > 1 else str(error)) from None
    return made


def arms_of(robot: Any, parameters: Any, lanes: int) -> list[AnyArm]:
    """Return the arms that these arguments name, one for all lanes or one per lane; errors as of `chosen_arm`."""
    given = per_lane("parameters", parameters, lanes)
    if parameters is not None:
        each_lane(checked_parameters, given)
    return each_lane(chosen_arm, per_lane("robot", robot, lanes), given)


def initial_states(given: Any, plants: Sequence[AnyArm], lanes: int) -> np.ndarray:
    """Return checked starts (lanes, 4 joints), see `arguments.initial_state`, from one (4 joints,) or one per lane.

    Raises:
        ValueError: a start has another shape or is out of the box of its plant.
    """
    states = real_numbers("initial_state", given)
    numbers = size(equations_of(plants[0]).State)
    one, all_lanes = (numbers,), (lanes, numbers)
    if states.shape not in (one, all_lanes):
        raise ValueError(f"initial_state has shape {states.shape}; allowed: {one} or {all_lanes}")
    rows = [states] if states.ndim == 1 else list(states)
    checked = each_lane(initial_state, rows, plants)
    return np.array(checked * lanes if len(checked) == 1 else checked)


def seeds_of(given: Any, lanes: int) -> list[int | None] | None:
    """Return a seed per lane: seed, seed + 1, ... from one, or those given; None lets the random stream go on.

    Raises:
        TypeError: a seed is no whole number.
        ValueError: a seed is negative, or there is not one per lane.
    """
    if given is None:
        return None
    if isinstance(given, Sequence | np.ndarray):
        if len(given) != lanes:
            raise ValueError(f"{len(given)} seeds for {lanes} lanes; give one, or one per lane")
        return each_lane(_seed, list(given))
    first = _seed(given)
    return [first + lane for lane in range(lanes)]


def _seed(given: Any) -> Any:
    return None if given is None else checks.whole("seed", given)
