"""The compiled loops over lanes: begin episodes, and advance every lane by one control step.

One arm and a quarter of a million run this same code. Lanes are worked on in blocks: their numbers are gathered into
one small array, `work`, the plant and the measurements run over it as SIMD code (see `integrator.hold_block`), and the
results are scattered. No lane sees another, so its numbers do not depend on how many others there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch import schedule
from fuzzyarm.envs.batch.randomness import draw, normal_pair, uniform
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import Plant, gravity_torque, loaded, lump
from fuzzyarm.envs.physics.elementwise import select, sine_cosine
from fuzzyarm.envs.physics.integrator import ARM, BLOCK, FORCE, TORQUE, arm_at, hold_block, state_at
from fuzzyarm.envs.scenario.randomisation import Draw, varied
from fuzzyarm.envs.task import Limits, Target, assess, clipped, finite
from fuzzyarm.envs.termination import reason_of

# Rows of `values` (ROWS, lanes), what a lane carries through its episode: the state, the arm's constants, then these.
LIMITS, FORCE_FACTOR, NOISE, ROWS = 28, 34, 35, 37
# Rows of `clock` (4, lanes), integers: table row of the present instant, first and last row, key of the episode.
CURSOR, FIRST, LAST, KEY = 0, 1, 2, 3
# Words of an episode's stream: the key of the lane's next episode, what the episode draws, from 32 on its noise.
NEXT, DRAWN, NOISY = np.uint64(0), np.uint64(1), np.uint64(32)
# Rows of `work` after those of `hold_block`.
W_LIMITS, W_TARGET, W_COMMAND, W_BIAS = 34, 40, 47, 49
W_BEFORE, W_MEASURED, W_FINITE, W_CLIPPED, W_ROWS = 51, 59, 71, 72, 73
# What a control step leaves behind: `vectors` (9, lanes, 2) and `scalars` (10, lanes), named as in the env's info.
VECTORS = (
    "tip",
    "tip_reference",
    "q_motor",
    "dq_motor",
    "q_link",
    "dq_link",
    "torque",
    "friction_torque",
    "external_force",
)
SCALARS = (
    "time",
    "tip_error",
    "circularity_error",
    "circularity_error_motor",
    "reward_tracking",
    "reward_effort",
    "reward",
    "torque_clipped",
    "truncated",
    "reason",
)
# The names in info, the last two as flags; reward, truncated and reason have their own places.
INFO = (*VECTORS, *SCALARS[:6], "in_domain", "torque_clipped")
WIDTH = 10 + 2 * len(VECTORS) + len(SCALARS)


def split(out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the parts of the results of n lanes: observations (n, 10), `VECTORS` (9, n, 2) and `SCALARS` (10, n)."""
    n = len(out) // WIDTH
    return out[: 10 * n].reshape((n, 10)), out[10 * n : 28 * n].reshape((9, n, 2)), out[28 * n :].reshape((10, n))


@kernel
def advance(
    values: np.ndarray,
    clock: np.ndarray,
    table: np.ndarray,
    period: float,
    substeps: int,
    action: np.ndarray,
    start: int,
    stop: int,
    out: np.ndarray,
) -> int:
    """Hold the torques for one control step, in the lanes from `start` to `stop`; nothing happens if one is not finite.

    Args:
        values: (37, lanes), changed in place.
        clock: (4, lanes), changed in place; every lane's cursor must be before its last row.
        table: (rows, 19), the tables of all episodes (`Schedule`) below each other.
        period: control period [s].
        substeps: sub-steps in it.
        action: (lanes, 2) motor torques [N m]; clipped to the limits.
        start: first lane.
        stop: lane after the last.
        out: (38 lanes,), the results of all lanes, see `split`; written.

    Returns:
        The first lane, of all, whose action is not finite, or -1.
    """
    for lane in range(action.shape[0]):
        if not (np.isfinite(action[lane, 0]) and np.isfinite(action[lane, 1])):
            return lane
    work = np.empty(W_ROWS * BLOCK)
    for first in range(start, stop, BLOCK):
        lanes = min(BLOCK, stop - first)
        _advance_block(work, lanes, values, clock, table, action, period, substeps, first, out)
    return -1


