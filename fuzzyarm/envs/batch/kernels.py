"""The compiled control step: hold the torques in every lane, or in the single arm.

One arm and a quarter of a million run the same code, block by block: the actions are written into the block `work`
(`Layout.Work`), `hold.hold_block_of` reads its records (`State`, ...) and advances them by `Physics.step`, and what
`task.assess_of` finds goes from the block into the `layout.Results`, which the environments return.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import float64, int64, types

from fuzzyarm.envs.batch.beginning import begin_of
from fuzzyarm.envs.batch.block import advance_block_of, gather_of
from fuzzyarm.envs.batch.board import AT, array_at, finish, take, wait
from fuzzyarm.envs.batch.layout import VECTORS, Clock, Layout, Scalars, layout_of
from fuzzyarm.envs.batch.reporting import observe_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import BLOCK, in_block, in_list, over_joints, reader, size, writer

__all__ = ["Kernels", "kernels_of"]

_read_scalars = reader(Scalars, in_list)
_NOT_FINITE = -1

# Types of the arguments of `advance_one`, but for the last three, and of `advance`.
_ARRAYS = (float64[:, :, ::1], int64[:, ::1], float64[:, ::1], float64, int64)
_ADVANCE = (int64[::1], float64, int64, int64)


class Kernels:
    """The kernels for arms with the same equations.

    Attributes:
        layout: of the arrays that they work on.
        advance: see `advance_of`.
        advance_one: see `advance_one_of`.
        observe_again: see `observe_again_of`.
        begin: see `beginning.begin_of`.
    """

    def __init__(self, physics: Physics) -> None:
        """Make the kernels; each is compiled, or read from disk, when it is first called."""
        self.layout = layout_of(physics)
        self.advance = advance_of(self.layout)
        self.advance_one = advance_one_of(self.layout)
        self.observe_again = observe_again_of(self.layout)
        self.begin = begin_of(self.layout)

    def prepare(self, lanes: int) -> None:
        """Compile the kernel that steps so many lanes, or load it from disk: the first step need not wait for it."""
        if lanes > 1:
            self.advance.compile(_ADVANCE)
        elif hasattr(self.advance_one, "compile"):
            torque = types.UniTuple(float64, self.layout.physics.joints)
            # From here on the name is that of the machine code itself. It is called without a look at the types of
            # the arguments, which would cost the single arm a twentieth of its step.
            self.advance_one = self.advance_one.compile((*_ARRAYS, torque, float64[::1], float64[:, ::1]))

    def __reduce__(self) -> tuple[Any, tuple[Physics]]:
        """Leave the machine code behind."""
        return kernels_of, (self.layout.physics,)


@functools.cache
def kernels_of(physics: Physics) -> Kernels:
    """Return the kernels for arms with these equations, always the same ones."""
    return Kernels(physics)


def advance_of(layout: Layout) -> Any:
    """Return the kernel ``advance(board, period, substeps, looks)``.

    It takes pieces of the step on a board (`board.BOARD`,) and holds the torques in their lanes for one control step.
    It returns once the board had no piece in so many `looks`; after 0 looks, once all pieces are done.

    - period: control period [s].
    - substeps: sub-steps in it.

    Posted are these arrays:

    - values: (blocks, numbers of `Lane`, `BLOCK`), changed in place.
    - clock: (numbers of `Clock`, lanes), changed in place; every lane must be before its last row.
    - table: (rows, numbers of a row), the schedules of all episodes below each other.
    - action: (lanes, joints) motor torques [N m], all finite; clipped to the limits.
    - out: (`Layout.width` lanes,), the results of all lanes, see `Layout.split`; written.
    """
    advance_block, parts, work_size = advance_block_of(layout), layout.parts, size(layout.Work) * BLOCK
    joints, command = layout.physics.joints, layout.WORK.command.joint1
    numbers, clocks, width = size(layout.Lane), size(Clock), layout.width
    row = size(row_record(joints, layout.physics.axes))

    @kernel_for(layout.physics.digest)
    def advance(board: np.ndarray, period: float, substeps: int, looks: int) -> None:
        work = np.empty(work_size)
        piece = take(board, max(looks, 1))
        while piece >= 0:
            count = board[AT.lanes]
            values = array_at(board[AT.values], (-(-count // BLOCK), numbers, BLOCK), np.float64)
            clock = array_at(board[AT.clock], (clocks, count), np.int64)
            table = array_at(board[AT.table], (board[AT.rows], row), np.float64)
            action = array_at(board[AT.action], (count, joints), np.float64)
            results = parts(array_at(board[AT.out], width * count, np.float64))
            start = piece * board[AT.size]
            stop = min(start + board[AT.size], count)
            for first in range(start, stop, BLOCK):
                lanes = min(BLOCK, stop - first)
                for i in range(lanes):
                    for joint in range(joints):
                        work[(command + joint) * BLOCK + i] = action[first + i, joint]
                advance_block(work, lanes, values, clock, table, period, substeps, first, results)
            finish(board)
            piece = take(board, max(looks, 1))
        if looks == 0:
            wait(board)

    return advance


def advance_one_of(layout: Layout) -> Any:
    """Return ``advance_one(values, clock, table, period, substeps, torque, observation, vectors)``.

    It does what `advance_of` does for a single lane, with half the overhead; `FuzzyArmEnv.step` calls it. The same code
    is compiled for one lane, so that the compiler removes the loops over lanes, and the results come as separate
    values that Python need not unpack: the `Scalars`, the flags as such. If a torque is not finite nothing happens, and
    the last of them is -1.

    - values, clock, table, period, substeps: as in `advance_of`, with one lane.
    - torque: tuple of the motors' torques [N m].
    - observation: (`Layout.observed`,), written.
    - vectors: (9, `Layout.longest`), written; the rows of `Vectors`.
    """
    advance_block, parts, longest = advance_block_of(layout), layout.parts, layout.longest
    work_size, width, observed = size(layout.Work) * BLOCK, layout.width, layout.observed
    PerJoint = layout.physics.PerJoint
    write_command = writer(PerJoint, in_block, layout.WORK.command)
    all_finite = over_joints(np.isfinite, PerJoint, 1, "&")
    read_torque = reader(PerJoint, in_list)

    @kernel_for(layout.physics.digest)
    def advance_one(
        values: np.ndarray,
        clock: np.ndarray,
        table: np.ndarray,
        period: float,
        substeps: int,
        torque: tuple[float, ...],
        observation: np.ndarray,
        vectors: np.ndarray,
    ) -> tuple[float, float, float, float, float, float, float, bool, bool, int]:
        work, out = np.empty(work_size), np.empty(width)
        results, command = parts(out), read_torque(torque, 0)
        out[-1] = _NOT_FINITE
        if all_finite(command):
            write_command(work, 0, command)
            advance_block(work, 1, values, clock, table, period, substeps, 0, results)
            for k in range(observed):
                observation[k] = results.observation[k]
            for k in range(len(VECTORS)):
                for axis in range(longest):
                    vectors[k, axis] = results.vectors[longest * k + axis]
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

    return advance_one


def observe_again_of(layout: Layout) -> Any:
    """Return the kernel ``observe_again(values, clock, table, out)``.

    It writes what the last step, or the beginning of the episode, let be observed, of the results (`Layout.width`
    lanes,) of all lanes only the observations [rad, rad/s, rad/s²]; nothing moves. Arguments as in `advance_of`.
    """
    observe, parts, work_size = observe_of(layout), layout.parts, size(layout.Work) * BLOCK
    gather, _ = gather_of(layout)

    @kernel_for(layout.physics.digest)
    def observe_again(values: np.ndarray, clock: np.ndarray, table: np.ndarray, out: np.ndarray) -> None:
        results = parts(out)
        work, lanes = np.empty(work_size), clock.shape[1]
        for first in range(0, lanes, BLOCK):
            count = min(BLOCK, lanes - first)
            gather(work, count, values[first // BLOCK])
            observe(work, count, clock, table, first, results, first)

    return observe_again
