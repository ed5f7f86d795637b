"""One control step of the arm in tensors: the physics and the assessment of `fuzzyarm.envs`, line for line.

Nothing here waits for the device or depends on data: lanes that end begin anew by selection.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from fuzzyarm.envs.batch import randomness
from fuzzyarm.envs.batch.block import ANGLE_ROOM, VELOCITY_ROOM
from fuzzyarm.envs.batch.layout import Noise
from fuzzyarm.envs.batch.schedule import COLUMNS, ReferenceRow, Row
from fuzzyarm.envs.physics import integrator
from fuzzyarm.envs.physics.dynamics import Arm, Plant, State, loaded, lump
from fuzzyarm.envs.physics.readings import at_rest, motor_angles, motor_velocities, static_deflection
from fuzzyarm.envs.physics.records import JOINTS, PerJoint, in_list, reader, size
from fuzzyarm.envs.scenario.randomisation import Draw, varied
from fuzzyarm.envs.task import Assessment, Limits, assess, clipped, finite
from fuzzyarm.envs.termination import reason_of
from fuzzyarm.rl_baselines.torch_numbers import Angle, Table, normal_pair, uniform, word

__all__ = [
    "ANGLES",
    "STATE_SIZE",
    "Lanes",
    "Outcome",
    "Shared",
    "advance",
    "begin",
    "by_step",
    "drawn",
    "observed",
    "stacked",
    "write",
]

STATE_SIZE = size(State)  # how many numbers the state of an arm is
ANGLES = STATE_SIZE // 2  # of motors and links; the other half are their velocities

# Counters of an episode's random stream as plain integers, which torch.compile takes for constants.
_NEXT_KEY, _RANDOMISATION, _NOISE, _NOISE_NUMBERS = map(
    int, (randomness.NEXT_KEY, randomness.RANDOMISATION, randomness.NOISE, randomness.NOISE_NUMBERS)
)
_read_row, _read_reference, _read_draw = reader(Row, in_list), reader(ReferenceRow, in_list), reader(Draw, in_list)


class Lanes(NamedTuple):
    """What a lane carries from step to step, (n,) each; all else follows from it.

    The numbers of its state, in float32 followed by the rests of its four angles; the key of the episode's random
    stream, and its steps so far, both int64.
    """

    numbers: tuple[Tensor, ...]
    key: Tensor
    step: Tensor


class Outcome(NamedTuple):
    """What a step returns; observations (10, n), tips (2, n), the others (n,)."""

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


@dataclasses.dataclass(frozen=True)
class Shared:
    """What all lanes share: numbers, which are constants to the compiler, and tables.

    Attributes:
        plant: the nominal arm.
        payload: mass [kg] that the disturbance adds.
        payload_radius: its distance from joint 2 [m].
        noise: standard deviations of measured angles [rad] and velocities [rad/s].
        ranges: low and high of every number of `Draw`.
        period: control period [s].
        substeps: in it.
        spans: (schedules, 2), first row in `rows` and number of steps, a `Span`.
        starts: (schedules, numbers of `ReferenceRow`), the reference at the start.
        rows: (steps, numbers of `Row`), the schedules below each other, see `by_step`.
    """

    plant: Plant
    payload: float
    payload_radius: float
    noise: Noise
    ranges: tuple[tuple[float, float], ...]
    period: float
    substeps: int
    spans: Table
    starts: Table
    rows: Table

    def nominal(self) -> Plant:
        """Return the plant in tensors of shape ()."""
        number = self.rows.number
        tensors: list[Any] = [PerJoint(*map(number, v)) if isinstance(v, tuple) else number(v) for v in self.plant]
        return Plant(*tensors)


def advance(shared: Shared, lanes: Lanes, action: Tensor) -> Outcome:
    """Hold torques (2, n) for one control step; `lanes` are changed in place."""
    nominal, now = shared.nominal(), drawn(shared, lanes.key)
    arm, limits = _arm(shared, nominal, now), _limits(nominal)
    beginning, steps = shared.spans.at(now.reference.long())
    row = _read_row(shared.rows.at(beginning + lanes.step), 0)
    force, bias = [now.force * part for part in (*row.force.mean, *row.force.change)], row.bias

    sound = torch.isfinite(action[0]) & torch.isfinite(action[1])
    asked = PerJoint(*(torch.where(sound, part, 0.0) for part in action.unbind(0)))
    torque = PerJoint(clipped(asked.joint1, limits.torque.joint1), clipped(asked.joint2, limits.torque.joint2))
    held = PerJoint(torque.joint1 + bias.joint1, torque.joint2 + bias.joint2)
    h = shared.period / shared.substeps
    numbers = _numbers(integrator.held(_state(lanes.numbers), held, force, arm, h, shared.substeps), shared.rows.dtype)
    sound = sound & (finite(State(*numbers[:STATE_SIZE])) > 0.0)
    after = Lanes(_where(sound, numbers, lanes.numbers), lanes.key, lanes.step + 1)
    found = assess(_state(after.numbers), torque, bias, arm, limits, row.target)

    reason = _reason(found, sound)
    terminated = reason > 0
    truncated = ~terminated & (after.step == steps)
    ended = terminated | truncated
    new, new_reference = begin(shared, after.key)
    final, first = observed(shared, after, row.reference), observed(shared, new, new_reference)
    write(lanes, Lanes(_where(ended, new.numbers, after.numbers), *_where(ended, new[1:], after[1:])))
    return Outcome(
        stacked(_where(ended, first, final)),
        stacked(final),
        torch.where(sound, found.reward, 0.0),
        terminated,
        truncated,
        torch.stack(list(found.tip)),
        found.tip_error,
        found.reward_tracking,
        found.reward_effort,
        (torque.joint1 != asked.joint1) | (torque.joint2 != asked.joint2),
        reason,
    )


def begin(shared: Shared, key: Tensor) -> tuple[Lanes, ReferenceRow]:
    """Return the episodes after those with the keys (n,), and their first reference; shapes (n,) or ().

    At rest; the motors hold the gravity torque of the nominal arm.
    """
    key, nominal = word(key, _NEXT_KEY), shared.nominal()
    now = drawn(shared, key)
    reference = _read_reference(shared.starts.at(now.reference.long()), 0)
    link = PerJoint(*(q + angle for q, angle in zip(reference.q, now.angle, strict=True)))
    state = at_rest(PerJoint(*map(_angle, link)), static_deflection(link, nominal), torch.zeros_like(link.joint1))
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


def _state(numbers: tuple[Tensor, ...]) -> State:
    """Return the state as the physics shall see it."""
    rests = numbers[STATE_SIZE:] or (None,) * ANGLES
    return State(*map(_angle, numbers[:ANGLES], rests), *numbers[ANGLES:STATE_SIZE])


def _numbers(state: State, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Return what `_state` was made of; the dtype is lost on the way if torch's default dtype is a longer one."""
    values = (part.value if isinstance(part, Angle) else part for part in state)
    rests = (part.rest for part in state if isinstance(part, Angle))
    return tuple(part.to(dtype) for part in (*values, *rests))


