"""Tip errors of many episodes in one kernel, which computes the law, the torque limits, the delay and the plant.

The steps are those of `loop.episodes` with `FuzzyArmVectorEnv`, bit for bit. The policy must have a `fuzzy_policy.law`.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import Clock, Layout
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.control_step import control_step, reading_of
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.records import places, size
from fuzzyarm.eval.episodes.loop import TipErrors
from fuzzyarm.fuzzy_policy.law import Law, constants_array, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers import machine
from fuzzyarm.numbers.functions import bits, like, maximum, number, row, select, whole, word, zeros
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["Channel", "closed_loops"]

_ROWS, _COLUMNS, _BLOCKS = machine.PortLayout


class Channel(NamedTuple):
    """Encoder noise and control delay between plant and policy in each lane.

    The policy reads q + f (y - q), with the environment's reading y of the true q and the factor f = `noise`.
    """

    noise: np.ndarray | None  # (lanes,); None: the policy reads y
    delay: np.ndarray  # (lanes,), delay of the torques in whole control periods


class _Scalars(NamedTuple):
    """The noise and delay of a lane's `Channel` and the results of its episode, as scalars in the kernel."""

    running: Any  # 1 until the episode ends
    noise: Any  # factor
    delay: Any  # steps
    largest: Any  # tip error [m]
    squares: Any  # sum of squared tip errors [m²]
    steps: Any
    completed: Any  # 1 if the reference was followed to its end
    failed: Any  # 1 if a torque was not finite


def closed_loops(lanes: Lanes, observation: np.ndarray, policy: Policy, law: Law, channel: Channel) -> TipErrors | None:
    """Run the episodes that have just begun in all lanes to their ends and return their tip errors.

    `lanes` is not changed. `policy` acts by `law`, through `channel`, and first observes `observation` (lanes, 5 n)
    of n joints. The result is None if a torque is not finite.
    """
    layout, count, joints = lanes.layout, lanes.count, lanes.physics.joints
    depth, scaled = int(channel.delay.max()) + 1, channel.noise is not None
    shapes = zeros(law.memory), zeros(law.constants), tuple(table.shape for table in law.tables)  # hashable
    kernel = _kernel_of(layout, law.act, *shapes, policy.integral_at, depth, scaled)
    episode = np.zeros((count, len(_Scalars._fields)))
    episode[:, 0], episode[:, 2] = 1.0, channel.delay
    if channel.noise is not None:
        episode[:, 1] = channel.noise
    memory, reading = np.zeros((count, policy.memory_size)), observation[:, : 2 * joints].copy()
    values, clock, sent = lanes.values.copy(), lanes.clock.copy().view(np.float64), np.zeros((count, depth * joints))
    limit = tuple(np.asarray(policy.torque_limit, dtype=np.float64).tolist())
    constants = constants_array(law, limit, lanes.period / lanes.substeps, float(lanes.substeps))
    arrays, tables = (memory, values, clock, reading, sent, episode), (*law.tables, lanes.table)
    kernel(arrays, constants, tables, lanes.longest_episode)
    found = _Scalars(*episode.T)
    if found.failed.any():
        return None
    errors = TipErrors(count)
    errors.largest, errors.squares, errors.steps = found.largest, found.squares, found.steps
    errors.completed = found.completed > 0.0
    return errors


@functools.lru_cache(maxsize=64)
def _kernel_of(
    layout: Layout,
    act: Any,
    memory: Any,
    constants: Any,
    tables: Any,
    integral_at: int | None,
    depth: int,
    scaled: bool,
) -> Kernel:
    """Return the kernel of arms of `layout` under a law; delays are less than `depth` steps.

    `act`, `memory` and `constants` are as in `Law`, `tables` the shapes of its tables; `integral_at`: where integrals
    begin in the memory, or None; `scaled`: whether encoder noise has a factor, see `Channel`.
    """
    physics = layout.physics
    PerJoint, joints = physics.PerJoint, physics.joints
    Row, command = row_record(joints, physics.axes), within_limits(Law(act, memory, constants), joints, integral_at)
    reading_at = reading_of(physics)

    def step(
        remembered: Any, lane: Any, clock: Clock, reading: Any, sent: Any, episode: _Scalars, given: Any, *others: Any
    ) -> tuple[Any, ...]:
        of_law, limit, h, substeps = given
        *own, schedule = others
        at, first, last = (number(word(one)) for one in (clock.row, clock.first, clock.last))
        now, after = (like(places(Row), iter(row(schedule, place))) for place in (at, at + 1.0))
        remembered, torque = command(remembered, Observation(*reading, *now.reference), (of_law, limit), *own)
        on = episode.running > 0.0
        total = sum(torque[1:], torque[0])
        failed = on & (total - total != 0.0)
        # The torques of the last steps; the torque of the first step counts as sent in all steps before it.
        begins = episode.steps == 0.0
        before = [PerJoint(*(select(begins, u, old) for u, old in zip(torque, past, strict=True))) for past in sent]
        sent = (torque, *before[:-1])
        for steps, past in enumerate(sent):
            torque = PerJoint(*(select(episode.delay == steps, p, u) for p, u in zip(past, torque, strict=True)))
        moved = control_step(
            physics, lane.state, torque, now, after.target, lane.arm, lane.limits, lane.force_factor, h, substeps
        )
        state, at = moved.state, at + 1.0
        q, dq = reading_at(state, lane.limits, lane.noise, word(clock.key), at - first)
        if scaled:
            q, dq = _scaled(q, state.motor, episode.noise), _scaled(dq, state.motor_velocity, episode.noise)
        ends, goes_on, error = at == last, moved.reason == 0.0, moved.found.tip_error
        episode = episode._replace(
            running=1.0 * (on & goes_on & ~ends),
            largest=select(on, maximum(episode.largest, error), episode.largest),
            squares=select(on, episode.squares + error * error, episode.squares),
            steps=select(on, episode.steps + 1.0, episode.steps),
            completed=select(on, 1.0 * (ends & goes_on), episode.completed),
            failed=select(failed, 1.0, episode.failed),
        )
        clock = clock._replace(row=select(on, bits(whole(at)), clock.row))
        return remembered, lane._replace(state=state), clock, (q, dq), sent, episode

    nothing = PerJoint(*[0.0] * joints)
    clock, episode = Clock(0.0, 0.0, 0.0, 0.0), _Scalars(*[0.0] * len(_Scalars._fields))
    ports = (memory, places(layout.Lane), clock, (nothing, nothing), (nothing,) * depth, episode)
    program = Program(step, ports, (constants, tuple(nothing), 0.0, 0.0), (*tables, (0, size(Row))))
    return Kernel(program, (_ROWS, _BLOCKS, _COLUMNS, _ROWS, _ROWS, _ROWS), repeated=True)


def _scaled(reading: Any, truth: Any, factor: Any) -> Any:
    return type(truth)(*(true + factor * (read - true) for read, true in zip(reading, truth, strict=True)))
