"""One control step of the arm in tensors: the physics and the assessment of `fuzzyarm.envs`, line for line.

Nothing here waits for the device or depends on data: lanes that end begin anew by selection.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from fuzzyarm.envs.batch import randomness
from fuzzyarm.envs.batch.beginning import resting_of, varied_of
from fuzzyarm.envs.batch.layout import Noise
from fuzzyarm.envs.batch.schedule import Schedule, reference_record, row_record
from fuzzyarm.envs.control_step import ANGLE_ROOM, VELOCITY_ROOM
from fuzzyarm.envs.physics.hold import held_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import flat, places, size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.envs.task import assess_of, clipped, finite_of
from fuzzyarm.envs.termination import reason_of
from fuzzyarm.numbers.functions import like
from fuzzyarm.rl_baselines.torch_numbers import Angle, Table, normal_pair, uniform, word

__all__ = [
    "Equations", "Lanes", "Outcome", "Shared", "advance", "begin", "by_step", "drawn", "following", "observed",
    "stacked", "write",
]  # fmt: skip

# Counters of an episode's random stream as plain integers, which torch.compile takes for constants.
_NEXT_KEY, _RANDOMISATION = int(randomness.NEXT_KEY), int(randomness.RANDOMISATION)


class Lanes(NamedTuple):
    """What a lane carries from step to step, (n,) each; all else follows from it.

    The numbers of its state, in float32 followed by the rests of its angles; the key of the episode's random
    stream, and its steps so far, both int64.
    """

    numbers: tuple[Tensor, ...]
    key: Tensor
    step: Tensor


class Outcome(NamedTuple):
    """What a step returns; observations (5 joints, n), tips (axes, n), the others (n,)."""

    observation: Tensor
    final_observation: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    tip: Tensor
    tip_error: Tensor
    reward_tracking: Tensor
    reward_effort: Tensor
    torque_clipped: Tensor
    reason: Tensor


class Equations:
    """The equations of the arm, and the functions of the task made for them; looked up before anything is compiled.

    Args:
        physics: the equations.
    """

    def __init__(self, physics: Physics) -> None:
        """Make the functions."""
        self.physics = physics
        self.numbers, self.angles = size(physics.State), 2 * physics.joints
        self.assess, self.finite = assess_of(physics), finite_of(physics)
        self.resting, self.varied = resting_of(physics), varied_of(physics)
        self.read_state, self.read_draw = _reader(physics.State), _reader(draw_record(physics.joints))
        self.read_row = _reader(row_record(physics.joints, physics.axes))
        self.read_reference = _reader(reference_record(physics.joints))
        self.noise = int(randomness.noise_counter(physics.joints))


def _reader(record: Any) -> Callable[[Iterable[Tensor]], Any]:
    """Return the function that makes a record of its numbers."""
    places_in = places(record)
    return lambda numbers: like(places_in, iter(numbers))


@dataclasses.dataclass(frozen=True)
class Shared:
    """What all lanes share: numbers, which are constants to the compiler, and tables.

    Attributes:
        equations: of the arm.
        plant: the nominal arm, a `Physics.Plant`.
        payload: mass [kg] that the disturbance adds.
        payload_place: where it is, see `Physics.payload_place`.
        noise: standard deviations of measured angles [rad] and velocities [rad/s].
        ranges: low and high of every number of `draw_record`.
        period: control period [s].
        substeps: in it.
        spans: (schedules, 2), first row in `rows` and number of steps.
        starts: (schedules, numbers of `reference_record`), the reference at the start.
        rows: (steps, numbers of `row_record`), the schedules below each other, see `by_step`.
    """

    equations: Equations
    plant: Any
    payload: float
    payload_place: float
    noise: Noise
    ranges: tuple[tuple[float, float], ...]
    period: float
    substeps: int
    spans: Table
    starts: Table
    rows: Table

    def nominal(self) -> Any:
        """Return the plant in tensors of shape ()."""
        return _tensors(self.plant, self.rows)


def advance(shared: Shared, lanes: Lanes, action: Tensor) -> Outcome:
    """Hold torques (joints, n) for one control step; `lanes` are changed in place."""
    new, outcome = following(shared, lanes, action)
    write(lanes, new)
    return outcome


def following(shared: Shared, lanes: Lanes, action: Tensor) -> tuple[Lanes, Outcome]:
    """Return the lanes after torques (joints, n) were held for one control step, and its outcome; nothing changes."""
    equations = shared.equations
    nominal, now, PerJoint = shared.nominal(), drawn(shared, lanes.key), equations.physics.PerJoint
    arm, limits = _arm(shared, nominal, now), equations.physics.limits(nominal)
    beginning, steps = shared.spans.at(now.reference.long())
    row = equations.read_row(shared.rows.at(beginning + lanes.step))
    (mean, change), bias = ([now.force * part for part in parts] for parts in row.force), row.bias

    sound = torch.isfinite(action).all(0)
    asked = PerJoint(*(torch.where(sound, part, 0.0) for part in action.unbind(0)))
    torque = PerJoint(*map(clipped, asked, limits.torque))
    both = PerJoint(*(own + beside for own, beside in zip(torque, bias, strict=True)))
    h = shared.period / shared.substeps
    after_all = held_of(equations.physics)(_state(shared, lanes.numbers), both, mean, change, arm, h, shared.substeps)
    numbers = _numbers(after_all, shared.rows.dtype)
    sound = sound & (equations.finite(equations.read_state(numbers)) > 0.0)
    after = Lanes(_where(sound, numbers, lanes.numbers), lanes.key, lanes.step + 1)
    found = equations.assess(_state(shared, after.numbers), torque, bias, arm, limits, row.target)

    reason = _reason(found, sound)
    terminated = reason > 0
    truncated = ~terminated & (after.step == steps)
    ended = terminated | truncated
    new, new_reference = begin(shared, after.key)
    final, first = observed(shared, after, row.reference), observed(shared, new, new_reference)
    outcome = Outcome(
        stacked(_where(ended, first, final)),
        stacked(final),
        torch.where(sound, found.reward, 0.0),
        terminated,
        truncated,
        torch.stack(list(found.tip)),
        found.tip_error,
        found.reward_tracking,
        found.reward_effort,
        torch.stack([own != told for own, told in zip(torque, asked, strict=True)]).any(0),
        reason,
    )
    return Lanes(_where(ended, new.numbers, after.numbers), *_where(ended, new[1:], after[1:])), outcome


def begin(shared: Shared, key: Tensor) -> tuple[Lanes, Any]:
    """Return the episodes after those with the keys (n,), and their first reference; shapes (n,) or ().

    At rest; the motors hold the gravity torque of the nominal arm.
    """
    equations, key, nominal = shared.equations, word(key, _NEXT_KEY), shared.nominal()
    now = drawn(shared, key)
    reference = equations.read_reference(shared.starts.at(now.reference.long()))
    link = [q + angle for q, angle in zip(reference.q, now.angle, strict=True)]
    still = torch.zeros_like(link[0])
    state = equations.resting(nominal, equations.physics.PerJoint(*map(_angle, link)), still)
    return Lanes(_numbers(state, shared.rows.dtype), key, torch.zeros_like(key)), reference


def write(lanes: Lanes, new: Lanes) -> None:
    """Change lanes in place."""
    for old, row in zip((*lanes.numbers, *lanes[1:]), (*new.numbers, *new[1:]), strict=True):
        old.copy_(row)


def _angle(value: Tensor, rest: Tensor | None = None) -> Any:
    """Return an angle as the physics shall see it: compensated in float32, as it is in float64."""
    if value.dtype == torch.float64:
        return value
    return Angle(value, torch.zeros_like(value) if rest is None else rest)


def _state(shared: Shared, numbers: tuple[Tensor, ...]) -> Any:
    """Return the state as the physics shall see it."""
    angles, count = shared.equations.angles, shared.equations.numbers
    rests = numbers[count:] or (None,) * angles
    return shared.equations.read_state([*map(_angle, numbers[:angles], rests), *numbers[angles:count]])


def _numbers(state: Any, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Return what `_state` was made of; the dtype is lost on the way if torch's default dtype is a longer one."""
    parts = flat(state)
    values = [part.value if isinstance(part, Angle) else part for part in parts]
    rests = [part.rest for part in parts if isinstance(part, Angle)]
    return tuple(part.to(dtype) for part in (*values, *rests))


