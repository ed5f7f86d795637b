"""Records in arrays: places, slices, and readers and writers that agree with them, in Python and compiled."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit

from fuzzyarm.envs.batch.layout import Lane, Start, Work
from fuzzyarm.envs.batch.schedule import COLUMNS, Row
from fuzzyarm.envs.physics.dynamics import Plant
from fuzzyarm.envs.physics.records import (
    BLOCK,
    PerJoint,
    columns,
    in_block,
    in_columns,
    in_list,
    in_rows,
    places,
    reader,
    size,
    times,
    writer,
)
from fuzzyarm.envs.scenario.randomisation import Draw


class Load(NamedTuple):
    torque: PerJoint
    mass: Any


class Pair(NamedTuple):
    first: Any
    load: Load


RECORDS = (Load, Pair, Plant, Draw, Row, Start, Lane, Work)


def flat(record):
    """The numbers of a record, in order."""
    return [number for part in record for number in (flat(part) if isinstance(part, tuple) else [part])]


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
    assert COLUMNS.reference.stop == COLUMNS.target.start and COLUMNS.bias.stop == size(Row)


def test_times_is_joint_by_joint():
    assert times((2.0, 3.0), PerJoint(5.0, 7.0)) == PerJoint(10.0, 21.0)
