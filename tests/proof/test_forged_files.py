"""Forged and extreme controller files: one clear line, or an honest report; never another error and no false proof."""

import dataclasses
import functools
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slow_twins import slow_but
from support.command_line import one_line_error
from support.shipped import CONTROLLERS

from fuzzyarm.cli import main
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, Controller
from fuzzyarm.fuzzy_policy.signed_files import _LARGEST, digest_of
from fuzzyarm.proof import rigid_loop as frozen
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.rigid_loop import RigidLoop, gain_at


@functools.cache
def shipped(name):
    return Controller.load(CONTROLLERS[name])


@functools.cache
def limits(name):
    """Return the slowest pole [1/s] of the loop frozen anywhere in the box, and its largest gain: no proof beats it.

    After a short search, which finds them nearly.
    """
    loop = RigidLoop(shipped(name))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frozen, "GENERATIONS", 40)
        slowest = -loop.worst_point(lambda F, G, omega: np.linalg.eigvals(F).real.max(axis=-1)).value
        return slowest, loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega)).value


@settings(max_examples=15, deadline=None)
@given(
    name=st.sampled_from(["fuzzy-1", "fuzzy-4"]),
    tighter=st.sampled_from(["alpha", "gamma", "both"]),
    factor=st.floats(1.0, 1e6, exclude_min=True),
    scales=st.tuples(*[st.floats(-3.0, 3.0)] * 4),
)
def test_a_claim_beyond_what_holds_is_never_proven(name, tighter, factor, scales):
    """Whatever P and the slack are scaled by: with this factor some frozen loop breaks the claim."""
    controller, (slowest, largest) = shipped(name), limits(name)
    assert slowest > controller.alpha and largest < controller.gamma
    alpha = min(slowest * factor, RATES[1]) if tighter != "gamma" else controller.alpha
    gamma = max(largest / factor, GAINS[0]) if tighter != "alpha" else controller.gamma
    pole = None if controller.fastest_pole is None else min(max(controller.fastest_pole, 2.0 * alpha), RATES[1])
    if pole is not None and alpha >= pole:
        return
    scaled = {
        key: getattr(controller, key) * 10.0**scale for key, scale in zip(("P", "Q", "X", "tau"), scales, strict=True)
    }
    forged = dataclasses.replace(controller, alpha=alpha, gamma=gamma, fastest_pole=pole, **scaled)
    assert not certify(forged).proven


@pytest.mark.parametrize("value", [1.7e308, 5e-324, 0.0, -1.0])
def test_an_extreme_number_is_refused_with_its_range(tmp_path, capsys, value):
    path, document = tmp_path / "forged.json", json.loads(shipped("fuzzy-4").to_json())
    del document["digest"]
    for field in ("alpha", "gamma", "fastest_pole", *(("P", "tau", "gains") if value > 1.0 else ())):
        forged = re.sub(r"-?0x[^\"]+", value.hex(), json.dumps(document[field]))
        content = document | {field: json.loads(forged)}
        path.write_text(json.dumps({**content, "digest": digest_of(content)}))
        assert main(["verify", str(path)]) == 2
        error = one_line_error(capsys)
        assert field in error and ("allowed: " in error or "holds a number of size 1.7e+308" in error)


@pytest.mark.parametrize("field", ["P", "Q", "X", "tau", "gains"])
@pytest.mark.parametrize("value", slow_but([_LARGEST, 0.0], [_LARGEST, -_LARGEST, 1e-300, 0.0]))
def test_numbers_at_the_end_of_the_range_prove_nothing(field, value):
    controller = shipped("fuzzy-4")
    array = np.full_like(getattr(controller, field), value)
    if field == "P":
        array = np.diag(np.diag(array))
    assert not certify(dataclasses.replace(controller, **{field: array})).proven
