"""The kernels of the environments: a control step of every lane, the beginning of episodes, and observations.

One arm and a quarter of a million run the same functions, `control_step.control_step_of`, `beginning.begun_of` and
`control_step.reading_of`, recorded once and run as machine code on the arrays that `layout` describes.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.beginning import Given, begun_of
from fuzzyarm.envs.batch.layout import Clock, Results, Scalars, Start, Vectors, layout_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.control_step import Moved, assessed_of, control_step_of, reading_of
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import places, size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.numbers import machine
from fuzzyarm.numbers.functions import bits, flat, like, minimum, number, row, whole, word, zeros
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["Kernels", "kernels_of"]

_ROWS, _COLUMNS, _BLOCKS = machine.Layout


class Kernels:
    """The kernels for arms with the same equations, each recorded when it is first used.

    Attributes:
        layout: of the arrays that they work on.
    """

    def __init__(self, physics: Physics) -> None:
        """Keep the equations."""
        self.layout = layout_of(physics)
        self._row = row_record(physics.joints, physics.axes)
        self._nothing = physics.PerJoint(*[0.0] * physics.joints)

    @functools.cached_property
    def step(self) -> Kernel:
        """Hold torques in every lane for one control step.

        On values, clock, commands (lanes, joints) [N m], observations and `Results` (numbers, lanes), with the control
        period [s], the sub-step [s] and the number of sub-steps; the table is the schedule.
        """
        physics, Row = self.layout.physics, self._row
        control_step, reading = control_step_of(physics), reading_of(physics)

        def step(lane: Any, clock: Clock, command: Any, _: Any, __: Any, given: Any, schedule: Any) -> tuple[Any, ...]:
            period, h, substeps = given
            at, first, last = (number(word(one)) for one in (clock.row, clock.first, clock.last))
            reached = minimum(at + 1.0, last)  # two threads may step an episode that is over: it stays at its end
            now, after = (like(places(Row), iter(row(schedule, place))) for place in (at, reached))
            moved = control_step(
                lane.state, command, now, after.target, lane.arm, lane.limits, lane.force_factor, h, substeps
            )
            clock = clock._replace(row=bits(whole(reached)))
            results = _results(physics, moved, after.target, (reached - first) * period, reached == last)
            q, dq = reading(moved.state, lane.limits, lane.noise, word(clock.key), reached - first)
            seen = Observation(q, dq, *after.reference)
            return lane._replace(state=moved.state), clock, command, seen, results

        ports = self._lane, _CLOCK, self._nothing, self._seen, self._results
        program = Program(step, ports, (0.0, 0.0, 0.0), [(0, size(Row))])
        return Kernel(program, (_BLOCKS, _COLUMNS, _ROWS, _ROWS, _COLUMNS))

    @functools.cached_property
    def begin(self) -> Kernel:
        """Begin an episode in every lane.

        On values, clock, what is drawn (numbers, lanes), `Given` and the initial states (lanes, numbers), observations
        and `Results` (numbers, lanes), with the ranges of what is drawn; the tables are plants, starts and schedule.
        """
        physics, Row, nothing = self.layout.physics, self._row, self._nothing
        begun, assessed, reading = begun_of(self.layout), assessed_of(physics), reading_of(physics)
        Draw, no_force = draw_record(physics.joints), [0.0] * physics.axes

        def begin(*arguments: Any) -> tuple[Any, ...]:
            _, clock, _, given, initial, _, _, ranges, *tables = arguments
            lane, clock, drawn, now = begun(clock, given, initial, ranges, *tables)
            moved = assessed(
                lane.state, lane.state, nothing, nothing, nothing, no_force, now.target, lane.arm, lane.limits
            )
            over = number(word(clock.row)) == number(word(clock.last))
            results = _results(physics, moved, now.target, 0.0, over)
            q, dq = reading(lane.state, lane.limits, lane.noise, word(clock.key), 0.0)
            return lane, clock, drawn, given, initial, Observation(q, dq, *now.reference), results

        given, state = Given(0.0, 0.0, 0.0), zeros(places(physics.State))
        ports = self._lane, _CLOCK, places(Draw), given, state, self._seen, self._results
        with np.errstate(over="ignore"):
            program = Program(
                begin, ports, ((0.0, 0.0),) * size(Draw), [(0, size(kind)) for kind in (physics.Plant, Start, Row)]
            )
        return Kernel(program, (_BLOCKS, _COLUMNS, _COLUMNS, _ROWS, _ROWS, _ROWS, _COLUMNS))

    @functools.cached_property
    def observe(self) -> Kernel:
        """Write what the last step, or the beginning of the episode, let be observed; nothing moves.

        On values, clock and observations; the table is the schedule.
        """
        physics, Row = self.layout.physics, self._row
        reading = reading_of(physics)

        def observe(lane: Any, clock: Clock, _: Any, __: Any, schedule: Any) -> tuple[Any, ...]:
            at, first = number(word(clock.row)), number(word(clock.first))
            now = like(places(Row), iter(row(schedule, at)))
            q, dq = reading(lane.state, lane.limits, lane.noise, word(clock.key), at - first)
            return lane, clock, Observation(q, dq, *now.reference)

        program = Program(observe, (self._lane, _CLOCK, self._seen), (), [(0, size(Row))])
        return Kernel(program, (_BLOCKS, _COLUMNS, _ROWS))

    @property
    def _lane(self) -> Any:
        return places(self.layout.Lane)

    @property
    def _seen(self) -> Any:
        return Observation(*[self._nothing] * len(Observation._fields))

    @property
    def _results(self) -> Any:
        return zeros((0.0,) * self.layout.reported)

    def prepare(self, lanes: int) -> None:
        """Make the machine code that steps so many lanes: the first step need not wait for it."""
        self.step.code(lanes)

    def __reduce__(self) -> tuple[Any, tuple[Physics]]:
        """Leave the machine code behind."""
        return kernels_of, (self.layout.physics,)


_CLOCK = Clock(0.0, 0.0, 0.0, 0.0)


def _results(physics: Physics, moved: Moved, target: Any, time: Any, over: Any) -> tuple[Any, ...]:
    """Return the numbers of the `Results`; `over` says whether the schedule is at its end."""
    found, state = moved.found, moved.state
    vectors = Vectors(
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
    scalars = Scalars(
        time=time,
        tip_error=found.tip_error,
        circularity_error=found.circularity_error,
        circularity_error_motor=found.circularity_error_motor,
        reward_tracking=found.reward_tracking,
        reward_effort=found.reward_effort,
        reward=found.reward,
        torque_clipped=moved.clipped,
        truncated=1.0 * ((moved.reason == 0.0) & over),
        reason=moved.reason,
    )
    return tuple(flat(Results(vectors, scalars)))


@functools.cache
def kernels_of(physics: Physics) -> Kernels:
    """Return the kernels for arms with these equations, always the same ones."""
    return Kernels(physics)
