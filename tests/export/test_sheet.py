"""The sheet of a law: its numbers are those of the policy, and the page computes with them what the policy does."""

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.export.sheet import _check_observation, sheet_of

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "controllers" / "implement.md"


def printed(capsys, *words):
    assert main(["show", *words]) == 0
    return capsys.readouterr().out


def test_the_code_of_the_page_is_the_shipped_law(capsys):
    """The page's own lines, from the printed sheet, against the policy within and beyond its limits."""
    names = {"sheet": json.loads(printed(capsys, "fuzzy-4", "--json"))}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(block, names)
    policy, rng = load_policy("fuzzy-4"), np.random.default_rng(3)
    seen = rng.uniform(-2.0, 2.0, (300, 10))
    seen[::2, 4:6] = seen[::2, :2] + rng.normal(scale=1e-3, size=(150, 2))
    for observation, x_I in zip(seen, rng.normal(scale=1e-3, size=(300, 2)), strict=True):
        torque, state = policy.predict(observation, x_I)
        own, after = names["step"](observation, x_I)
        np.testing.assert_allclose(own, torque, rtol=1e-11, atol=1e-9)
        np.testing.assert_allclose(after, state, rtol=1e-15)


def test_the_numbers_on_the_page_are_those_of_the_command(capsys):
    block = PAGE.read_text(encoding="utf-8").split("one state to check against:")[1].split("```")[0]
    shown = printed(capsys, "fuzzy-4").split("one state to check against:")[1].split("proven of the rigid arm:")[0]
    assert block.split() == shown.split()


def test_csv_and_json_hold_the_gains_exactly(capsys):
    policy = load_policy("fuzzy-8")
    rows = list(csv.DictReader(io.StringIO(printed(capsys, "fuzzy-8", "--csv"))))
    values = {(row["quantity"], row["index"]): float(row["value"]) for row in rows}
    gains = policy.controller.gains
    for i, k, joint, entry in np.ndindex(gains[..., :4].shape):
        assert values["K", f"{i + 1} {k + 1} {joint + 1} {entry + 1}"] == gains[i, k, joint, entry]
    sheet = json.loads(printed(capsys, "fuzzy-8", "--json"))
    np.testing.assert_array_equal(sheet["quantities"]["H"]["values"], gains[..., 4:])
    assert sheet["certificate"]["digest"] == policy.controller.digest
    torque, _ = policy.predict(_check_observation(2))
    np.testing.assert_array_equal(sheet["check"]["torque"]["values"][0], torque)


@pytest.mark.parametrize("name", ["computed-torque", "fuzzy-4-tip", "elastic-observer"])
def test_every_model_based_law_has_a_sheet(name):
    sheet = sheet_of(name, load_policy(name))
    assert all(np.isfinite(quantity.values).all() for quantity in (*sheet.quantities, *sheet.check))
    assert (sheet.certificate is None) == (not name.startswith("fuzzy"))
    assert len({quantity.name for quantity in sheet.quantities}) == len(sheet.quantities)
    assert "u = " in sheet.to_text()
