"""A proof for ever from a box of starts, and plants that begin at its corners and do several laps."""

import dataclasses

import numpy as np
import pytest
from support.forged_bounds import checked
from tip_falsification import BOX, LAPS, ratios
from tip_plants import random_genes

from fuzzyarm.policies.tip_bound import TipClaim, find_bound


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_lap_from_a_corner_of_the_box_leaves_the_bound_and_a_smaller_set_is_refused(tmp_path):
    bound = find_bound(TipClaim("fuzzy-4-tip", laps="ever", start=BOX))
    assert len(bound.all_laps) < LAPS and bound.later[-1].whole.max() < 2.4e-6
    assert 0.9 < ratios(bound, random_genes(32, np.random.default_rng(0))).max() <= 1.0
    assert checked(bound, tmp_path / "bound.json").proven
    begin = bound.later[-1].begin
    smaller = dataclasses.replace(bound.later[-1], begin=begin._replace(columns=0.2 * begin.columns))
    answer = checked(dataclasses.replace(bound, later=(*bound.later[:-1], smaller)), tmp_path / "forged.json")
    assert not answer.proven and "is not inside the set in which the next lap begins" in answer.reason