@kernel
def advance_one(
    values: np.ndarray,
    clock: np.ndarray,
    table: np.ndarray,
    period: float,
    substeps: int,
    torque1: float,
    torque2: float,
    observation: np.ndarray,
    vectors: np.ndarray,
) -> tuple[float, float, float, float, float, float, float, bool, bool, int]:
    """Do what `advance` does for a batch of one, with half the overhead: what `FuzzyArmEnv.step` calls.

    The same code runs, but compiled for one lane, so that its loops dissolve, and with results that Python need not
    take apart. Arguments as in `advance`.

    Returns:
        The `SCALARS`, the flags as such. If a torque is not finite nothing happens, and the last of them is -1.
    """
    work, action, out = np.empty(W_ROWS * BLOCK), np.empty((1, 2)), np.empty(WIDTH)
    action[0, 0], action[0, 1], out[-1] = torque1, torque2, -1.0
    if np.isfinite(torque1) and np.isfinite(torque2):
        _advance_block(work, 1, values, clock, table, action, period, substeps, 0, out)
        for k in range(10):
            observation[k] = out[k]
        for k in range(len(VECTORS)):
            vectors[k, 0], vectors[k, 1] = out[10 + 2 * k], out[11 + 2 * k]
    flags = out[35] != 0.0, out[36] != 0.0, int(out[37])
    return out[28], out[29], out[30], out[31], out[32], out[33], out[34], flags[0], flags[1], flags[2]


@register_jitable(forceinline=True)
def _advance_block(
    work: np.ndarray,
    lanes: int,
    values: np.ndarray,
    clock: np.ndarray,
    table: np.ndarray,
    action: np.ndarray,
    period: float,
    substeps: int,
    first: int,
    out: np.ndarray,
) -> None:
    """Advance the `lanes` <= BLOCK lanes from `first` on; arguments as in `advance`."""
    _gather(work, lanes, values, first)
    for i in range(lanes):
        row = clock[CURSOR, first + i]
        _gather_target(work, i, table, row + 1)
        for k in range(4):
            work[(FORCE + k) * BLOCK + i] = table[row, schedule.FORCE + k] * values[FORCE_FACTOR, first + i]
        for k in range(2):
            work[(W_BIAS + k) * BLOCK + i] = table[row, schedule.BIAS + k]
            work[(W_COMMAND + k) * BLOCK + i] = action[first + i, k]
        clock[CURSOR, first + i] = row + 1
    _command(work, lanes)
    hold_block(work, lanes, period / substeps, substeps)
    _measure(work, lanes)
    for k in range(8):
        for i in range(lanes):
            values[k, first + i] = work[k * BLOCK + i]
    _report(work, lanes, clock, first, period, out, first)
    for i in range(lanes):
        _observe(values, clock, table, first + i, out, first + i)


