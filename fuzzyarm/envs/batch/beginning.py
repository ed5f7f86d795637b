"""The compiled beginning of episodes: the domain randomisation is drawn, the arm is loaded and put at its start.

The kernel of `begin_of` begins a new episode in some lanes, at rest unless told otherwise:
``begin(which, plants, plant_of, starts, start_of, place_of, ranges, initial, values, clock, drawn, table, period,
out)``:

- which: (n,) the lanes.
- plants: (plants, numbers of `Plant`).
- plant_of: (lanes,) each lane's plant.
- starts: (schedules, numbers of `Start`).
- start_of: (n,) the schedule to begin, or the first one of the family.
- place_of: (n,) where each payload is, see `Physics.payload_place`.
- ranges: (numbers of `draw_record`, 2), see `DomainRandomisation.ranges`.
- initial: (n, numbers of the state) states; nan in the first entry: at rest on the reference.
- values: (blocks, numbers of `Lane`, `BLOCK`), written.
- clock: (numbers of `Clock`, lanes), written; holds the key of the lane's last episode before, of this one after.
- drawn: (numbers of `draw_record`, lanes), written; or with no lanes, not written.
- table: (rows, numbers of a row).
- period: control period [s].
- out: (`Layout.width` n,), the results of these lanes, see `Layout.split`; written.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.block import assess_block_of, clip_of, loads_of
from fuzzyarm.envs.batch.layout import CLOCK, Layout, Noise, Results, Start
from fuzzyarm.envs.batch.randomness import NEXT_KEY, RANDOMISATION, draw, uniform
from fuzzyarm.envs.batch.reporting import inside, observe_of, report_of
from fuzzyarm.envs.batch.schedule import reference_record
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import (
    BLOCK,
    in_block,
    in_blocks,
    in_columns,
    joint_by_joint,
    places,
    reader,
    size,
    writer,
)
from fuzzyarm.envs.scenario.randomisation import draw_record

__all__ = ["begin_of", "resting_of", "varied_of"]

_read_start = reader(Start, in_columns)


@functools.cache
def begin_of(layout: Layout) -> Any:
    """Return the kernel that begins a new episode in some lanes, see the module for its arguments and their shapes."""
    physics, Lane, parts = layout.physics, layout.Lane, layout.parts
    read_plant, read_state = reader(physics.Plant, in_columns), reader(physics.State, in_columns)
    read_reference, write_lane = reader(reference_record(physics.joints), in_columns), writer(Lane, in_blocks)
    draw_all, varied, resting, show = (
        _draw_of(physics.joints),
        varied_of(physics),
        resting_of(physics),
        _show_of(layout),
    )
    add = joint_by_joint(_plus, physics.PerJoint, 2)
    draw_size, work_size, limits_of = size(draw_record(physics.joints)), size(layout.Work) * BLOCK, physics.limits

    @kernel_for(physics.digest)
    def begin(
        which: np.ndarray,
        plants: np.ndarray,
        plant_of: np.ndarray,
        starts: np.ndarray,
        start_of: np.ndarray,
        place_of: np.ndarray,
        ranges: np.ndarray,
        initial: np.ndarray,
        values: np.ndarray,
        clock: np.ndarray,
        drawn: np.ndarray,
        table: np.ndarray,
        period: float,
        out: np.ndarray,
    ) -> None:
        work, numbers, results = np.empty(work_size), np.empty((1, draw_size)), parts(out)
        for position in range(len(which)):
            lane = which[position]
            key = draw(np.uint64(clock[CLOCK.key, lane]), NEXT_KEY)
            clock[CLOCK.key, lane] = np.int64(key)
            now = draw_all(key, ranges, numbers)
            if drawn.shape[1] > 0:
                for number in range(draw_size):  # assigned at once they compile the text of an error, for seconds
                    drawn[number, lane] = numbers[0, number]
            place = inside(start_of[position], len(starts))
            if _read_start(starts, place).family > 0.0:
                place = inside(place + np.int64(now.reference), len(starts))
            start, nominal = _read_start(starts, place), read_plant(plants, plant_of[lane])
            first = inside(np.int64(start.first), len(table))
            clock[CLOCK.row, lane], clock[CLOCK.first, lane] = first, first
            clock[CLOCK.last, lane] = np.int64(start.last)
            arm = varied(nominal, now, start.payload, place_of[position])
            if np.isnan(initial[position, 0]):
                state = resting(nominal, add(read_reference(table, first).q, now.angle), 0.0)
            else:
                state = read_state(initial, position)
            write_lane(values, lane, Lane(state, arm, limits_of(nominal), now.force, start.noise))
            show(work, values, clock, table, period, lane, results, position)

    return begin


@functools.cache
def _draw_of(joints: int) -> Any:
    """Return ``draw_all(key, ranges, numbers)``: it draws an episode into `numbers` (1, numbers of `draw_record`).

    low + (high - low) u, rounded down for the reference.
    """
    Draw = draw_record(joints)
    count, reference, read_draw = size(Draw), places(Draw).reference, reader(Draw, in_columns)

    @register_jitable
    def draw_all(key: np.uint64, ranges: np.ndarray, numbers: np.ndarray) -> Any:
        for k in range(count):
            numbers[0, k] = ranges[k, 0] + (ranges[k, 1] - ranges[k, 0]) * uniform(key, RANDOMISATION + np.uint64(k))
        numbers[0, reference] = np.floor(numbers[0, reference])
        return read_draw(numbers, 0)

    return draw_all


@functools.cache
def varied_of(physics: Physics) -> Any:
    """Return ``varied(nominal, now, payload, place)``.

    It returns the constants of the drawn plant with the case's payload [kg], and the drawn one at the tip.
    """
    vary, constants = physics.varied, physics.constants

    @register_jitable
    def varied(nominal: Any, now: Any, payload: Any, place: Any) -> Any:
        return constants(vary(nominal, now), payload, place, now.payload)

    return varied


@functools.cache
def resting_of(physics: Physics) -> Any:
    """Return ``resting(nominal, link, zero)``: the arm at rest with the links at these angles [rad].

    The motors hold the gravity torque of the nominal arm: the drawn plant and the payload move the arm from the start.
    `zero` is the velocity 0 in the number type of the state.
    """
    PerJoint, State, constants, gravity = physics.PerJoint, physics.State, physics.constants, physics.gravity
    add, deflect = joint_by_joint(_plus, PerJoint, 2), joint_by_joint(_over, PerJoint, 2)
    everywhere, stiffness = joint_by_joint(_second, PerJoint, 1, shared=1), physics.stiffness

    @register_jitable
    def resting(nominal: Any, link: Any, zero: Any) -> Any:
        still = everywhere(link, zero)
        arm = constants(nominal, zero, zero, zero)
        motor = add(link, deflect(gravity(link, arm), stiffness(nominal)))
        return State(motor, link, still, still)

    return resting


@functools.cache
def _show_of(layout: Layout) -> Any:
    """Return ``show(work, values, clock, table, period, lane, results, position)``.

    It writes the first results of a lane: no torque, no force and no bias act yet.
    """
    lane, work_at = layout.LANE, layout.WORK
    parts = (
        (layout.physics.State, lane.state, work_at.hold.state),
        (layout.physics.Arm, lane.arm, work_at.hold.arm),
        (layout.physics.Limits, lane.limits, work_at.limits),
        (Noise, lane.noise, work_at.noise),
    )
    (state_in, arm_in, limits_in, noise_in), (state, arm, limits, noise) = (
        [reader(kind, in_blocks, source) for kind, source, _ in parts],
        [writer(kind, in_block, place) for kind, _, place in parts],
    )
    load_nothing, clip, assess_block = loads_of(layout).load_nothing, clip_of(layout), assess_block_of(layout)
    report, observe = report_of(layout), observe_of(layout)

    @register_jitable(forceinline=True)
    def show(
        work: np.ndarray,
        values: np.ndarray,
        clock: np.ndarray,
        table: np.ndarray,
        period: float,
        lane: int,
        results: Results,
        position: int,
    ) -> None:
        state(work, 0, state_in(values, lane))
        arm(work, 0, arm_in(values, lane))
        limits(work, 0, limits_in(values, lane))
        noise(work, 0, noise_in(values, lane))
        load_nothing(work, table, clock[CLOCK.row, lane])
        clip(work, 1)
        assess_block(work, 1)
        report(work, 1, clock, lane, period, results, position)
        observe(work, 1, clock, table, lane, results, position)

    return show


@register_jitable(forceinline=True)
def _plus(a: Any, b: Any) -> Any:
    return a + b


@register_jitable(forceinline=True)
def _over(a: Any, b: Any) -> Any:
    return a / b


@register_jitable(forceinline=True)
def _second(_: Any, b: Any) -> Any:
    return b
