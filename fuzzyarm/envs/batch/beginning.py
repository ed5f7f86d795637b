"""The compiled beginning of episodes: the domain randomisation is drawn, the arm is loaded and put at its start."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.block import assess_block, clip, gather, gather_target, inside, observe, report, write_at_rest
from fuzzyarm.envs.batch.layout import CLOCK, Lane, Results, Start, Work, parts
from fuzzyarm.envs.batch.randomness import NEXT_KEY, RANDOMISATION, draw, uniform
from fuzzyarm.envs.batch.schedule import ReferenceRow
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import Arm, Plant, State, loaded, lump
from fuzzyarm.envs.physics.readings import at_rest, static_deflection
from fuzzyarm.envs.physics.records import BLOCK, PerJoint, in_columns, in_rows, places, reader, size, writer
from fuzzyarm.envs.scenario.randomisation import Draw, varied
from fuzzyarm.envs.task import Limits

__all__ = ["begin"]

_read_plant, _read_start = reader(Plant, in_columns), reader(Start, in_columns)
_read_draw, _read_state = reader(Draw, in_columns), reader(State, in_columns)
_read_reference = reader(ReferenceRow, in_columns)
_write_lane = writer(Lane, in_rows)
_DRAW_SIZE, _DRAWN_REFERENCE = size(Draw), places(Draw).reference
_WORK_SIZE = size(Work) * BLOCK


@kernel
def begin(
    which: np.ndarray,
    plants: np.ndarray,
    plant_of: np.ndarray,
    starts: np.ndarray,
    start_of: np.ndarray,
    radius_of: np.ndarray,
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
        plants: (plants, numbers of `Plant`).
        plant_of: (lanes,) each lane's plant.
        starts: (schedules, numbers of `Start`).
        start_of: (n,) the schedule to begin, or the first one of the family.
        radius_of: (n,) distance of the payload from joint 2 [m].
        ranges: (numbers of `Draw`, 2), see `DomainRandomisation.ranges`.
        initial: (n, 8) states; nan in the first entry: at rest on the reference.
        values: (numbers of `Lane`, lanes), written.
        clock: (numbers of `Clock`, lanes), written; holds the key of the lane's last episode before, of this one after.
        drawn: (numbers of `Draw`, lanes), written; or with no lanes, not written.
        table: (rows, numbers of `Row`).
        period: control period [s].
        out: (WIDTH n,), the results of these lanes, see `split`; written.
    """
    work, numbers, results = np.empty(_WORK_SIZE), np.empty((1, _DRAW_SIZE)), parts(out)
    for position in range(len(which)):
        lane = which[position]
        key = draw(np.uint64(clock[CLOCK.key, lane]), NEXT_KEY)
        clock[CLOCK.key, lane] = np.int64(key)
        now = _drawn(key, ranges, numbers)
        if drawn.shape[1] > 0:
            drawn[:, lane] = numbers[0]
        place = inside(start_of[position], len(starts))
        if _read_start(starts, place).family > 0.0:
            place = inside(place + np.int64(now.reference), len(starts))
        start, nominal = _read_start(starts, place), _read_plant(plants, plant_of[lane])
        first = inside(np.int64(start.first), len(table))
        clock[CLOCK.row, lane], clock[CLOCK.first, lane] = first, first
        clock[CLOCK.last, lane] = np.int64(start.last)
        arm = _loaded(nominal, now, start.payload, radius_of[position])
        if np.isnan(initial[position, 0]):
            state = _resting(nominal, now, _read_reference(table, first).q)
        else:
            state = _read_state(initial, position)
        limits = Limits(nominal.joint_limit, nominal.velocity_limit, nominal.torque_limit)
        _write_lane(values, lane, Lane(state, arm, limits, now.force, start.noise))
        _show(work, values, clock, table, period, lane, results, position)


@register_jitable
def _drawn(key: np.uint64, ranges: np.ndarray, numbers: np.ndarray) -> Draw:
    """Draw an episode into `numbers` (1, numbers of `Draw`): low + (high - low) u, rounded down for the reference."""
    for k in range(_DRAW_SIZE):
        numbers[0, k] = ranges[k, 0] + (ranges[k, 1] - ranges[k, 0]) * uniform(key, RANDOMISATION + np.uint64(k))
    numbers[0, _DRAWN_REFERENCE] = np.floor(numbers[0, _DRAWN_REFERENCE])
    now: Draw = _read_draw(numbers, 0)
    return now


@register_jitable
def _loaded(nominal: Plant, now: Draw, payload: float, radius: float) -> Arm:
    """Return the drawn plant with the case's payload, and the drawn one at the tip."""
    arm = loaded(lump(varied(nominal, now)), payload, radius, nominal.gravity)
    both: Arm = loaded(arm, now.payload, nominal.length[1], nominal.gravity)
    return both


@register_jitable
def _resting(nominal: Plant, now: Draw, reference: PerJoint) -> State:
    """Return the arm at rest, the drawn angles beside its reference [rad].

    The motors hold the gravity torque of the nominal arm: the drawn plant and the payload move the arm from the start.
    """
    link = PerJoint(reference[0] + now.angle[0], reference[1] + now.angle[1])
    state: State = at_rest(link, static_deflection(link, nominal), 0.0)
    return state


@register_jitable(forceinline=True)
def _show(
    work: np.ndarray,
    values: np.ndarray,
    clock: np.ndarray,
    table: np.ndarray,
    period: float,
    lane: int,
    results: Results,
    position: int,
) -> None:
    """Write the first results of a lane: no torque, no force and no bias act yet."""
    gather(work, 1, values, lane)
    gather_target(work, 0, table, clock[CLOCK.row, lane])
    write_at_rest(work, 0)
    clip(work, 1)
    assess_block(work, 1)
    report(work, 1, clock, lane, period, results, position)
    observe(values, clock, table, lane, results, position)
