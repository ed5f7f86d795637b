"""Records in arrays: places, slices, and what is filled by them."""

from typing import Any, NamedTuple

import pytest
from support.two_joints import LAYOUT, Draw, Row

from fuzzyarm.envs.batch.layout import Start
from fuzzyarm.envs.physics.dynamics import Plant
from fuzzyarm.envs.physics.records import PerJoint, columns, filled, flat, places, size, state_record


class Load(NamedTuple):
    torque: PerJoint
    mass: Any


class Pair(NamedTuple):
    first: Any
    load: Load


RECORDS = (Load, Pair, Plant, Draw, Row, Start, LAYOUT.Lane, state_record(7))


@pytest.mark.parametrize("record", RECORDS)
def test_places_count_through_the_record_and_fill_it(record):
    numbers = list(range(size(record)))
    assert flat(places(record)) == numbers
    assert filled(record, numbers) == places(record) and flat(filled(record, numbers)) == numbers
    starts = [part.start for part in columns(record)]
    assert starts == [flat((part,))[0] for part in places(record)] and columns(record)[-1].stop == size(record)