@kernel
def begin(
    which: np.ndarray,
    plants: np.ndarray,
    plant_of: np.ndarray,
    episodes: np.ndarray,
    episode_of: np.ndarray,
    ranges: np.ndarray,
    initial: np.ndarray,
    values: np.ndarray,
    clock: np.ndarray,
    drawn: np.ndarray,
    table: np.ndarray,
    period: float,
    out: np.ndarray,
) -> None:
    """Begin a new episode in some lanes, at rest unless told otherwise.

    Args:
        which: (n,) the lanes.
        plants: (plants, 28), the fields of `ArmParameters`.
        plant_of: (lanes,) each lane's plant.
        episodes: (episodes, 7): first and last row of its table, payload [kg] and whether it is at the tip, encoder
            noise of angles and velocities, and whether it is one of a family, of which a reference is drawn.
        episode_of: (n,) the episode to begin, or the first one of the family.
        ranges: (17, 2) what is drawn, see `DomainRandomisation.ranges`.
        initial: (n, 8) states; nan in the first entry: at rest on the reference.
        values: (37, lanes), written.
        clock: (4, lanes), written; holds the key of the lane's last episode before, of this one after.
        drawn: (17, lanes) what was drawn, written; or (17, 0), not written.
        table: (rows, 19).
        period: control period [s].
        out: (38 n,), the results of these lanes, see `split`; written.
    """
    work = np.empty(W_ROWS * BLOCK)
    for position in range(len(which)):
        lane = which[position]
        key = draw(np.uint64(clock[KEY, lane]), NEXT)
        clock[KEY, lane] = np.int64(key)
        now = _draw(key, ranges)
        if drawn.shape[1] > 0:
            for k in range(17):
                drawn[k, lane] = now[k]
        place = episode_of[position]
        if episodes[place, 6] > 0.0:
            place += np.int64(now.reference)
        chosen = episodes[place]
        nominal = _plant(plants[plant_of[lane]])
        gravity, tip = nominal.gravity, nominal.length[1]
        arm = loaded(lump(varied(nominal, now)), chosen[2], tip if chosen[3] > 0.0 else nominal.mass_center[1], gravity)
        arm = loaded(arm, now.payload, tip, gravity)
        for k in range(20):
            values[ARM + k, lane] = arm[k]
        limits = (*nominal.joint_limit, *nominal.velocity_limit, *nominal.torque_limit)
        for k in range(6):
            values[LIMITS + k, lane] = limits[k]
        values[FORCE_FACTOR, lane] = now.force
        values[NOISE, lane], values[NOISE + 1, lane] = chosen[4], chosen[5]
        first = np.int64(chosen[0])
        clock[CURSOR, lane], clock[FIRST, lane], clock[LAST, lane] = first, first, np.int64(chosen[1])
        if np.isnan(initial[position, 0]):
            # The motors hold the gravity torque of the arm as it is known: what was drawn or carried is felt at once.
            q1, q2 = table[first, 0] + now.angle1, table[first, 1] + now.angle2
            gravity1, gravity2 = gravity_torque(sine_cosine(q1)[0], sine_cosine(q1 + q2)[0], lump(nominal))
            values[0, lane], values[2, lane] = q1 + gravity1 / nominal.stiffness[0], q1
            values[1, lane], values[3, lane] = q2 + gravity2 / nominal.stiffness[1], q2
            for k in range(4, 8):
                values[k, lane] = 0.0
        else:
            for k in range(8):
                values[k, lane] = initial[position, k]
        _gather(work, 1, values, lane)
        _gather_target(work, 0, table, first)
        for k in range(W_COMMAND, W_BEFORE):
            work[k * BLOCK] = 0.0
        for k in range(4):
            work[(FORCE + k) * BLOCK] = 0.0
        _command(work, 1)
        _measure(work, 1)
        _report(work, 1, clock, lane, period, out, position)
        _observe(values, clock, table, lane, out, position)


@register_jitable(forceinline=True)
def _gather(work: np.ndarray, lanes: int, values: np.ndarray, first: int) -> None:
    """Copy state, arm and limits of `lanes` lanes from `first` on."""
    # Row by row here and in `_report`: rows may lie a power of two apart, where columns would evict each other.
    for k in range(LIMITS):
        for i in range(lanes):
            work[k * BLOCK + i] = values[k, first + i]
    for k in range(6):
        for i in range(lanes):
            work[(W_LIMITS + k) * BLOCK + i] = values[LIMITS + k, first + i]


@register_jitable(forceinline=True)
def _gather_target(work: np.ndarray, i: int, table: np.ndarray, row: int) -> None:
    for k in range(7):
        work[(W_TARGET + k) * BLOCK + i] = table[row, schedule.TARGET + k]


@register_jitable(forceinline=True)
def _command(work: np.ndarray, lanes: int) -> None:
    """Clip the commanded torques, add the bias, and keep the state in case the step fails."""
    for i in range(lanes):
        asked1, asked2 = work[W_COMMAND * BLOCK + i], work[(W_COMMAND + 1) * BLOCK + i]
        torque1 = clipped(asked1, work[(W_LIMITS + 4) * BLOCK + i])
        torque2 = clipped(asked2, work[(W_LIMITS + 5) * BLOCK + i])
        work[W_CLIPPED * BLOCK + i] = 1.0 * ((torque1 != asked1) | (torque2 != asked2))
        work[W_COMMAND * BLOCK + i], work[(W_COMMAND + 1) * BLOCK + i] = torque1, torque2
        work[TORQUE * BLOCK + i] = torque1 + work[W_BIAS * BLOCK + i]
        work[(TORQUE + 1) * BLOCK + i] = torque2 + work[(W_BIAS + 1) * BLOCK + i]
    for k in range(8):
        for i in range(lanes):
            work[(W_BEFORE + k) * BLOCK + i] = work[k * BLOCK + i]


