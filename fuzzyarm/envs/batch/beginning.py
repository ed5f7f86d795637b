"""The beginning of an episode: the domain randomisation is drawn, the arm is loaded and put at its start."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from fuzzyarm.envs.batch.layout import Clock, Layout, Start
from fuzzyarm.envs.batch.randomness import NEXT_KEY, RANDOMISATION, draw, uniform
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import places
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.numbers.functions import bits, flat, floor, like, row, select, when, whole, word

__all__ = ["Given", "begun_of", "drawn_of", "resting_of"]


class Given(NamedTuple):
    """What an episode begins with."""

    plant: Any  # number of the lane's plant
    start: Any  # the schedule to begin, or the first one of a family
    place: Any  # where the payload is, see `Physics.payload_place`


@functools.cache
def begun_of(layout: Layout) -> Callable[..., tuple[Any, Any, Any, Any]]:
    """Return ``begun(clock, given, initial, ranges, plants, starts, schedule)``.

    `clock` holds the key of the lane's last episode, `given` is a `Given`, `initial` the state to begin with, at rest
    on the reference where its first number is nan; `ranges` are pairs (low, high) as in a `draw_record`. The tables
    have rows of the physics' `Plant`, of `Start` and of `row_record`. It returns what the lane carries, its clock, what
    was drawn, and the schedule's first row.
    """
    physics, Lane = layout.physics, layout.Lane
    Row, Plant, PerJoint = row_record(physics.joints, physics.axes), physics.Plant, physics.PerJoint
    drawn_by, resting = drawn_of(physics.joints), resting_of(physics)

    def begun(
        clock: Clock, given: Given, initial: Any, ranges: Any, plants: Any, starts: Any, schedule: Any
    ) -> tuple[Any, Any, Any, Any]:
        key = draw(word(clock.key), NEXT_KEY)
        drawn = drawn_by(key, ranges)
        family = _record(Start, row(starts, given.start)).family > 0.0
        start = _record(Start, row(starts, select(family, given.start + drawn.reference, given.start)))
        nominal, now = _record(Plant, row(plants, given.plant)), _record(Row, row(schedule, start.first))
        arm = physics.constants(physics.varied(nominal, drawn), start.payload, given.place, drawn.payload)
        rest = resting(nominal, PerJoint(*(q + a for q, a in zip(now.reference.q, drawn.angle, strict=True))), 0.0)
        free = flat(initial)[0] != flat(initial)[0]
        pairs = zip(flat(rest), flat(initial), strict=True)
        state = like(rest, (select(free, own, asked) for own, asked in pairs))
        first = bits(whole(start.first))
        lane = Lane(state, arm, physics.limits(nominal), drawn.force, start.noise)
        return lane, Clock(first, first, bits(whole(start.last)), bits(key)), drawn, now

    return begun


def _record(kind: Any, numbers: Any) -> Any:
    return like(places(kind), iter(numbers))


@functools.cache
def drawn_of(joints: int) -> Callable[[Any, Any], Any]:
    """Return ``drawn(key, ranges)``, a `draw_record`: low + (high - low) u, rounded down for the reference."""
    Draw = places(draw_record(joints))

    def drawn(key: Any, ranges: Any) -> Any:
        def number(low: Any, high: Any, counter: int) -> Any:
            return when(low < high, lambda: (low + (high - low) * uniform(key, counter),), (low,))[0]

        draws = like(Draw, (number(low, high, RANDOMISATION + k) for k, (low, high) in enumerate(ranges)))
        return draws._replace(reference=floor(draws.reference))

    return drawn


@functools.cache
def resting_of(physics: Physics) -> Callable[..., Any]:
    """Return ``resting(nominal, link, zero)``: the arm at rest with the links at these angles [rad].

    The motors hold the gravity torque of the nominal arm: the drawn plant and the payload move the arm from the start.
    `zero` is the velocity 0 in the number type of the state.
    """
    PerJoint, State = physics.PerJoint, physics.State

    def resting(nominal: Any, link: Any, zero: Any) -> Any:
        still = PerJoint(*[zero] * physics.joints)
        weight = physics.gravity(link, physics.constants(nominal, zero, zero, zero))
        stiffness = physics.stiffness(nominal)
        motor = PerJoint(*(q + g / k for q, g, k in zip(link, weight, stiffness, strict=True)))
        return State(motor, link, still, still)

    return resting
