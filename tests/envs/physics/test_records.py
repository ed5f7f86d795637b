"""Records in arrays: places, slices, and readers and writers that agree with them, in Python and compiled."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.extending import register_jitable
from slow_twins import slow_but
from support.two_joints import LAYOUT, Draw, Row

from fuzzyarm.envs.batch.layout import Start
from fuzzyarm.envs.physics.dynamics import Plant
from fuzzyarm.envs.physics.records import (
    BLOCK,
    PerJoint,
    Point,
    columns,
    flat,
    in_block,
    in_columns,
    in_list,
    in_rows,
    joint_by_joint,
    over_joints,
    per_joint,
    places,
    point,
    reader,
    size,
    state_record,
    writer,
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
def test_places_count_through_the_record(record):
    assert flat(places(record)) == list(range(size(record)))
    starts = [part.start for part in columns(record)]
    assert starts == [flat([part])[0] for part in places(record)] and columns(record)[-1].stop == size(record)


@pytest.mark.parametrize("record", RECORDS)
@pytest.mark.parametrize("address", [in_block, in_rows, in_columns, in_list])
def test_what_is_written_is_read_again(record, address):
    shapes = {in_block: size(record) * BLOCK, in_rows: (size(record), 5), in_columns: (5, size(record))}
    array = np.zeros(shapes.get(address, size(record) + 3))
    numbers = np.arange(1.0, size(record) + 1.0)
    written = reader(record, in_list)(numbers, 0)
    writer(record, address)(array, 3, written)
    assert flat(reader(record, address)(array, 3)) == numbers.tolist()
    assert np.count_nonzero(array) == size(record)


def test_a_part_of_a_record_is_read_compiled_as_in_python():
    read, table = reader(Load, in_rows, places(Pair).load), np.arange(12.0).reshape(4, 3)

    @njit
    def compiled(array, at):
        return read(array, at)

    assert read(table, 1) == compiled(table, 1) == Load(PerJoint(4.0, 7.0), 10.0)


def test_the_schedule_has_its_columns_side_by_side():
    at = columns(Row)
    assert at.reference.stop == at.target.start and at.bias.stop == size(Row)


@pytest.mark.parametrize("joints", [1, 2, 3, 7])
def test_the_records_of_so_many_joints_are_always_the_same_classes(joints):
    assert per_joint(joints) is per_joint(joints) and size(per_joint(joints)) == joints
    state = state_record(joints)
    assert state is state_record(joints) and size(state) == 4 * joints
    assert flat(places(state)) == list(range(4 * joints)) and places(state).link == tuple(range(joints, 2 * joints))
    assert point(2) is Point and per_joint(2) is PerJoint and point(3)._fields == ("x", "y", "z")


@pytest.mark.parametrize("joints", slow_but([5], [2, 5]))
def test_what_is_done_joint_by_joint_is_done_compiled_as_in_python(joints):
    kind, a, b = per_joint(joints), np.arange(1.0, joints + 1.0), np.arange(joints) - 0.5
    first, second = kind(*a), kind(*b)
    scaled, added = joint_by_joint(difference, kind, 2, shared=1), over_joints(product, kind, 2)
    both = over_joints(less, kind, 2, "&")

    @njit
    def compiled(first, second):
        return scaled(first, second, 2.0), added(first, second), both(second, first)

    expected = (tuple(a - 2.0 * b), a @ b, True)
    assert compiled(first, second) == expected
    assert (scaled(first, second, 2.0), added(first, second), both(second, first)) == expected
    assert not both(first, second) and not over_joints(less, kind, 2, "|")(first, second)


@register_jitable
def difference(a, b, factor):
    return a - factor * b


@register_jitable
def product(a, b):
    return a * b


@register_jitable
def less(a, b):
    return a < b
