"""Tip errors of many episodes in one kernel: law, limits, delay and plant of some lanes, from their start to their end.

The steps are those of `loop.episodes` with `FuzzyArmVectorEnv`, in the same order and with the same bits. A group of
lanes does all its steps before the next group begins, so that what a step touches stays in the cache. It serves
policies with a law for compiled loops, see `fuzzy_policy.compiled_law`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.block import gather_of, move_block_of
from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import CLOCK, Layout, Results
from fuzzyarm.envs.batch.reporting import observe_of
from fuzzyarm.envs.physics.compiled import announced_compilation, kernel_for
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import BLOCK, size
from fuzzyarm.envs.termination import reason_of
from fuzzyarm.eval.episodes.loop import TipErrors
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw
from fuzzyarm.fuzzy_policy.policy import Policy, limit

__all__ = ["Channel", "closed_loops"]

GROUP = 4 * BLOCK  # lanes


class Channel(NamedTuple):
    """What is between plant and policy in each lane.

    Attributes:
        noise: f (lanes,): the policy reads q + f (y - q), y the reading of the environment and q the truth; None: y.
        delay: by how many control periods (lanes,) the torques are late, whole numbers.
    """

    noise: np.ndarray | None
    delay: np.ndarray


def closed_loops(
    lanes: Lanes, observation: np.ndarray, policy: Policy, law: CompiledLaw, channel: Channel
) -> TipErrors | None:
    """Run the episodes that have begun in all lanes to their ends, and return their tip errors; the lanes stay there.

    Args:
        lanes: whose episodes have just begun.
        observation: what the policy sees of their beginning, (lanes, 5 n).
        policy: what acts.
        law: its `compiled_law`.
        channel: between both.

    Returns:
        The errors; None where a torque was no finite number, which the ordinary loop refuses with a message.
    """
    errors, at, noise = TipErrors(lanes.count), policy.integral_at, channel.noise
    with announced_compilation():
        failed = _run_of(lanes.layout, policy, law)(
            lanes.arrays,
            np.array(observation, order="C"),
            (noise is not None, np.zeros(lanes.count) if noise is None else noise, channel.delay.astype(np.int64)),
            np.zeros((lanes.count, policy.memory_size)),
            np.asarray(policy.torque_limit, dtype=np.float64),
            -1 if at is None else at,
            law.arguments,
            (errors.largest, errors.squares, errors.steps, errors.completed),
        )
    return None if failed else errors


_kernels: dict[str, Callable[..., bool]] = {}


def _run_of(layout: Layout, policy: Policy, law: CompiledLaw) -> Callable[..., bool]:
    """Return the kernel for a law and arms with these equations; the first one made for them serves all."""
    made_for = f"{layout.physics.digest}_{equations_of(policy.parameters).digest}_{law.name}"
    if made_for not in _kernels:
        _kernels[made_for] = _made_for(made_for, layout, law.act)
    return _kernels[made_for]


@register_jitable
def _delayed(torque: np.ndarray, sent: np.ndarray, k: int, delay: int) -> None:
    """Replace the torques (n,) of step k by those that were sent `delay` steps before, the first ones before that."""
    depth = len(sent)
    for joint in range(len(torque)):
        for late in range(depth if k == 0 else 1):
            sent[(k + late) % depth, joint] = torque[joint]
        torque[joint] = sent[(k - delay) % depth, joint]


@register_jitable
def _scaled(reading: np.ndarray, truth: np.ndarray, factor: float) -> None:
    """Scale the noise of readings (n,), which is what they are off the truth, the first entries of `truth`."""
    for joint in range(len(reading)):
        reading[joint] = truth[joint] + factor * (reading[joint] - truth[joint])


@register_jitable
def _ended(lane: int, error: float, reason: float, last: bool, errors: tuple) -> bool:
    """Add the tip error [m] of a step to those of the lane, and return whether its episode has ended."""
    largest, squares, steps, completed = errors
    largest[lane] = max(largest[lane], error)
    squares[lane] += error * error
    steps[lane] += 1.0
    completed[lane] = last and reason == 0.0
    return last or reason != 0.0


@functools.cache
def _plant_of(layout: Layout) -> tuple[Any, Any]:
    """Return the kernels ``take(work, numbers, lanes)`` and ``move(work, numbers, clock, ..., torque, seen)``.

    The one takes the lanes of a group from their blocks `numbers` into `work` (blocks, size), where they stay; the
    other holds torques (lanes, n) [N m] for a control step, and fills what is observed then, (lanes, 5 n).
    """
    (gather, _), move_block, observe = gather_of(layout), move_block_of(layout), observe_of(layout)
    command, joints = layout.WORK.command.joint1 * BLOCK, layout.physics.joints

    @kernel_for(layout.physics.digest)
    def take(work: np.ndarray, numbers: np.ndarray, lanes: int) -> None:
        for block in range(len(numbers)):
            gather(work[block], min(BLOCK, lanes - block * BLOCK), numbers[block])

    @kernel_for(layout.physics.digest)
    def move(
        work: np.ndarray,
        numbers: np.ndarray,
        clock: np.ndarray,
        table: np.ndarray,
        period: float,
        substeps: int,
        torque: np.ndarray,
        seen: np.ndarray,
    ) -> None:
        results = Results(seen.reshape(seen.size), seen[0], seen[0])
        for block in range(len(numbers)):
            first, own = block * BLOCK, work[block]
            lanes = min(BLOCK, len(torque) - first)
            for joint in range(joints):
                for i in range(lanes):
                    own[command + joint * BLOCK + i] = torque[first + i, joint]
            move_block(own, lanes, numbers[block], clock, table, period, substeps, first)
            observe(own, lanes, clock, table, first, results, first)

    return take, move


def _made_for(made_for: str, layout: Layout, act: Any) -> Callable[..., bool]:
    """Return the kernel; it returns whether a torque was no finite number."""
    joints, work_size, at = layout.physics.joints, size(layout.Work) * BLOCK, layout.WORK
    state, found = at.hold.state, at.assessment
    error_at, finite, angles, speeds = (
        BLOCK * row for row in (found.tip_error, at.finite, found.angles_inside, found.velocities_inside)
    )
    q_at, dq_at = BLOCK * state.motor.joint1, BLOCK * state.motor_velocity.joint1
    take, move = _plant_of(layout)

    @kernel_for(made_for)
    def run(
        plant: Any,
        observation: np.ndarray,
        channel: tuple,
        memory: np.ndarray,
        torque_limit: np.ndarray,
        integral_at: int,
        arguments: Any,
        errors: tuple,
    ) -> bool:
        (values, clock, table, period, substeps), (noisy, noise, delay) = plant, channel
        depth = int(delay.max()) + 1
        for start in range(0, len(observation), GROUP):
            stop = min(start + GROUP, len(observation))
            n, numbers, clocks = stop - start, values[start // BLOCK : -(-stop // BLOCK)], clock[:, start:stop].copy()
            remembered, seen = memory[start:stop].copy(), observation[start:stop].copy()
            work = np.empty((len(numbers), work_size))
            take(work, numbers, n)
            torque, sent, before = np.empty((n, joints)), np.empty((depth, n, joints)), np.empty((n, joints))
            running, k = np.ones(n, dtype=np.bool_), 0
            while running.any():
                if integral_at >= 0:
                    before[:] = remembered[:, integral_at : integral_at + joints]
                act(seen, remembered, torque, arguments)
                limit(torque, torque_limit, remembered, before, integral_at)
                for i in range(n):
                    if not running[i]:
                        # It moves in vain, from where it began, until the last lane of the group has ended.
                        torque[i] = 0.0
                        clocks[CLOCK.row, i] = clocks[CLOCK.first, i]
                    if not np.isfinite(np.sum(torque[i])):
                        return True
                    if depth > 1:
                        _delayed(torque[i], sent[:, i], k, delay[start + i])
                move(work, numbers, clocks, table, period, substeps, torque, seen)
                k += 1
                for i in range(n):
                    block, place = i // BLOCK, i % BLOCK
                    if noisy:
                        _scaled(seen[i, :joints], work[block, q_at + place :: BLOCK], noise[start + i])
                        _scaled(seen[i, joints : 2 * joints], work[block, dq_at + place :: BLOCK], noise[start + i])
                    if running[i]:
                        found = work[block, finite + place], work[block, angles + place], work[block, speeds + place]
                        last, error = clocks[CLOCK.row, i] == clocks[CLOCK.last, i], work[block, error_at + place]
                        running[i] = not _ended(start + i, error, reason_of(*found), last, errors)
        return False

    kernel: Callable[..., bool] = run
    return kernel