def observed(shared: Shared, lanes: Lanes, reference: ReferenceRow) -> list[Tensor]:
    """Return the ten rows (lanes,) of the observation: motors, with noise if there is any, then the reference."""
    state, limits = State(*lanes.numbers[:STATE_SIZE]), _limits(shared.nominal())
    motors = [motor_angles(state), motor_velocities(state)]
    if max(shared.noise) > 0.0:
        counter = lanes.step * _NOISE_NUMBERS + _NOISE
        for part, spread in enumerate(shared.noise):
            normal = normal_pair(lanes.key, counter + JOINTS * part, shared.rows.dtype)
            motors[part] = PerJoint(*(value + spread * n for value, n in zip(motors[part], normal, strict=True)))
    angles = [clipped(q, ANGLE_ROOM * limit) for q, limit in zip(motors[0], limits.angle, strict=True)]
    velocities = [clipped(dq, VELOCITY_ROOM * limit) for dq, limit in zip(motors[1], limits.velocity, strict=True)]
    return [*angles, *velocities, *reference.q, *reference.dq, *reference.ddq]


def drawn(shared: Shared, key: Tensor) -> Draw:
    """Return what the episodes with these keys (n,) drew; numbers are of shape (n,), or () where nothing is drawn."""
    entries = [
        low + (high - low) * uniform(key, _RANDOMISATION + place, shared.rows.dtype)
        if low < high
        else shared.rows.number(low)
        for place, (low, high) in enumerate(shared.ranges)
    ]
    entries[-1] = torch.floor(entries[-1])
    now: Draw = _read_draw(entries, 0)
    return now


def _arm(shared: Shared, nominal: Plant, now: Draw) -> Arm:
    """Return the lanes' constants with what they drew and carry."""
    number = shared.rows.number
    arm: Arm = loaded(
        lump(varied(nominal, now)), number(shared.payload), number(shared.payload_radius), nominal.gravity
    )
    return Arm(*loaded(arm, now.payload, nominal.length[1], nominal.gravity))


def _limits(plant: Plant) -> Limits:
    return Limits(plant.joint_limit, plant.velocity_limit, plant.torque_limit)


def _reason(found: Assessment, sound: Tensor) -> Tensor:
    """Return numbers of `Termination` as int64."""
    reason: Tensor = reason_of(1.0 * sound, found.angles_inside, found.velocities_inside)
    return reason.to(torch.int64)


def _where(condition: Tensor, first: Sequence[Tensor], second: Sequence[Tensor]) -> tuple[Tensor, ...]:
    return tuple(torch.where(condition, a, b) for a, b in zip(first, second, strict=True))


def stacked(rows: Sequence[Tensor]) -> Tensor:
    """Return (rows, n) from rows of shape (n,) or (); the first is (n,)."""
    return torch.stack([row.expand_as(rows[0]) for row in rows])


def by_step(table: np.ndarray) -> np.ndarray:
    """Return a row per control step, in the units of `Row`: reference and target at its end, force and bias during it.

    `table` has the shape (steps + 1, columns), the result one row less.
    """
    first_of_step = COLUMNS.force.start
    return np.concatenate([table[1:, :first_of_step], table[:-1, first_of_step:]], axis=-1)
