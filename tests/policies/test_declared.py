"""Every policy that comes with the package declares what it optimises, knows and sees; others say that they do not."""

import pytest

from fuzzyarm.eval.evaluation.result_table import declared_rows
from fuzzyarm.eval.report.summary import declared_table
from fuzzyarm.policies import NAMES
from fuzzyarm.policies.declared import HEADINGS, declared


@pytest.mark.parametrize("name", NAMES)
def test_policies_of_the_package_declare_all(name):
    own = declared(name)
    assert len(own) == len(HEADINGS) and all(own)
    assert "preview" in own.sees


def test_a_tip_policy_knows_the_elastic_arm_and_its_law_does_not():
    law, tip = declared("fuzzy-4"), declared("fuzzy-4-tip")
    assert "elastic" in tip.knows and "elastic" not in law.knows
    assert tip.tuned_on == law.tuned_on


def test_a_file_of_the_same_name_declares_nothing():
    assert declared("fuzzy-4.json") is None and declared("runs/ppo-robust") is None


def test_rows_stand_in_order_with_the_certificate():
    rows = declared_rows(("ppo-robust", "mine.json"), {"ppo-robust": None, "mine": "proven"})
    assert [row[0] for row in rows] == ["ppo-robust", "mine"]
    assert [row[-1] for row in rows] == ["no", "rigid arm"]
    assert set(rows[1][1:-1]) == {"not declared"}


def test_the_reports_table_has_a_row_for_each_policy():
    drawn = declared_table(("fuzzy-4", "<b>.json"), {"fuzzy-4": "proven", "<b>": None})
    assert drawn.count("<tr>") == 3 and "&lt;b&gt;" in drawn and "<b>" not in drawn
    assert all(heading in drawn for heading in HEADINGS)
