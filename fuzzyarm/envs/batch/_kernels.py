"""The kernels of the environments: a control step of every lane, the beginning of episodes, and observations.

One arm and a batch of a quarter of a million run the same functions, `control_step.control_step`, `control_step.begun`
and `control_step.reading_of`, recorded once and run as machine code on the arrays that `layout` describes.
"""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.layout import Clock, Start, StepResults, StepScalars, StepVectors, layout_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.control_step import Given, Moved, assessed, begun, control_step, reading_of
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.records import Physics, filled, places, size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.numbers.functions import bits, minimum, number, row, whole, word, zeros
from fuzzyarm.numbers.machine import Kernel, PortLayout
from fuzzyarm.numbers.program import Program

__all__ = ["Kernels", "kernels_of"]


class Kernels:
    """Kernels for arms with the same equations; each is recorded at its first use. `layout` describes the arrays."""

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
        """The kernel that holds torques in every lane for one control step.

        The kernel's arrays are values, clock, commands (lanes, joints) [N m], observations and `StepResults` (entries,
        lanes). Its constants are control period [s], sub-step [s] and number of sub-steps; its table is the schedule.
        """
        physics, Row = self.layout.physics, self._row

        def step(
            lane: Any, clock: Clock, command: Any, _: Any, __: Any, periods: Any, schedule: Any
        ) -> tuple[Any, ...]:
            period, h, substeps = periods
            at, first, last = (number(word(one)) for one in (clock.row, clock.first, clock.last))
            reached = minimum(at + 1.0, last)  # if two threads step at once, an ended episode stays at its end
            now, after = (filled(Row, row(schedule, place)) for place in (at, reached))
            moved = control_step(
                physics, lane.state, command, now, after.target, lane.arm, lane.limits, lane.force_factor, h, substeps
            )
            clock = clock._replace(row=bits(whole(reached)))
            results = _results(physics, moved, after.target, (reached - first) * period, reached == last)
            lane = lane._replace(state=moved.state)
            return lane, clock, command, self._observed(lane, clock, reached - first, after), results

        ports = self._lane, _CLOCK, self._nothing, self._seen, self._results
        return _kernel(step, ports, (0.0, 0.0, 0.0), self._tables[2:], "BCRRC")

    @functools.cached_property
    def begin(self) -> Kernel:
        """The kernel that begins an episode in every lane.

        The kernel's arrays are values and clock, as in `layout`; draws (entries, lanes); `Given`, initial states and
        observations, each (lanes, entries); `StepResults` (entries, lanes). Its constants are the ranges of the draws;
        its tables are plants, starts and schedule.
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
        ports = self._lane, _CLOCK, places(Draw), Given(0.0, 0.0, 0.0), state, self._seen, self._results
        return _kernel(begin, ports, self._ranges, self._tables, "BCCRRRC")

    @functools.cached_property
    def observe(self) -> Kernel:
        """The kernel that writes current observations; its arrays are values, clock, observations and schedule."""

        def observe(lane: Any, clock: Clock, _: Any, __: Any, schedule: Any) -> tuple[Any, ...]:
            at, first = number(word(clock.row)), number(word(clock.first))
            return lane, clock, self._observed(lane, clock, at - first, filled(self._row, row(schedule, at)))

        return _kernel(observe, (self._lane, _CLOCK, self._seen), (), self._tables[2:], "BCR")

    def _observed(self, lane: Any, clock: Clock, steps: Any, now: Any) -> Observation:
        """Return a lane's observation after this number of steps; `now` is the row of the schedule at that instant."""
        reading = reading_of(self.layout.physics)
        return Observation(*reading(lane.state, lane.limits, lane.noise, word(clock.key), steps), *now.reference)

    def prepare(self, lanes: int) -> None:
        """Compile the machine code that steps this number of lanes."""
        self.step.code(lanes)

    def __reduce__(self) -> tuple[Any, tuple[Physics]]:
        """Pickle only the equations: the machine code is compiled again."""
        return kernels_of, (self.layout.physics,)


_CLOCK = Clock(0.0, 0.0, 0.0, 0.0)
_LAYOUTS = {"R": PortLayout.ROWS, "C": PortLayout.COLUMNS, "B": PortLayout.BLOCKS}


def _kernel(function: Any, ports: Any, constants: Any, tables: Sequence[tuple[int, ...]], layouts: str) -> Kernel:
    with np.errstate(over="ignore"):  # products of words may overflow
        program = Program(function, ports, constants, tables)
    return Kernel(program, [_LAYOUTS[one] for one in layouts])


def _results(physics: Physics, moved: Moved, target: Any, time: Any, over: Any) -> StepResults:
    """Return the `StepResults` of a step that ends with `moved` at a time [s].

    `target` is the tip's target at that time, a `target_record`; `over` says whether the schedule ends then.
    """
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
    return StepResults(vectors, scalars)


@functools.cache
def kernels_of(physics: Physics) -> Kernels:
    """Return the kernels for arms with these equations; the same object on every call."""
    return Kernels(physics)