@register_jitable(forceinline=True)
def _measure(work: np.ndarray, lanes: int) -> None:
    """Put back the states that are not finite, then measure every lane."""
    for i in range(lanes):
        work[W_FINITE * BLOCK + i] = finite(state_at(work, i))
    for k in range(8):
        for i in range(lanes):
            good = work[W_FINITE * BLOCK + i] > 0.0
            work[k * BLOCK + i] = select(good, work[k * BLOCK + i], work[(W_BEFORE + k) * BLOCK + i])
    for i in range(lanes):
        limits = Limits(
            work[W_LIMITS * BLOCK + i],
            work[(W_LIMITS + 1) * BLOCK + i],
            work[(W_LIMITS + 2) * BLOCK + i],
            work[(W_LIMITS + 3) * BLOCK + i],
            work[(W_LIMITS + 4) * BLOCK + i],
            work[(W_LIMITS + 5) * BLOCK + i],
        )
        target = Target(
            work[W_TARGET * BLOCK + i],
            work[(W_TARGET + 1) * BLOCK + i],
            work[(W_TARGET + 2) * BLOCK + i],
            work[(W_TARGET + 3) * BLOCK + i],
            work[(W_TARGET + 4) * BLOCK + i],
            work[(W_TARGET + 5) * BLOCK + i],
            work[(W_TARGET + 6) * BLOCK + i],
        )
        found = assess(
            state_at(work, i),
            work[W_COMMAND * BLOCK + i],
            work[(W_COMMAND + 1) * BLOCK + i],
            work[W_BIAS * BLOCK + i],
            work[(W_BIAS + 1) * BLOCK + i],
            arm_at(work, i),
            limits,
            target,
        )
        work[W_MEASURED * BLOCK + i] = found.tip_x
        work[(W_MEASURED + 1) * BLOCK + i] = found.tip_y
        work[(W_MEASURED + 2) * BLOCK + i] = found.friction_torque1
        work[(W_MEASURED + 3) * BLOCK + i] = found.friction_torque2
        work[(W_MEASURED + 4) * BLOCK + i] = found.tip_error
        work[(W_MEASURED + 5) * BLOCK + i] = found.circularity_error
        work[(W_MEASURED + 6) * BLOCK + i] = found.circularity_error_motor
        work[(W_MEASURED + 7) * BLOCK + i] = found.reward_tracking
        work[(W_MEASURED + 8) * BLOCK + i] = found.reward_effort
        work[(W_MEASURED + 9) * BLOCK + i] = found.reward * work[W_FINITE * BLOCK + i]
        work[(W_MEASURED + 10) * BLOCK + i] = found.angles_inside
        work[(W_MEASURED + 11) * BLOCK + i] = found.velocities_inside


# Where the first row of each of the VECTORS, and each of the SCALARS from tip_error to reward, stands in `work`.
_VECTOR_ROWS = (W_MEASURED, W_TARGET, 0, 4, 2, 6, W_COMMAND, W_MEASURED + 2, FORCE)
_SCALAR_ROWS = tuple(range(W_MEASURED + 4, W_MEASURED + 10))


