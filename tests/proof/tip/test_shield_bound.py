"""One tube of a law with any torque beside it bounds the tip for every guest in a shield."""

import json

import numpy as np
import pytest
from support.forged_bounds import checked

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.policies.tip_files import check_bound, save_bound

STEPS, MARGIN = 20, np.array([4.0, 2.0])
NAME = "shield:fuzzy-4-tip:any:4,2"


@pytest.fixture(scope="module")
def bound():
    return find_bound(TipClaim("shield:fuzzy-4-tip:ppo-robust:4,2", steps=STEPS))


def _errors(torques):
    """Return the tip errors [m] of fuzzy-4-tip with torques (steps, 2) [N m] beside its own."""
    env, policy, state = FuzzyArmEnv(), load_policy("fuzzy-4-tip"), None
    observation, info = env.reset(seed=0)
    found = []
    for beside in torques:
        torque, state = policy.predict(observation, state)
        observation, *_, info = env.step(torque + beside)
        found.append(info["tip_error"])
    return np.array(found)


@pytest.mark.slow
def test_the_worst_guest_that_is_found_stays_within_the_bound_and_reaches_a_good_part_of_it(bound):
    """Each torque is of the sign that moves the last tip furthest, by finite differences."""
    slopes = np.zeros((STEPS, 2))
    push = np.ones((STEPS, 2)) * MARGIN
    for k in range(STEPS):
        for joint in range(2):
            less = push.copy()
            less[k, joint] = -MARGIN[joint]
            slopes[k, joint] = _errors(push)[-1] - _errors(less)[-1]
    worst = np.sign(slopes) * MARGIN
    errors = _errors(worst)
    assert (errors <= bound.tip).all()
    assert errors[-1] > 0.15 * bound.tip[-1]
    assert errors[-1] > 10.0 * find_bound(TipClaim("fuzzy-4-tip", steps=STEPS)).largest  # far above the law's own bound


def test_the_claim_is_about_every_guest_and_says_so(bound):
    assert bound.claim.policy == NAME
    assert "whatever a guest adds to the torques within ± (4.0, 2.0) N m" in bound.to_text()


def test_a_file_for_a_wider_margin_or_another_law_is_refused(bound, tmp_path):
    assert checked(bound, tmp_path / "true.json").proven
    save_bound(bound, tmp_path / "forged.json")
    content = json.loads((tmp_path / "forged.json").read_text())
    content["policy"] = "shield:fuzzy-4-tip:any:4,2.1"
    (tmp_path / "forged.json").write_text(json.dumps(content))
    assert "may leave the claimed tube" in check_bound(tmp_path / "forged.json").reason


def test_a_narrow_tube_without_a_guest_does_not_prove_a_shield(tmp_path):
    save_bound(find_bound(TipClaim("fuzzy-4-tip", steps=3)), tmp_path / "bound.json")
    content = json.loads((tmp_path / "bound.json").read_text())
    content["policy"] = NAME
    (tmp_path / "bound.json").write_text(json.dumps(content))
    assert not check_bound(tmp_path / "bound.json").proven
