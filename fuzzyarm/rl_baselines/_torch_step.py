"""One control step of the arm in tensors: the functions of `fuzzyarm.envs`, called with tensors.

Nothing here waits for the device or branches on data: lanes that end restart by selection.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from fuzzyarm.envs.batch.layout import Noise
from fuzzyarm.envs.batch.randomness import NEXT_KEY, draw
from fuzzyarm.envs.batch.schedule import Schedule, reference_record, row_record
from fuzzyarm.envs.control_step import assessed, drawn_of, reading_of, resting
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import Physics, flat, places, size
from fuzzyarm.envs.task import Termination, clipped
from fuzzyarm.numbers.functions import like, select
from fuzzyarm.rl_baselines._torch_numbers import Angle, TorchTable, TorchWord

__all__ = [
    "Equations", "LaneData", "Outcome", "Shared", "advance", "begin", "by_step", "drawn", "following", "observed",
    "stacked", "write",
]  # fmt: skip


_LOST = int(Termination.LOST)


class LaneData(NamedTuple):
    """The data of the lanes between steps, of shape (n,) each; everything else follows from them.

    `numbers` are the entries of the state; in float32, the angles' rounding errors follow them. `key` is the key
    of the episode's random stream and `step` the number of steps of the episode so far, both int64.
    """

    numbers: tuple[Tensor, ...]
    key: Tensor
    step: Tensor


Outcome: TypeAlias = tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Tensor]]
"""What a step returns, see `TorchFuzzyArm.step`."""


class Equations:
    """The arm's equations, and functions of a control step that use them, made before torch compiles the step."""

    def __init__(self, physics: Physics) -> None:
        self.physics = physics
        self.numbers, self.angles = size(physics.State), 2 * physics.joints
        self.held, self.reading, self.drawn = held_of(physics), reading_of(physics), drawn_of(physics.joints)
        self.read_state = _reader(physics.State)
        self.read_row = _reader(row_record(physics.joints, physics.axes))
        self.read_reference = _reader(reference_record(physics.joints))


def _reader(record: Any) -> Callable[[Iterable[Tensor]], Any]:
    """Return the function that builds a `record` from a sequence of its numbers."""
    places_in = places(record)
    return lambda numbers: like(places_in, iter(numbers))


@dataclasses.dataclass(frozen=True)
class Shared:
    """Data shared by all lanes: numbers, which are constants to the compiler, and tables."""

    equations: Equations  # of the arm
    plant: Any  # the nominal arm, a `Physics.Plant`
    payload: float  # mass [kg] that the disturbance adds
    payload_place: float  # place of that mass, see `Physics.payload_place`
    noise: Noise  # standard deviations of measured angles [rad] and velocities [rad/s]
    ranges: tuple[tuple[float, float], ...]  # low and high of every entry of `draw_record`
    period: float  # control period [s]
    substeps: int  # in a control period
    spans: TorchTable  # (schedules, 2), first row in `rows` and number of steps
    starts: TorchTable  # (schedules, size of `reference_record`), the reference at the start
    rows: TorchTable  # (steps, size of `row_record`), the schedules one after another, see `by_step`
    early_end: float  # tip error [m] beyond which an episode ends

    def nominal(self) -> Any:
        """Return the nominal arm with its parameters as tensors of shape ()."""
        return _tensors(self.plant, self.rows)


def advance(shared: Shared, lanes: LaneData, action: Tensor) -> Outcome:
    """Hold torques (joints, n) [N m] for one control step; change `lanes` in place and return the outcome."""
    new, outcome = following(shared, lanes, action)
    write(lanes, new)
    return outcome


def following(shared: Shared, lanes: LaneData, action: Tensor) -> tuple[LaneData, Outcome]:
    """Return the lanes after one control step with torques (joints, n) [N m], and its outcome; no side effects."""
    equations = shared.equations
    nominal, now, PerJoint = shared.nominal(), drawn(shared, lanes.key), equations.physics.PerJoint
    limits, number = equations.physics.limits(nominal), shared.rows.number
    physics, carried = equations.physics, (number(shared.payload), number(shared.payload_place), now.payload)
    arm = physics.constants(physics.varied(nominal, now), *carried)
    beginning, steps = shared.spans.at(now.reference.long())
    row = equations.read_row(shared.rows.at(beginning + lanes.step))
    (mean, change), bias = ([now.force * part for part in parts] for parts in row.force), row.bias

    sound = torch.isfinite(action).all(0)
    asked = PerJoint(*(torch.where(sound, part, 0.0) for part in action.unbind(0)))
    torque = PerJoint(*map(clipped, asked, limits.torque))
    both = PerJoint(*(own + beside for own, beside in zip(torque, bias, strict=True)))
    h, before = shared.period / shared.substeps, _state(shared, lanes.numbers)
    reached = equations.held(before, both, mean, change, arm, h, shared.substeps)
    # An action that is not finite has the effect of a step to an infinite state.
    reached = like(reached, (select(sound, part, float("nan")) for part in flat(reached)))
    moved = assessed(physics, before, reached, asked, torque, bias, mean, row.target, arm, limits)
    found, dtype = moved.found, shared.rows.dtype
    after = LaneData(_numbers(moved.state, dtype), lanes.key, lanes.step + 1)

    reason = moved.reason.to(torch.int64)
    if shared.early_end < math.inf:
        reason = torch.where((found.tip_error > shared.early_end) & (reason == 0), _LOST, reason)
    terminated = reason > 0
    truncated = ~terminated & (after.step == steps)
    ended = terminated | truncated
    new, new_reference = begin(shared, after.key)
    final, first = observed(shared, after, row.reference), observed(shared, new, new_reference)
    info = {
        "final_obs": stacked(final),
        "tip": stacked(found.tip),
        **{name: getattr(found, name) for name in ("tip_error", "reward_tracking", "reward_effort")},
        "torque_clipped": moved.clipped > 0.0,
        "reason": reason,
    }
    outcome = stacked(_where(ended, first, final)), found.reward.to(dtype), terminated, truncated, info
    return LaneData(_where(ended, new.numbers, after.numbers), *_where(ended, new[1:], after[1:])), outcome


