"""Arguments of the environments, checked and completed: the same for one arm, a batch and tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.reporting import ANGLE_ROOM, VELOCITY_ROOM
from fuzzyarm.envs.batch.tables import MAX_ACCELERATION
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.scenario import Scenario

__all__ = [
    "RESET_OPTIONS",
    "action_space",
    "check_options",
    "checked_arm",
    "chosen_disturbance",
    "chosen_reference",
    "chosen_scenario",
    "initial_state",
    "observation_space",
    "real_numbers",
]

RESET_OPTIONS = ("initial_state", "reference", "case", "disturbance")
"""What the `options` of `reset` may hold."""


def chosen_disturbance(case: str, disturbance: Disturbance | None) -> Disturbance:
    """Return the disturbance itself, or that of the named case."""
    if disturbance is None:
        return find_case(case).disturbance
    checks.instance("disturbance", disturbance, Disturbance)
    if not (isinstance(case, str) and case == "nominal"):
        raise ValueError(f"give either case = {checks.shown(case)} or a disturbance, not both")
    return disturbance


def chosen_reference(
    reference: JointReference | None, randomisation: DomainRandomisation, parameters: ArmParameters
) -> JointReference | None:
    """Return the reference itself, the paper's circle for this arm, or None where each episode draws its own."""
    if reference is None:
        return None if randomisation.references else JointReference(parameters=parameters)
    checks.instance("reference", reference, JointReference)
    if randomisation.references:
        raise ValueError("give either a reference or a randomisation that draws references, not both")
    return reference


def checked_arm(parameters: Any) -> ArmParameters:
    """Return the arm; TypeError if it is none."""
    return checks.instance("parameters", parameters, ArmParameters)


def check_options(options: dict[str, Any]) -> None:
    """Raise ValueError for a reset option that does not exist, TypeError for options that are no mapping."""
    unknown = sorted(set(map(str, checks.instance("options", options, dict))) - set(RESET_OPTIONS))
    if unknown:
        raise ValueError(f"unknown reset option {checks.listed(unknown)}; known: {', '.join(RESET_OPTIONS)}")


def chosen_scenario(options: dict[str, Any], own: Scenario) -> Scenario:
    """Return the scenario that reset options ask for."""
    check_options(options)
    disturbance, reference = own
    if "case" in options or "disturbance" in options:
        disturbance = chosen_disturbance(options.get("case", "nominal"), options.get("disturbance"))
    if "reference" in options:
        reference = checks.instance("reference", options["reference"], JointReference)
    return Scenario(disturbance, reference)


def initial_state(given: Any, parameters: ArmParameters) -> np.ndarray:
    """Return a given start (4 joints,), angles [rad] and velocities [rad/s], checked against the limits."""
    angle, velocity, _ = _limits(parameters)
    bounds = np.concatenate([angle, angle, velocity, velocity], axis=-1)
    state = real_numbers("initial_state", given)
    if state.shape != bounds[0].shape or not np.all((state >= bounds[0]) & (state <= bounds[1])):
        numbers = checks.shown(np.asarray(given).tolist())
        raise ValueError(
            f"initial_state = {numbers} must be {len(bounds[0])} finite numbers: motor angles, link angles (each "
            f"{_range('q', angle)} rad), motor velocities, link velocities ({_range('dq', velocity)} rad/s)"
        )
    return state


def real_numbers(name: str, given: Any) -> np.ndarray:
    """Return a new array of float64, of any shape and unit.

    Raises:
        TypeError: an entry is no real number.
        ValueError: rows differ in length, or a number is too large.
    """
    array = np.asarray(given)
    if array.dtype.kind == "O":
        entries = [checks.real(name, entry) if checks.is_real(entry) else entry for entry in array.ravel()]
        array = np.reshape(np.asarray(entries), array.shape)
    checks.real_entries(name, array)
    return np.array(array, dtype=np.float64, order="C")


def action_space(parameters: Sequence[ArmParameters]) -> spaces.Box:
    """Return the motor torques that the strongest of these arms can give."""
    limit = np.max([_limits(arm)[2][1] for arm in parameters], axis=0).astype(np.float32)
    return spaces.Box(-limit, limit)


def observation_space(parameters: Sequence[ArmParameters]) -> spaces.Box:
    """Return what may be observed of these arms."""
    limits = [_limits(arm) for arm in parameters]
    low, high = (pick([each[0][end] for each in limits], axis=0) for end, pick in enumerate((np.min, np.max)))
    dq = np.max([velocity[1] for _, velocity, _ in limits], axis=0)
    # Motor readings get room beyond the limits: the observation that ends an episode lies outside of them.
    room, ddq = ANGLE_ROOM * (high - low), np.full_like(dq, MAX_ACCELERATION)
    lowest = np.concatenate([low - room, -VELOCITY_ROOM * dq, low, -dq, -ddq])
    highest = np.concatenate([high + room, VELOCITY_ROOM * dq, high, dq, ddq])
    return spaces.Box(lowest, highest, dtype=np.float64)


def _limits(arm: ArmParameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lowest and highest angles [rad], velocities [rad/s] and torques [N m] of an arm, (2, joints) each."""
    physics = equations_of(arm)
    limits = physics.limits(physics.plant_of(arm))
    velocity, torque = np.array(limits.velocity), np.array(limits.torque)
    return np.array(physics.angle_range(limits)), np.array([-velocity, velocity]), np.array([-torque, torque])


def _range(name: str, bounds: np.ndarray) -> str:
    """Return what a message says of the range (2, joints) of a quantity."""
    low, high = bounds.tolist()
    if np.array_equal(bounds[0], -bounds[1]):
        return f"|{name}| <= {tuple(high)}"
    return f"{tuple(low)} <= {name} <= {tuple(high)}"
