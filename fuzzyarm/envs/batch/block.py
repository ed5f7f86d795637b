"""One control step of a block of lanes: its numbers are gathered into `work`, advanced, assessed and reported.

`work` is a flat array of shape (rows of `layout.Work` times `BLOCK`,). The physics and the assessment run over it as
SIMD code (`integrator.hold_block`). No lane sees another, so its numbers do not depend on how many others there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.layout import CLOCK, LANE, PLANAR, SCALARS, WORK, Lane, Noise, Results, Scalars, Vectors, Work
from fuzzyarm.envs.batch.randomness import NOISE, NOISE_NUMBERS, normal_pair
from fuzzyarm.envs.batch.schedule import COLUMNS, Row
from fuzzyarm.envs.observation import JOINTS, SIZE, START
from fuzzyarm.envs.physics.dynamics import Arm, State
from fuzzyarm.envs.physics.elementwise import select
from fuzzyarm.envs.physics.integrator import ForceLine, hold_block
from fuzzyarm.envs.physics.readings import link_angles, link_velocities, motor_angles, motor_velocities
from fuzzyarm.envs.physics.records import (
    BLOCK,
    PerJoint,
    Point,
    columns,
    in_block,
    in_columns,
    in_rows,
    places,
    reader,
    size,
    writer,
)
from fuzzyarm.envs.task import Assessment, Limits, Target, assess, clipped, finite
from fuzzyarm.envs.termination import reason_of

__all__ = [
    "advance_block",
    "assess_block",
    "clip",
    "gather",
    "gather_target",
    "inside",
    "observe",
    "report",
    "write_at_rest",
    "write_command",
]

# What the observation space allows beyond the box (25): the observation that ends an episode lies outside the box.
ANGLE_ROOM, VELOCITY_ROOM = 2.0, 10.0

# Readers and writers of records in `work`, at a lane of the block.
_read_arm = reader(Arm, in_block, WORK.hold.arm)
_read_state, _write_state = reader(State, in_block, WORK.hold.state), writer(State, in_block, WORK.hold.state)
_read_before, _write_before = reader(State, in_block, WORK.before), writer(State, in_block, WORK.before)
_read_limits = reader(Limits, in_block, WORK.limits)
_read_target, _write_target = reader(Target, in_block, WORK.target), writer(Target, in_block, WORK.target)
_read_command, write_command = reader(PerJoint, in_block, WORK.command), writer(PerJoint, in_block, WORK.command)
_read_bias, _write_bias = reader(PerJoint, in_block, WORK.bias), writer(PerJoint, in_block, WORK.bias)
_write_torque = writer(PerJoint, in_block, WORK.hold.torque)
_write_force = writer(ForceLine, in_block, WORK.hold.force)
_write_assessment = writer(Assessment, in_block, WORK.assessment)
_lane_state, _lane_limits = reader(State, in_rows, LANE.state), reader(Limits, in_rows, LANE.limits)
_lane_noise = reader(Noise, in_rows, LANE.noise)
_row = reader(Row, in_columns)

# First row of a part of a lane in `values` and in `work`, and how many rows it has.
_STATE = columns(Lane).state.start, WORK.hold.state[0], size(State)
_ARM = columns(Lane).arm.start, WORK.hold.arm[0], size(Arm)
_LIMITS = columns(Lane).limits.start, columns(Work).limits.start, size(Limits)
_BEFORE = columns(Work).before.start

_S = places(Scalars)
_REFERENCE, _REFERENCE_COLUMNS = START.q_reference, COLUMNS.reference.stop


@register_jitable(forceinline=True)
def advance_block(
    work: np.ndarray,
    lanes: int,
    values: np.ndarray,
    clock: np.ndarray,
    table: np.ndarray,
    period: float,
    substeps: int,
    first: int,
    results: Results,
) -> None:
    """Advance the `lanes` <= BLOCK lanes from `first` on, whose commands are in `work`; arguments as in `advance`."""
    gather(work, lanes, values, first)
    for i in range(lanes):
        at = inside(clock[CLOCK.row, first + i], len(table) - 1)
        now, factor = _row(table, at), values[LANE.force_factor, first + i]
        mean, change = now.force.mean, now.force.change
        _write_force(
            work, i, ForceLine(Point(mean.x * factor, mean.y * factor), Point(change.x * factor, change.y * factor))
        )
        _write_bias(work, i, now.bias)
        gather_target(work, i, table, at + 1)
        clock[CLOCK.row, first + i] = at + 1
    clip(work, lanes)
    hold_block(work, lanes, period / substeps, substeps)
    assess_block(work, lanes)
    _copy_back(work, lanes, values, first)
    report(work, lanes, clock, first, period, results, first)
    for i in range(lanes):
        observe(values, clock, table, first + i, results, first + i)


@register_jitable(forceinline=True)
def inside(row: int, rows: int) -> int:
    """Return a row of a table: the given one, except where several threads use an environment, which is for one only.

    Its results are wrong then, but nothing beyond the table is read.
    """
    return min(max(row, 0), rows - 1)


@register_jitable(forceinline=True)
def gather(work: np.ndarray, lanes: int, values: np.ndarray, first: int) -> None:
    """Copy state, arm and limits of `lanes` lanes from `first` on."""
    # Row by row here and in `report`: rows may lie a power of two apart, where columns would evict each other.
    _gather_part(work, lanes, values, first, _STATE)
    _gather_part(work, lanes, values, first, _ARM)
    _gather_part(work, lanes, values, first, _LIMITS)


@register_jitable(forceinline=True)
def _gather_part(work: np.ndarray, lanes: int, values: np.ndarray, first: int, part: tuple[int, int, int]) -> None:
    source, target, rows = part
    for k in range(rows):
        for i in range(lanes):
            work[(target + k) * BLOCK + i] = values[source + k, first + i]


@register_jitable(forceinline=True)
def _copy_back(work: np.ndarray, lanes: int, values: np.ndarray, first: int) -> None:
    """Keep the new state."""
    target, source, rows = _STATE
    for k in range(rows):
        for i in range(lanes):
            values[target + k, first + i] = work[(source + k) * BLOCK + i]


@register_jitable(forceinline=True)
def write_at_rest(work: np.ndarray, i: int) -> None:
    """Write no command, no bias and no force for lane i of the block."""
    nothing, no_force = PerJoint(0.0, 0.0), Point(0.0, 0.0)
    write_command(work, i, nothing)
    _write_bias(work, i, nothing)
    _write_force(work, i, ForceLine(no_force, no_force))


@register_jitable(forceinline=True)
def gather_target(work: np.ndarray, i: int, table: np.ndarray, row: int) -> None:
    """Copy what the tip of lane i of the block is compared with."""
    _write_target(work, i, _row(table, row).target)


@register_jitable(forceinline=True)
def clip(work: np.ndarray, lanes: int) -> None:
    """Clip the commanded torques, add the bias, and keep the state in case the step fails."""
    for i in range(lanes):
        asked, bias, limit = _read_command(work, i), _read_bias(work, i), _read_limits(work, i).torque
        torque = PerJoint(clipped(asked.joint1, limit.joint1), clipped(asked.joint2, limit.joint2))
        beyond = (torque.joint1 != asked.joint1) | (torque.joint2 != asked.joint2)
        work[WORK.clipped * BLOCK + i] = 1.0 * beyond
        write_command(work, i, torque)
        _write_torque(work, i, PerJoint(torque.joint1 + bias.joint1, torque.joint2 + bias.joint2))
    for i in range(lanes):
        _write_before(work, i, _read_state(work, i))


@register_jitable(forceinline=True)
def assess_block(work: np.ndarray, lanes: int) -> None:
    """Put back the states that are not finite, then assess every lane."""
    for i in range(lanes):
        work[WORK.finite * BLOCK + i] = finite(_read_state(work, i))
    _, state, rows = _STATE
    for k in range(rows):
        for i in range(lanes):
            good = work[WORK.finite * BLOCK + i] > 0.0
            work[(state + k) * BLOCK + i] = select(good, work[(state + k) * BLOCK + i], work[(_BEFORE + k) * BLOCK + i])
    for i in range(lanes):
        found = assess(
            _read_state(work, i),
            _read_command(work, i),
            _read_bias(work, i),
            _read_arm(work, i),
            _read_limits(work, i),
            _read_target(work, i),
        )
        _write_assessment(work, i, found)
        work[WORK.assessment.reward * BLOCK + i] = found.reward * work[WORK.finite * BLOCK + i]


# Where the first number of each of the vectors stands in `work`, and of the scalars from `tip_error` to `reward`.
_VECTOR_ROWS = Vectors(
    tip=WORK.assessment.tip.x,
    tip_reference=WORK.target.position.x,
    q_motor=motor_angles(WORK.hold.state)[0],
    dq_motor=motor_velocities(WORK.hold.state)[0],
    q_link=link_angles(WORK.hold.state)[0],
    dq_link=link_velocities(WORK.hold.state)[0],
    torque=WORK.command[0],
    friction_torque=WORK.assessment.friction_torque[0],
    external_force=WORK.hold.force.mean.x,
)
_COPIED_FIRST = _S.tip_error
_SCALAR_ROWS = tuple(getattr(WORK.assessment, name) for name in SCALARS[_S.tip_error : _S.torque_clipped])


@register_jitable(forceinline=True)
def report(
    work: np.ndarray, lanes: int, clock: np.ndarray, first: int, period: float, results: Results, place: int
) -> None:
    """Write what the `lanes` lanes from `first` on have come to into the flat results from `place` on."""
    vectors, scalars, total = results.vectors, results.scalars, len(results.scalars) // len(SCALARS)
    for k in range(len(_VECTOR_ROWS)):
        row, to = _VECTOR_ROWS[k], PLANAR * (k * total + place)
        for i in range(lanes):
            vectors[to + PLANAR * i] = work[row * BLOCK + i]
            vectors[to + PLANAR * i + 1] = work[(row + 1) * BLOCK + i]
    for i in range(lanes):
        scalars[_S.time * total + place + i] = (clock[CLOCK.row, first + i] - clock[CLOCK.first, first + i]) * period
    for k in range(len(_SCALAR_ROWS)):
        for i in range(lanes):
            scalars[(_COPIED_FIRST + k) * total + place + i] = work[_SCALAR_ROWS[k] * BLOCK + i]
    for i in range(lanes):
        reason = reason_of(
            work[WORK.finite * BLOCK + i],
            work[WORK.assessment.angles_inside * BLOCK + i],
            work[WORK.assessment.velocities_inside * BLOCK + i],
        )
        over = clock[CLOCK.row, first + i] == clock[CLOCK.last, first + i]
        scalars[_S.torque_clipped * total + place + i] = work[WORK.clipped * BLOCK + i]
        scalars[_S.truncated * total + place + i] = 1.0 if reason == 0.0 and over else 0.0
        scalars[_S.reason * total + place + i] = reason


@register_jitable(forceinline=True)
def observe(values: np.ndarray, clock: np.ndarray, table: np.ndarray, lane: int, results: Results, place: int) -> None:
    """Write the motor readings, with noise if there is any, within the observation space; and the reference."""
    observation, row, to = results.observation, inside(clock[CLOCK.row, lane], len(table)), SIZE * place
    state, limits, noise = _lane_state(values, lane), _lane_limits(values, lane), _lane_noise(values, lane)
    angles, velocities = motor_angles(state), motor_velocities(state)
    if noise.angle > 0.0 or noise.velocity > 0.0:
        key, word = np.uint64(clock[CLOCK.key, lane]), NOISE + NOISE_NUMBERS * np.uint64(row - clock[CLOCK.first, lane])
        angles = _noisy(angles, noise.angle, normal_pair(key, word))
        velocities = _noisy(velocities, noise.velocity, normal_pair(key, word + np.uint64(JOINTS)))
    for joint in range(JOINTS):
        room = ANGLE_ROOM * limits.angle[joint]
        observation[to + START.q_motor + joint] = min(max(angles[joint], -room), room)
        room = VELOCITY_ROOM * limits.velocity[joint]
        observation[to + START.dq_motor + joint] = min(max(velocities[joint], -room), room)
    for k in range(_REFERENCE_COLUMNS):
        observation[to + _REFERENCE + k] = table[row, k]


@register_jitable(forceinline=True)
def _noisy(values: PerJoint, spread: Any, normal: tuple[Any, Any]) -> PerJoint:
    """Return values + spread · normal, joint by joint."""
    return PerJoint(values[0] + spread * normal[0], values[1] + spread * normal[1])
