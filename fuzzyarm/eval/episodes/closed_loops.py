"""Tip errors of many episodes in one kernel: law, limits, delay and plant of some lanes, from their start to their end.

The steps are those of `loop.episodes` with `FuzzyArmVectorEnv`, in the same order and with the same bits. A group of
lanes does all its steps before the next group begins, so that what a step touches stays in the cache. It serves
policies with a law for compiled loops, see `fuzzy_policy.compiled_law`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import CLOCK, SCALARS, Layout
from fuzzyarm.envs.physics.compiled import announced_compilation, kernel_for
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import BLOCK
from fuzzyarm.eval.episodes.loop import TipErrors
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw
from fuzzyarm.fuzzy_policy.policy import Policy, limit

__all__ = ["Channel", "closed_loops"]

GROUP = 4 * BLOCK  # lanes
_ERROR, _OVER, _REASON = map(SCALARS.index, ("tip_error", "truncated", "reason"))


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
        failed = _run_of(lanes.layout, lanes.kernels.advance, policy, law)(
            *lanes.arrays,
            np.array(observation, order="C"),
            *(noise is not None, np.zeros(lanes.count) if noise is None else noise),
            *(channel.delay.astype(np.int64), int(channel.delay.max())),
            np.zeros((lanes.count, policy.memory_size)),
            np.asarray(policy.torque_limit, dtype=np.float64),
            -1 if at is None else at,
            law.arguments,
            *(errors.largest, errors.squares, errors.steps, errors.completed),
        )
    return None if failed else errors


_kernels: dict[str, Callable[..., bool]] = {}


def _run_of(layout: Layout, advance: Any, policy: Policy, law: CompiledLaw) -> Callable[..., bool]:
    """Return the kernel for a law and arms with these equations; the first one made for them serves all."""
    made_for = f"{layout.physics.digest}_{equations_of(policy.parameters).digest}_{law.name}"
    if made_for not in _kernels:
        _kernels[made_for] = _made_for(made_for, layout, advance, law.act)
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
    """Scale the noise of readings (n,), which is what they are off the truth."""
    for joint in range(len(truth)):
        reading[joint] = truth[joint] + factor * (reading[joint] - truth[joint])


def _made_for(made_for: str, layout: Layout, advance: Any, act: Any) -> Callable[..., bool]:
    """Return the kernel; it returns whether a torque was no finite number."""
    width, observed, joints = layout.width, layout.observed, layout.physics.joints
    motors, velocities = layout.LANE.state.motor.joint1, layout.LANE.state.motor_velocity.joint1
    first_scalar = width - len(SCALARS)

    @kernel_for(made_for)
    def run(
        values: np.ndarray,
        clock: np.ndarray,
        table: np.ndarray,
        period: float,
        substeps: int,
        observation: np.ndarray,
        noisy: bool,
        noise: np.ndarray,
        delay: np.ndarray,
        latest: int,
        memory: np.ndarray,
        torque_limit: np.ndarray,
        integral_at: int,
        arguments: Any,
        largest: np.ndarray,
        squares: np.ndarray,
        steps: np.ndarray,
        completed: np.ndarray,
    ) -> bool:
        for start in range(0, len(observation), GROUP):
            stop = min(start + GROUP, len(observation))
            n, depth = stop - start, latest + 1
            numbers, clocks = values[start // BLOCK : -(-stop // BLOCK)].copy(), clock[:, start:stop].copy()
            remembered, out = memory[start:stop].copy(), np.empty(width * n)
            seen = out[: observed * n].reshape((n, observed))  # where a step leaves the observations
            seen[:] = observation[start:stop]
            torque, sent, before = np.empty((n, joints)), np.empty((depth, n, joints)), np.empty((n, joints))
            running, left, k = np.ones(n, dtype=np.bool_), n, 0
            while left > 0:
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
                advance(numbers, clocks, table, period, substeps, torque, 0, n, out)
                k += 1
                for i in range(n):
                    if noisy:
                        block, place, factor = i // BLOCK, i % BLOCK, noise[start + i]
                        _scaled(seen[i, :joints], numbers[block, motors : motors + joints, place], factor)
                        velocity = numbers[block, velocities : velocities + joints, place]
                        _scaled(seen[i, joints : 2 * joints], velocity, factor)
                    if running[i]:
                        error = out[(first_scalar + _ERROR) * n + i]
                        largest[start + i] = max(largest[start + i], error)
                        squares[start + i] += error * error
                        steps[start + i] += 1.0
                        over = out[(first_scalar + _OVER) * n + i] != 0.0
                        if over or out[(first_scalar + _REASON) * n + i] != 0.0:
                            running[i], completed[start + i] = False, over
                            left -= 1
        return False

    kernel: Callable[..., bool] = run
    return kernel
