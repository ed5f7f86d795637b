"""Arguments of the environments, checked and completed: the same for one arm, a batch and tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.tables import MAX_ACCELERATION
from fuzzyarm.envs.control_step import ANGLE_ROOM, VELOCITY_ROOM
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.envs.scenario.scenario import Scenario

__all__ = [
    "RESET_OPTIONS", "action_space", "check_options", "chosen_disturbance", "chosen_reference", "chosen_scenario",
    "initial_state", "observation_space", "real_numbers",
]  # fmt: skip

RESET_OPTIONS = ("initial_state", "reference", "case", "disturbance")
"""What the `options` of `reset` may hold."""


def chosen_disturbance(case: str, disturbance: Disturbance | None, arm: AnyArm) -> Disturbance:
    """Return the disturbance itself, or that of the named case for this arm."""
    if disturbance is None:
        return case_for(case, arm).disturbance
    checks.instance("disturbance", disturbance, Disturbance)
    if not (isinstance(case, str) and case == "nominal"):
        raise ValueError(f"give either case = {checks.shown(case)} or a disturbance, not both")
    return disturbance


def chosen_reference(reference: Reference | None, randomisation: DomainRandomisation, arm: AnyArm) -> Reference | None:
    """Return the reference itself, the default one of this arm, or None where each episode draws its own."""
    if reference is None:
        return None if randomisation.references else default_reference(arm)
    checks.instance("reference", reference, Reference)  # type: ignore[type-abstract]
    if randomisation.references:
        raise ValueError("give either a reference or a randomisation that draws references, not both")
    return reference


def check_options(options: dict[str, Any]) -> None:
    """Raise ValueError for a reset option that does not exist, TypeError for options that are no mapping."""
    unknown = sorted(set(map(str, checks.instance("options", options, dict))) - set(RESET_OPTIONS))
    if unknown:
        raise ValueError(f"unknown reset option {checks.listed(unknown)}; known: {', '.join(RESET_OPTIONS)}")


def chosen_scenario(options: dict[str, Any], own: Scenario, arm: AnyArm) -> Scenario:
    """Return the scenario that reset options ask for."""
    check_options(options)
    disturbance, reference = own
    if "case" in options or "disturbance" in options:
        disturbance = chosen_disturbance(options.get("case", "nominal"), options.get("disturbance"), arm)
    if "reference" in options:
        reference = checks.instance("reference", options["reference"], Reference)  # type: ignore[type-abstract]
    return Scenario(disturbance, reference)


def initial_state(given: Any, arm: AnyArm) -> np.ndarray:
    """Return a given start (4 joints,), angles [rad] and velocities [rad/s], checked against the limits."""
    low, high, speed, _ = bounds_of(arm)
    lowest, highest = (np.concatenate(part) for part in ((low, low, -speed, -speed), (high, high, speed, speed)))
    state = real_numbers("initial_state", given)
    if state.shape != lowest.shape or not np.all((state >= lowest) & (state <= highest)):
        numbers = checks.shown(np.asarray(given).tolist())
        raise ValueError(
            f"initial_state = {numbers} must be {len(lowest)} finite numbers: motor angles, link angles (each "
            f"{_range('q', low, high)} rad), motor velocities, link velocities ({_range('dq', -speed, speed)} rad/s)"
        )
    return state


def real_numbers(name: str, given: Any) -> np.ndarray:
    """Return a new array of float64, of any shape and unit.

    Raises:
        TypeError: an entry is no real number.
        ValueError: rows differ in length, or a number is too large.
    """
    array = checks.array_of(name, given)
    if array.dtype.kind == "O":
        entries = [checks.real(name, entry) if checks.is_real(entry) else entry for entry in array.ravel()]
        array = np.reshape(np.asarray(entries), array.shape)
    checks.real_entries(name, array)
    try:
        return np.array(array, dtype=np.float64, order="C")
    except MemoryError:
        raise ValueError(f"{name} has shape {array.shape}: more numbers than the memory holds") from None


def action_space(arms: Sequence[AnyArm]) -> spaces.Box:
    """Return the motor torques that the strongest of these arms can give."""
    limit = np.max([bounds_of(arm).torque for arm in arms], axis=0).astype(np.float32)
    return spaces.Box(-limit, limit)


def observation_space(arms: Sequence[AnyArm]) -> spaces.Box:
    """Return what may be observed of these arms."""
    bounds = [bounds_of(arm) for arm in arms]
    low, high = np.min([each.low for each in bounds], axis=0), np.max([each.high for each in bounds], axis=0)
    dq = np.max([each.velocity for each in bounds], axis=0)
    # Motor readings get room beyond the limits: the observation that ends an episode lies outside of them.
    room, ddq = (
        ANGLE_ROOM * np.max([each.high - each.low for each in bounds], axis=0),
        np.full_like(dq, MAX_ACCELERATION),
    )
    lowest = np.concatenate([low - room, -VELOCITY_ROOM * dq, low, -dq, -ddq])
    highest = np.concatenate([high + room, VELOCITY_ROOM * dq, high, dq, ddq])
    return spaces.Box(lowest, highest, dtype=np.float64)


def _range(name: str, low: np.ndarray, high: np.ndarray) -> str:
    """Return what a message says of the range of a quantity, from its bounds (joints,)."""
    if np.array_equal(low, -high):
        return f"|{name}| <= {tuple(high.tolist())}"
    return f"{tuple(low.tolist())} <= {name} <= {tuple(high.tolist())}"
