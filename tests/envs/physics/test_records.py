"""Records in arrays: places, slices, and what is filled by them."""

from typing import Any, NamedTuple

import pytest
from support.two_joints import LAYOUT, Draw, Row

from fuzzyarm.envs.batch.layout import Start
from fuzzyarm.envs.physics.dynamics import Plant
from fuzzyarm.envs.physics.records import (
    PerJoint,
    Point,
    columns,
    filled,
    flat,
    per_joint,
    places,
    point,
    size,
    state_record,
)


class Load(NamedTuple):
    torque: PerJoint
    mass: Any


class Pair(NamedTuple):
    first: Any
    load: Load


RECORDS = (Load, Pair, Plant, Draw, Row, Start, LAYOUT.Lane)


def test_places_and_columns_of_a_nested_record():
    assert size(Pair) == 4 and places(Pair) == Pair(0, Load(PerJoint(1, 2), 3))
    assert columns(Pair) == Pair(slice(0, 1), slice(1, 4))


@pytest.mark.parametrize("record", RECORDS)
def test_places_count_through_the_record_and_fill_it(record):
    numbers = list(range(size(record)))
    assert flat(places(record)) == numbers
    assert filled(record, numbers) == places(record) and flat(filled(record, numbers)) == numbers
    starts = [part.start for part in columns(record)]
    assert starts == [flat((part,))[0] for part in places(record)] and columns(record)[-1].stop == size(record)


@pytest.mark.parametrize("joints", [1, 2, 3, 7])
def test_the_records_of_so_many_joints_are_always_the_same_classes(joints):
    assert per_joint(joints) is per_joint(joints) and size(per_joint(joints)) == joints
    state = state_record(joints)
    assert state is state_record(joints) and size(state) == 4 * joints
    assert flat(places(state)) == list(range(4 * joints)) and places(state).link == tuple(range(joints, 2 * joints))
    assert point(2) is Point and per_joint(2) is PerJoint and point(3)._fields == ("x", "y", "z")
