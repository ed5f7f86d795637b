"""The kernels of the environments: a control step of every lane, the beginning of episodes, and observations.

One arm and a quarter of a million run the same functions, `control_step.control_step`, `control_step.begun` and
`control_step.reading_of`, recorded once and run as machine code on the arrays that `layout` describes.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.layout import Clock, Flags, Results, Start, StepScalars, StepVectors, Totals, layout_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.control_step import Given, Moved, assessed, begun, control_step, reading_of
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.records import Physics, filled, places, size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.numbers.functions import (
    bits,
    each,
    flat,
    like,
    maximum,
    minimum,
    number,
    only,
    row,
    select,
    when,
    whole,
    word,
    zeros,
)
from fuzzyarm.numbers.machine import Kernel, Layout
from fuzzyarm.numbers.program import Program
from fuzzyarm.numbers.symbols import Array

__all__ = ["Kernels", "kernels_of"]


class Kernels:
    """Kernels for arms with the same equations, each recorded when it is first used, on arrays with a `layout`."""

    def __init__(self, physics: Physics) -> None:
        self.layout = layout_of(physics)
        self._row = row_record(physics.joints, physics.axes)
        self._nothing = physics.PerJoint(*[0.0] * physics.joints)
        self._lane, self._seen = places(self.layout.Lane), Observation(*[self._nothing] * len(Observation._fields))
        self._results = zeros((0.0,) * self.layout.reported)
        self._ranges = ((0.0, 0.0),) * size(draw_record(physics.joints))
        self._tables = [(0, size(kind)) for kind in (physics.Plant, Start, self._row)]

    @functools.cached_property
    def step(self) -> Kernel:
        """Hold torques in every lane for one control step.

        On values, clock, commands (lanes, joints) [N m], observations and `Results` (numbers, lanes), with the control
        period [s], the sub-step [s] and the number of sub-steps; the table is the schedule.
        """

        def step(lane: Any, clock: Clock, command: Any, _: Any, __: Any, given: Any, schedule: Any) -> tuple[Any, ...]:
            lane, clock, seen, results = self._stepped(lane, clock, command, given, schedule)
            return lane, clock, command, seen, results

        ports = self._lane, _CLOCK, self._nothing, self._seen, self._results
        return _kernel(step, ports, _PERIODS, self._tables[2:], "BCRRC")

    def _stepped(self, lane: Any, clock: Clock, command: Any, periods: Any, schedule: Any) -> tuple[Any, ...]:
        """Return lane, clock, observation and `Results` after a control step; constants and table as for `step`."""
        physics, Row = self.layout.physics, self._row
        period, h, substeps = periods
        at, first, last = (number(word(one)) for one in (clock.row, clock.first, clock.last))
        reached = minimum(at + 1.0, last)  # two threads may step an episode that is over: it stays at its end
        now, after = (filled(Row, row(schedule, place)) for place in (at, reached))
        moved = control_step(
            physics, lane.state, command, now, after.target, lane.arm, lane.limits, lane.force_factor, h, substeps
        )
        clock = clock._replace(row=bits(whole(reached)))
        results = _results(physics, moved, after.target, (reached - first) * period, reached == last)
        lane = lane._replace(state=moved.state)
        return lane, clock, self._observed(lane, clock, reached - first, after), results

    @functools.cached_property
    def begin(self) -> Kernel:
        """Begin an episode in every lane.

        On values, clock, what is drawn (numbers, lanes), `Given` and the initial states (lanes, numbers), observations
        and `Results` (numbers, lanes), with the ranges of what is drawn; the tables are plants, starts and schedule.
        """
        physics, nothing = self.layout.physics, self._nothing
        Draw, no_force = draw_record(physics.joints), [0.0] * physics.axes

        def begin(*arguments: Any) -> tuple[Any, ...]:
            _, clock, _, given, initial, _, _, ranges, *tables = arguments
            lane, clock, drawn, now = begun(self.layout, clock, given, initial, ranges, *tables)
            still, target = (lane.state, lane.state, nothing, nothing, nothing, no_force), now.target
            moved = assessed(physics, *still, target, lane.arm, lane.limits)
            over = number(word(clock.row)) == number(word(clock.last))
            results = _results(physics, moved, now.target, 0.0, over)
            return lane, clock, drawn, given, initial, self._observed(lane, clock, 0.0, now), results

        state = zeros(places(physics.State))
        ports = self._lane, _CLOCK, places(Draw), _GIVEN, state, self._seen, self._results
        return _kernel(begin, ports, self._ranges, self._tables, "BCCRRRC")

    @functools.cached_property
    def advance(self) -> Kernel:
        """Hold torques in every lane for one control step; where an episode ends, begin the lane's next one within it.

        On values, clock, commands (lanes, joints) [N m], `Given` (lanes, 3), observations at the end of the step, and
        those of the next episode where there is one, `Results` and `Flags` (numbers, lanes). Constants are those of
        `step` and the ranges of `begin`; tables those of `begin`. A lane whose command is not finite is terminated.
        """

        def advance(*arguments: Any) -> tuple[Any, ...]:
            lane, clock, command, given, _, _, _, _, *rest = arguments
            lane, clock, final, seen, results = self._advanced(lane, clock, command, given, *rest)
            scalars = results.scalars
            ended = scalars.reason > 0.0, scalars.truncated, scalars.torque_clipped, scalars.reason
            flags = Flags(*(bits(whole(1.0 * one)) for one in ended))
            return lane, clock, command, given, final, seen, results, flags

        ports = self._lane, _CLOCK, self._nothing, _GIVEN, self._seen, self._seen, self._results, zeros(places(Flags))
        return _kernel(advance, ports, (_PERIODS, self._ranges), self._tables, "BCRRRRCC")

    def run(self, command: Any, memory: Any, constants: Any, tables: Sequence[tuple[int, ...]]) -> Kernel:
        """Take many steps of `advance` under a law ``command(memory, seen, constants, *tables)``.

        On values, clock, the law's memory (numbers, lanes), `Given` (lanes, 3), the observation (lanes, 5 joints) that
        the law sees next, and `Totals` (numbers, lanes), zero at first. Constants and tables are those of `advance`,
        then the law's, whose shapes `memory`, `constants` and `tables` give. Memory is zero when an episode begins.
        """

        def run(*arguments: Any) -> tuple[Any, ...]:
            lane, clock, remembered, given, seen, totals, (*shared, of_law), plants, starts, schedule, *own = arguments
            # What the law saw last is the caller's, who may have changed it.
            seen = when(totals.steps == 0.0, lambda: self._seen_at(lane, clock, schedule), seen)
            remembered, torque = command(remembered, seen, of_law, *own)
            lane, clock, _, seen, results = self._advanced(lane, clock, torque, given, shared, plants, starts, schedule)
            scalars = results.scalars
            terminated, error = scalars.reason > 0.0, scalars.tip_error
            totals = Totals(
                totals.steps + 1.0,
                totals.reward + scalars.reward,
                maximum(totals.tip_error, error),
                totals.tip_error_squares + error * error,
                totals.terminated + 1.0 * terminated,
                totals.truncated + scalars.truncated,
            )
            return lane, clock, _cleared(remembered, _over(scalars)), given, seen, totals

        ports = self._lane, _CLOCK, memory, _GIVEN, self._seen, zeros(places(Totals))
        shared = _PERIODS, self._ranges, constants
        return _kernel(run, ports, shared, [*self._tables, *tables], "BCCRRC", repeated=True)

    def _advanced(
        self, lane: Any, clock: Clock, command: Any, given: Given, shared: Any, plants: Any, starts: Any, schedule: Any
    ) -> tuple[Any, ...]:
        """Return lane, clock, last and next observation and `Results` of a step of `advance`."""
        physics, (periods, ranges) = self.layout.physics, shared
        total = sum(command[1:], command[0])
        sound = total - total == 0.0
        asked = physics.PerJoint(*(select(sound, u, 0.0) for u in command))
        # After a command that is not finite the arm is where it would be after a step under no finite force.
        force_factor = select(sound, lane.force_factor, float("nan"))
        lane = lane._replace(force_factor=force_factor)
        lane, clock, final, results = self._stepped(lane, clock, asked, periods, schedule)
        at_rest = filled(physics.State, [float("nan")] * size(physics.State))

        def following() -> tuple[Any, ...]:
            new, new_clock, _, now = begun(self.layout, clock, given, at_rest, ranges, plants, starts, schedule)
            return new, new_clock, self._observed(new, new_clock, 0.0, now)

        lane, clock, seen = when(_over(results.scalars), following, (lane, clock, final))
        return lane, clock, final, seen, results

    @functools.cached_property
    def observe(self) -> Kernel:
        """Write what can be observed now; nothing moves. On values, clock, observations and, as table, the schedule."""

        def observe(lane: Any, clock: Clock, _: Any, __: Any, schedule: Any) -> tuple[Any, ...]:
            return lane, clock, self._seen_at(lane, clock, schedule)

        return _kernel(observe, (self._lane, _CLOCK, self._seen), (), self._tables[2:], "BCR")

    def _seen_at(self, lane: Any, clock: Clock, schedule: Any) -> Observation:
        at, first = number(word(clock.row)), number(word(clock.first))
        return self._observed(lane, clock, at - first, filled(self._row, row(schedule, at)))

    def _observed(self, lane: Any, clock: Clock, steps: Any, now: Any) -> Observation:
        """Return what is observed so many steps after the beginning, at a row of the schedule."""
        reading = reading_of(self.layout.physics)
        return Observation(*reading(lane.state, lane.limits, lane.noise, word(clock.key), steps), *now.reference)

    def prepare(self, lanes: int) -> None:
        """Make the machine code that steps so many lanes."""
        self.step.code(lanes)

    def __reduce__(self) -> tuple[Any, tuple[Physics]]:
        """Pickle the equations alone: the machine code is made again."""
        return kernels_of, (self.layout.physics,)


_CLOCK, _GIVEN, _PERIODS = Clock(0.0, 0.0, 0.0, 0.0), Given(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


_LAYOUTS = {"R": Layout.ROWS, "C": Layout.COLUMNS, "B": Layout.BLOCKS}


def _kernel(
    function: Any,
    ports: Any,
    constants: Any,
    tables: Sequence[tuple[int, ...]],
    layouts: str,
    *,
    repeated: bool = False,
) -> Kernel:
    """Return the kernel of a function whose ports lie in rows (R), columns (C) or blocks (B)."""
    with np.errstate(over="ignore"):  # of words
        program = Program(function, ports, constants, tables)
    return Kernel(program, [_LAYOUTS[one] for one in layouts], repeated=repeated)


def _over(scalars: Any) -> Any:
    return (scalars.reason > 0.0) | (scalars.truncated > 0.0)


def _cleared(memory: Any, where: Any) -> Any:
    """Return the memory of a law, with zeros where a condition holds."""
    if isinstance(memory, tuple):
        return like(memory, iter([_cleared(part, where) for part in flat(memory)]))
    if not isinstance(memory, Array):
        return select(where, 0.0, memory)
    for _ in only(where):
        _fill(memory)
    return memory


def _fill(array: Array) -> None:
    for k in each(len(array)):
        if len(array.shape) > 1:
            _fill(array[k])
        else:
            array[k] = 0.0


def _results(physics: Physics, moved: Moved, target: Any, time: Any, over: Any) -> Results:
    """Return the `Results`; `over` says whether the schedule is at its end."""
    found, state = moved.found, moved.state
    vectors = StepVectors(
        tip=found.tip,
        tip_reference=target.position,
        q_motor=state.motor,
        dq_motor=state.motor_velocity,
        q_link=state.link,
        dq_link=state.link_velocity,
        torque=moved.torque,
        friction_torque=found.friction_torque,
        external_force=tuple(moved.force),
    )
    scalars = StepScalars(
        time=time,
        **{name: value for name, value in found._asdict().items() if name in StepScalars._fields},
        torque_clipped=moved.clipped,
        truncated=1.0 * ((moved.reason == 0.0) & over),
        reason=moved.reason,
    )
    return Results(vectors, scalars)


@functools.cache
def kernels_of(physics: Physics) -> Kernels:
    """Return the kernels for arms with these equations; the same object at every call."""
    return Kernels(physics)
