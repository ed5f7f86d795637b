"""The info of some lanes of a batch: their rows and zeros, for small arrays and for those that come as pages."""

import numpy as np
import pytest

from fuzzyarm.envs.batch.layout import SCALARS
from fuzzyarm.envs.vector import _partial_info, values


@pytest.mark.parametrize("lanes", [7, 40_000])
def test_lanes_without_info_have_zeros_and_nothing_is_shared(lanes):
    generator = np.random.default_rng(1)
    vectors, scalars = generator.normal(size=(9, lanes, 2)), generator.normal(size=(len(SCALARS), lanes))
    scalars[SCALARS.index("reason")] = generator.integers(0, 2, lanes)
    mask = generator.random(lanes) < 0.4
    before = [part.copy() for part in (vectors, scalars)]
    found = _partial_info(vectors, scalars, {"payload": scalars[0]}, mask)
    whole = {**values(vectors, scalars), "randomisation": None}
    assert set(found) == {*whole, *(f"_{key}" for key in whole)}
    drawn = found.pop("randomisation")
    assert np.array_equal(drawn["payload"], np.where(mask, scalars[0], 0.0))
    for key, rows in values(vectors, scalars).items():
        assert found[f"_{key}"] is mask
        assert found[key].dtype == rows.dtype
        assert np.array_equal(found[key], np.where(mask.reshape(-1, *[1] * (rows.ndim - 1)), rows, 0)), key
        found[key][:] = 1  # the caller may write
    assert all(np.array_equal(part, then) for part, then in zip((vectors, scalars), before, strict=True))