def begin(shared: Shared, key: Tensor) -> tuple[LaneData, Any]:
    """Return the lanes at the start of their next episodes, and the reference there.

    `key` (n,) contains the keys of the preceding episodes. Tensors are (n,), or () if equal for all lanes. The lanes
    begin at rest; the motors hold the gravity torque of the nominal arm.
    """
    equations, key, nominal = shared.equations, draw(TorchWord(key, shared.rows.dtype), NEXT_KEY).bits, shared.nominal()
    now = drawn(shared, key)
    reference = equations.read_reference(shared.starts.at(now.reference.long()))
    link = [q + angle for q, angle in zip(reference.q, now.angle, strict=True)]
    still = torch.zeros_like(link[0])
    state = resting(equations.physics, nominal, equations.physics.PerJoint(*map(_angle, link)), still)
    return LaneData(_numbers(state, shared.rows.dtype), key, torch.zeros_like(key)), reference


def write(lanes: LaneData, new: LaneData) -> None:
    """Overwrite `lanes` with `new`, in place."""
    for old, row in zip((*lanes.numbers, *lanes[1:]), (*new.numbers, *new[1:]), strict=True):
        old.copy_(row)


def _angle(value: Tensor, rest: Tensor | None = None) -> Any:
    """Return `value` [rad] for the physics: in float32 an `Angle` with its rounding error `rest`, in float64 itself."""
    if value.dtype == torch.float64:
        return value
    return Angle(value, torch.zeros_like(value) if rest is None else rest)


def _state(shared: Shared, numbers: tuple[Tensor, ...]) -> Any:
    """Return the arm's state, for the equations, from the `numbers` of `LaneData`."""
    angles, count = shared.equations.angles, shared.equations.numbers
    rests = numbers[count:] or (None,) * angles
    return shared.equations.read_state([*map(_angle, numbers[:angles], rests), *numbers[angles:count]])


def _numbers(state: Any, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Return the `LaneData.numbers` of a state in `dtype`; a step may have widened them to torch's default dtype."""
    parts = flat(state)
    values = [part.value if isinstance(part, Angle) else part for part in parts]
    rests = [part.rest for part in parts if isinstance(part, Angle)]
    return tuple(part.to(dtype) for part in (*values, *rests))


def observed(shared: Shared, lanes: LaneData, reference: Any) -> list[Tensor]:
    """Return the entries of the observations, tensors (n,): motor angles and velocities with noise, then references."""
    equations = shared.equations
    state, limits = equations.read_state(lanes.numbers[: equations.numbers]), equations.physics.limits(shared.nominal())
    q, dq = equations.reading(state, limits, shared.noise, TorchWord(lanes.key, shared.rows.dtype), lanes.step)
    return [*q, *dq, *reference.q, *reference.dq, *reference.ddq]


def drawn(shared: Shared, key: Tensor) -> Any:
    """Return the random quantities of the episodes with keys (n,) as a record; numbers are (n,), or () if fixed."""
    return _tensors(shared.equations.drawn(TorchWord(key, shared.rows.dtype), shared.ranges), shared.rows)


def _tensors(numbers: Any, rows: TorchTable) -> Any:
    """Return a nested record with its Python numbers as tensors of shape (), on the device of `rows`."""
    parts = flat(numbers)
    return like(numbers, (part if isinstance(part, Tensor) else rows.number(part) for part in parts))


def _where(condition: Tensor, first: Sequence[Tensor], second: Sequence[Tensor]) -> tuple[Tensor, ...]:
    return tuple(torch.where(condition, a, b) for a, b in zip(first, second, strict=True))


def stacked(rows: Sequence[Tensor]) -> Tensor:
    """Return a tensor (n, rows) whose columns are `rows` of shape (n,) or (); the first row must be (n,)."""
    return torch.stack([row.expand_as(rows[0]) for row in rows]).t()


def by_step(schedule: Schedule) -> np.ndarray:
    """Return an array (steps, columns) with one row per control step, in the units of the schedule's table.

    A row contains the reference and target at the end of the step, and the force and bias during the step.
    """
    table, first_of_step = schedule.table, schedule.columns.force.start
    return np.concatenate([table[1:, :first_of_step], table[:-1, first_of_step:]], axis=-1)