def observed(shared: Shared, lanes: Lanes, reference: Any) -> list[Tensor]:
    """Return the rows (lanes,) of the observation: motors, with noise if there is any, then the reference."""
    physics, numbers = shared.equations.physics, shared.equations.numbers
    state, limits = shared.equations.read_state(lanes.numbers[:numbers]), physics.limits(shared.nominal())
    motors, joints = [*state.motor, *state.motor_velocity], physics.joints
    if max(shared.noise) > 0.0:
        counter = lanes.step * (2 * joints) + shared.equations.noise
        spreads = [shared.noise.angle] * joints + [shared.noise.velocity] * joints
        for k in range(0, 2 * joints, 2):
            first, second = normal_pair(lanes.key, counter + k, shared.rows.dtype)
            motors[k] = motors[k] + spreads[k] * first
            motors[k + 1] = motors[k + 1] + spreads[k + 1] * second
    lowest, highest = physics.angle_range(limits)
    rooms = [ANGLE_ROOM * (high - low) for low, high in zip(lowest, highest, strict=True)]
    angles = [
        torch.clamp(q, low - room, high + room)
        for q, low, high, room in zip(motors[:joints], lowest, highest, rooms, strict=True)
    ]
    speeds = zip(motors[joints:], limits.velocity, strict=True)
    velocities = [clipped(dq, VELOCITY_ROOM * limit) for dq, limit in speeds]
    return [*angles, *velocities, *reference.q, *reference.dq, *reference.ddq]


