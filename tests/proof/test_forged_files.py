"""Extreme controller files: one clear line, or an honest report; `abuse` has forged ones."""

import dataclasses
import json
import re

import numpy as np
import pytest
from slow_twins import slow_but
from support.command_line import one_line_error
from support.shipped import CONTROLLERS

from fuzzyarm.cli import main
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.signed_files import _LARGEST
from fuzzyarm.fuzzy_policy.signed_files import _digest_of as digest_of
from fuzzyarm.proof.certificate import certify

FOUR = Controller.load(CONTROLLERS["fuzzy-4"])


@pytest.mark.parametrize("value", [1.7e308, 5e-324, 0.0, -1.0])
def test_an_extreme_number_is_refused_with_its_range(tmp_path, capsys, value):
    path, document = tmp_path / "forged.json", json.loads(FOUR.to_json())
    del document["digest"]
    for field in ("alpha", "gamma", "fastest_pole", *(("P", "tau", "gains") if value > 1.0 else ())):
        forged = re.sub(r"-?0x[^\"]+", value.hex(), json.dumps(document[field]))
        content = document | {field: json.loads(forged)}
        path.write_text(json.dumps({**content, "digest": digest_of(content)}))
        assert main(["verify", str(path)]) == 2
        error = one_line_error(capsys)
        assert field in error and ("allowed: " in error or "contains a number of magnitude 1.7e+308" in error)


@pytest.mark.parametrize("field", ["P", "Q", "X", "tau", "gains"])
@pytest.mark.parametrize("value", slow_but([_LARGEST, 0.0], [_LARGEST, -_LARGEST, 1e-300, 0.0]))
def test_numbers_at_the_end_of_the_range_prove_nothing(field, value):
    array = np.full_like(getattr(FOUR, field), value)
    if field == "P":
        array = np.diag(np.diag(array))
    assert not certify(dataclasses.replace(FOUR, **{field: array})).proven