@register_jitable(forceinline=True)
def _report(
    work: np.ndarray, lanes: int, clock: np.ndarray, first: int, period: float, out: np.ndarray, place: int
) -> None:
    """Write what the `lanes` lanes from `first` on measured to the results from `place` on."""
    total = len(out) // WIDTH
    for k in range(len(_VECTOR_ROWS)):
        row, to = _VECTOR_ROWS[k], 10 * total + 2 * (k * total + place)
        for i in range(lanes):
            out[to + 2 * i] = work[row * BLOCK + i]
            out[to + 2 * i + 1] = work[(row + 1) * BLOCK + i]
    to = 28 * total + place
    for i in range(lanes):
        out[to + i] = (clock[CURSOR, first + i] - clock[FIRST, first + i]) * period
    for k in range(len(_SCALAR_ROWS)):
        for i in range(lanes):
            out[to + (1 + k) * total + i] = work[_SCALAR_ROWS[k] * BLOCK + i]
    for i in range(lanes):
        reason = reason_of(
            work[W_FINITE * BLOCK + i], work[(W_MEASURED + 10) * BLOCK + i], work[(W_MEASURED + 11) * BLOCK + i]
        )
        over = clock[CURSOR, first + i] == clock[LAST, first + i]
        out[to + 7 * total + i] = work[W_CLIPPED * BLOCK + i]
        out[to + 8 * total + i] = 1.0 if reason == 0.0 and over else 0.0
        out[to + 9 * total + i] = reason


@register_jitable(forceinline=True)
def _observe(values: np.ndarray, clock: np.ndarray, table: np.ndarray, lane: int, out: np.ndarray, place: int) -> None:
    """Write the motor readings, with noise if there is any, within the observation space; and the reference."""
    row, to = clock[CURSOR, lane], 10 * place
    for joint in range(2):
        out[to + joint] = values[joint, lane]
        out[to + 2 + joint] = values[4 + joint, lane]
    if values[NOISE, lane] > 0.0 or values[NOISE + 1, lane] > 0.0:
        word = NOISY + np.uint64(4 * (row - clock[FIRST, lane]))
        angles = normal_pair(np.uint64(clock[KEY, lane]), word)
        velocities = normal_pair(np.uint64(clock[KEY, lane]), word + np.uint64(2))
        for joint in range(2):
            out[to + joint] += values[NOISE, lane] * angles[joint]
            out[to + 2 + joint] += values[NOISE + 1, lane] * velocities[joint]
    # Room beyond the box (25): the observation that ends an episode lies outside it.
    for joint in range(2):
        room = 2.0 * values[LIMITS + joint, lane]
        out[to + joint] = min(max(out[to + joint], -room), room)
        room = 10.0 * values[LIMITS + 2 + joint, lane]
        out[to + 2 + joint] = min(max(out[to + 2 + joint], -room), room)
    for k in range(6):
        out[to + 4 + k] = table[row, k]


@register_jitable
def _draw(key: np.uint64, ranges: np.ndarray) -> Draw:
    """Draw an episode: low + (high - low) u, rounded down for the reference."""
    return Draw(
        _between(key, ranges, 0),
        _between(key, ranges, 1),
        _between(key, ranges, 2),
        _between(key, ranges, 3),
        _between(key, ranges, 4),
        _between(key, ranges, 5),
        _between(key, ranges, 6),
        _between(key, ranges, 7),
        _between(key, ranges, 8),
        _between(key, ranges, 9),
        _between(key, ranges, 10),
        _between(key, ranges, 11),
        _between(key, ranges, 12),
        _between(key, ranges, 13),
        _between(key, ranges, 14),
        _between(key, ranges, 15),
        np.floor(_between(key, ranges, 16)),
    )


@register_jitable
def _between(key: np.uint64, ranges: np.ndarray, k: int) -> Any:
    return ranges[k, 0] + (ranges[k, 1] - ranges[k, 0]) * uniform(key, DRAWN + np.uint64(k))


@register_jitable
def _plant(row: np.ndarray) -> Plant:
    """Read a plant from the numbers of `ArmParameters` in their order."""
    return Plant(
        (row[0], row[1]),
        (row[2], row[3]),
        (row[4], row[5]),
        (row[6], row[7]),
        (row[8], row[9]),
        row[10],
        (row[11], row[12]),
        (row[13], row[14]),
        (row[15], row[16]),
        (row[17], row[18]),
        (row[19], row[20]),
        row[21],
        (row[22], row[23]),
        (row[24], row[25]),
        (row[26], row[27]),
    )