def drawn(shared: Shared, key: Tensor) -> Any:
    """Return what the episodes with these keys (n,) drew; numbers are of shape (n,), or () where nothing is drawn."""
    entries = [
        low + (high - low) * uniform(key, _RANDOMISATION + place, shared.rows.dtype)
        if low < high
        else shared.rows.number(low)
        for place, (low, high) in enumerate(shared.ranges)
    ]
    entries[-1] = torch.floor(entries[-1])
    return shared.equations.read_draw(entries)


def _arm(shared: Shared, nominal: Any, now: Any) -> Any:
    """Return the lanes' constants with what they drew and carry."""
    number = shared.rows.number
    return shared.equations.varied(nominal, now, number(shared.payload), number(shared.payload_place))


def _tensors(numbers: Any, rows: Table) -> Any:
    """Return a nested record with its numbers as tensors of shape ()."""
    parts = [_tensors(part, rows) if isinstance(part, tuple) else rows.number(part) for part in numbers]
    return type(numbers)(*parts)


def _reason(found: Any, sound: Tensor) -> Tensor:
    """Return numbers of `Termination` as int64."""
    reason: Tensor = reason_of(1.0 * sound, found.angles_inside, found.velocities_inside)
    return reason.to(torch.int64)


def _where(condition: Tensor, first: Sequence[Tensor], second: Sequence[Tensor]) -> tuple[Tensor, ...]:
    return tuple(torch.where(condition, a, b) for a, b in zip(first, second, strict=True))


def stacked(rows: Sequence[Tensor]) -> Tensor:
    """Return (rows, n) from rows of shape (n,) or (); the first is (n,)."""
    return torch.stack([row.expand_as(rows[0]) for row in rows])


def by_step(schedule: Schedule) -> np.ndarray:
    """Return (steps, columns), a row per control step in the units of a schedule's table.

    Reference and target at the end of the step, force and bias during it.
    """
    table, first_of_step = schedule.table, schedule.columns.force.start
    return np.concatenate([table[1:, :first_of_step], table[:-1, first_of_step:]], axis=-1)
