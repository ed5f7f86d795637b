"""The compiled control step: hold the torques in every lane, or in the single arm.

One arm and a quarter of a million run the same code, block by block: the actions are written into the block `work`
(`layout.Work`), `integrator.hold_block` reads its records (`State`, `Arm`, ...) and advances them, and what
`task.assess` finds goes from the block into the `layout.Results`, which the environments return.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64

from fuzzyarm.envs.batch.block import advance_block, observe, write_command
from fuzzyarm.envs.batch.layout import PLANAR, VECTORS, WIDTH, Scalars, Work, parts
from fuzzyarm.envs.observation import SIZE
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.records import BLOCK, PerJoint, in_columns, in_list, reader, size

__all__ = ["advance", "advance_one", "observe_again", "prepare"]

_WORK_SIZE = size(Work) * BLOCK
_read_scalars = reader(Scalars, in_list)
_read_action = reader(PerJoint, in_columns)
_NOT_FINITE = -1

# Types of the arguments: of both kernels, of `advance` alone, of `advance_one` alone.
_ARRAYS = (float64[:, ::1], int64[:, ::1], float64[:, ::1], float64, int64)
_ADVANCE = (*_ARRAYS, float64[:, ::1], int64, int64, float64[::1])
_ADVANCE_ONE = (*_ARRAYS, float64, float64, float64[::1], float64[:, ::1])


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
    """Hold the torques for one control step, in the lanes from `start` to `stop`; no lane moves if one is not finite.

    Args:
        values: (numbers of `Lane`, lanes), changed in place.
        clock: (numbers of `Clock`, lanes), changed in place; every lane must be before its last row.
        table: (rows, numbers of `Row`), the schedules of all episodes below each other.
        period: control period [s].
        substeps: sub-steps in it.
        action: (lanes, 2) motor torques [N m]; clipped to the limits.
        start: first lane.
        stop: lane after the last.
        out: (WIDTH lanes,), the results of all lanes, see `split`; written.

    Returns:
        The first lane, of all, whose action is not finite, or -1.
    """
    for lane in range(action.shape[0]):
        if not (np.isfinite(action[lane, 0]) and np.isfinite(action[lane, 1])):
            return lane
    work, results = np.empty(_WORK_SIZE), parts(out)
    for first in range(start, stop, BLOCK):
        lanes = min(BLOCK, stop - first)
        for i in range(lanes):
            write_command(work, i, _read_action(action, first + i))
        advance_block(work, lanes, values, clock, table, period, substeps, first, results)
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
    """Do what `advance` does for a single lane, with half the overhead; `FuzzyArmEnv.step` calls this.

    The same code is compiled for one lane, so that the compiler removes the loops over lanes, and the results come as
    separate values that Python need not unpack.

    Args:
        values: as in `advance`, and so are the next four.
        clock: with one lane.
        table: the schedules.
        period: control period [s].
        substeps: in it.
        torque1: of the first motor [N m].
        torque2: of the second.
        observation: (10,), written.
        vectors: (9, 2), written; the rows of `Vectors`.

    Returns:
        The `Scalars`, the flags as such. If a torque is not finite nothing happens, and the last of them is -1.
    """
    work, out = np.empty(_WORK_SIZE), np.empty(WIDTH)
    results = parts(out)
    out[-1] = _NOT_FINITE
    if np.isfinite(torque1) and np.isfinite(torque2):
        write_command(work, 0, PerJoint(torque1, torque2))
        advance_block(work, 1, values, clock, table, period, substeps, 0, results)
        for k in range(SIZE):
            observation[k] = results.observation[k]
        for k in range(len(VECTORS)):
            for axis in range(PLANAR):
                vectors[k, axis] = results.vectors[PLANAR * k + axis]
    found = _read_scalars(results.scalars, 0)
    return (
        found.time,
        found.tip_error,
        found.circularity_error,
        found.circularity_error_motor,
        found.reward_tracking,
        found.reward_effort,
        found.reward,
        found.torque_clipped != 0.0,
        found.truncated != 0.0,
        int(found.reason),
    )


@kernel
def observe_again(values: np.ndarray, clock: np.ndarray, table: np.ndarray, out: np.ndarray) -> None:
    """Write what the last step, or the beginning of the episode, let be observed; nothing moves.

    Args:
        values: as in `advance`, and so are the next two; not changed.
        clock: where each lane is; not changed.
        table: the schedules.
        out: (WIDTH lanes,), written; of the results of all lanes only the observations [rad, rad/s, rad/s²].
    """
    results = parts(out)
    for lane in range(values.shape[1]):
        observe(values, clock, table, lane, results, lane)


def prepare(lanes: int) -> None:
    """Compile the kernel that steps so many lanes, or load it from disk: the first step need not wait for it."""
    global advance_one
    if lanes > 1:
        advance.compile(_ADVANCE)
    elif hasattr(advance_one, "compile"):
        # From here on the name is that of the machine code itself. It is called without a look at the types of the
        # arguments, which would cost the single arm a twentieth of its step.
        advance_one = advance_one.compile(_ADVANCE_ONE)
