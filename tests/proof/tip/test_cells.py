"""Division of a set into cells: they cover it, a gap is found, and a cell without a tube is halved."""

import itertools

import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.policies import tip_cells as module
from fuzzyarm.policies.tip_bound import TipClaim
from fuzzyarm.policies.tip_cells import _bounds_of_cell as bounds_of_cell
from fuzzyarm.policies.tip_cells import cells
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import BY_JOINT, BallPlant, PlantSet

WIDE = PlantSet(mass=(0.95, 1.05), stiffness=((0.9, 1.1), (0.8, 1.0)), payload=(0.0, 1.0), dry_friction=(0.5, 1.5))
DIVISIONS = [("stiffness", 2), ("mass", 3), ("payload", 2)]


def test_cells_cover_the_set_and_each_is_needed():
    parts = list(cells(WIDE, DIVISIONS))
    assert len(parts) == 2**2 * 3**2 * 2 and WIDE.hole(parts) is None
    for gone in (0, 17, len(parts) - 1):
        assert WIDE.hole(parts[:gone] + parts[gone + 1 :]) == parts[gone]


def test_the_range_of_one_joint_alone_can_be_divided():
    parts = list(cells(WIDE, [("mass-2", 4)]))
    assert [part.of_joint("mass", 0) for part in parts] == [(0.95, 1.05)] * 4 and WIDE.hole(parts) is None
    with pytest.raises(ValueError, match="divides already"):
        list(cells(WIDE, [("mass", 2), ("mass-2", 4)]))


def test_a_cell_without_a_tube_is_halved_where_it_is_widest_until_all_have_one(monkeypatch):
    def find(claim):
        low, high = claim.plants.of_joint("stiffness", 1)
        if high - low > 0.06:
            raise NoBound("too wide")
        return claim

    monkeypatch.setattr(module, "find_bound", find)
    claim = TipClaim("fuzzy-4-tip", plants=next(cells(WIDE, DIVISIONS)))
    found = [part.plants for part in bounds_of_cell(claim, WIDE, ["stiffness", "mass"])]
    assert len(found) > 1 and claim.plants.hole(found) is None
    assert all(high - low <= 0.06 for low, high in (part.of_joint("stiffness", 1) for part in found))
    with pytest.raises(NoBound, match=r"stiffness 1 from 0\.9 to 1 times, .*: too wide"):
        list(bounds_of_cell(claim, WIDE, ["mass"], 2))


def test_ranges_of_one_joint_are_those_of_that_joint_alone():
    for name, joint in itertools.product(BY_JOINT, (0, 1)):
        pair = tuple((0.9, 1.1) if j == joint else (1.0, 1.0) for j in (0, 1))
        one = BallPlant.of(ArmParameters(), Disturbance(), PlantSet(**{name: [list(r) for r in pair]}))
        both = BallPlant.of(ArmParameters(), Disturbance(), PlantSet(**{name: (0.9, 1.1)}))
        (parameter,) = one.parameters
        assert str(parameter) in map(str, both.parameters)
        assert (parameter.kind, parameter.joint) == (name, joint)
        assert one.middle == both.middle
    middle = BallPlant.of(ArmParameters(), Disturbance(), PlantSet(stiffness=((0.8, 1.0), (1.0, 1.3)))).middle
    assert (middle.stiffness1, middle.stiffness2) == pytest.approx((0.9 * 6.4e4, 1.15 * 1.2e4))
