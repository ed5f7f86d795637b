"""The tube of a proven bound in the report: its sentence, its drawing, and what is refused."""

import dataclasses
import json
import re

import numpy as np
import pytest

from fuzzyarm.eval.report.certificates import checked_bounds, tube_section
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.policies.tip_files import save_bound
from fuzzyarm.proof.tip.plant import PlantSet

STEPS = 15


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("tube") / "bound.json"
    save_bound(find_bound(TipClaim("fuzzy-4-tip", "nominal", "table-1", PlantSet(), steps=STEPS)), out)
    return out


def test_the_simulated_tip_is_drawn_within_the_tube(evaluation, path):
    checks = checked_bounds([path])
    section = tube_section(checks, evaluation.rollouts)
    assert "fuzzy-4-tip: tip within" in section and "for set table-1, proven" in section
    drawn = {
        name: np.array([list(map(float, pair.split(","))) for pair in points.split()])
        for name, points in re.findall(r'class="(band|path|tip)" points="([^"]*)"', section)
    }
    outer, inner = drawn["band"][:STEPS], drawn["band"][: STEPS - 1 : -1]
    np.testing.assert_allclose(0.5 * (outer + inner), drawn["path"], atol=0.11)
    half = 0.5 * np.hypot(*(outer - inner).T)
    assert (np.hypot(*(drawn["tip"] - drawn["path"]).T) <= half + 0.2).all()  # a digit of a pixel each
    assert half.max() > 10.0 and np.hypot(*(drawn["tip"] - drawn["path"]).T).max() > 5.0


def test_a_bound_that_is_not_proven_or_of_another_episode_is_refused(evaluation, path, tmp_path):
    (check,) = checked_bounds([path])
    other = dataclasses.replace(check, claim=dataclasses.replace(check.claim, path="lemniscate"))
    with pytest.raises(ValueError, match="no episode of fuzzy-4-tip in case nominal along the lemniscate"):
        tube_section([other], evaluation.rollouts)
    content = json.loads(path.read_text())
    forged = tmp_path / "forged.json"
    forged.write_text(json.dumps(content | {"bound": 0.5 * content["bound"]}))
    with pytest.raises(ValueError, match=r"forged\.json is not proven"):
        checked_bounds([forged])
