"""One tube of a law with any torque beside it bounds the tip for every guest in a shield."""

import json

import numpy as np
import pytest
from support.forged_bounds import checked
from support.tip_errors import tip_errors

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.policies.tip_files import check_bound

STEPS, MARGIN = 20, np.array([4.0, 2.0])
NAME = "shield:fuzzy-4-tip:any:4,2"


@pytest.fixture(scope="module")
def bound():
    return find_bound(TipClaim("shield:fuzzy-4-tip:ppo-robust:4,2", steps=STEPS))


def _errors(torques):
    return tip_errors(FuzzyArmEnv(), load_policy("fuzzy-4-tip"), torques)


@pytest.mark.slow
def test_the_worst_guest_that_is_found_stays_within_the_bound_and_reaches_a_good_part_of_it(bound):
    """Each torque is of the sign that moves the last tip furthest, by finite differences."""
    slopes, push = np.zeros((STEPS, 2)), np.tile(MARGIN, (STEPS, 1))
    for place in np.ndindex(STEPS, 2):
        less = push.copy()
        less[place] *= -1.0
        slopes[place] = _errors(push)[-1] - _errors(less)[-1]
    errors = _errors(np.sign(slopes) * MARGIN)
    assert (errors <= bound.tip).all()
    assert errors[-1] > 0.15 * bound.tip[-1]
    assert errors[-1] > 10.0 * find_bound(TipClaim("fuzzy-4-tip", steps=STEPS)).largest  # far above the law's own bound


def test_the_claim_is_about_every_guest_and_says_so(bound):
    assert bound.claim.policy == NAME
    assert "whatever a guest adds to the torques within ± (4.0, 2.0) N m" in bound.to_text()


def test_a_file_for_a_wider_margin_or_without_a_guest_is_refused(bound, tmp_path):
    path, alone = tmp_path / "bound.json", find_bound(TipClaim("fuzzy-4-tip", steps=3))
    for true, policy in ((bound, "shield:fuzzy-4-tip:any:4,2.1"), (alone, NAME)):
        assert checked(true, path).proven
        path.write_text(json.dumps(json.loads(path.read_text()) | {"policy": policy}))
        found = check_bound(path)
        assert not found.proven and "may leave the claimed tube" in found.reason
