"""The step against the event integrator over the whole 1.5 s, computed torque in the loop."""

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.periods import MAX_DEFAULT_SUBSTEP
from fuzzyarm.eval.bench._accuracy import exact_tips, max_tip_difference, stepped_tips

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["nominal", "machining", "payload"])
def case(request):
    policy = load_policy("computed-torque")
    return policy, request.param, exact_tips(policy, request.param)


def test_the_default_step_is_within_a_micrometre(case):
    policy, name, exact = case
    assert FuzzyArmEnv().substep == MAX_DEFAULT_SUBSTEP
    assert max_tip_difference(stepped_tips(policy, name, MAX_DEFAULT_SUBSTEP), exact) < 1e-6


def test_the_error_falls_with_the_square_of_the_step(case):
    """The regression of log error on log h over the coarser steps; below, the held line of the force takes over."""
    policy, name, exact = case
    steps = np.array([1e-3, 5e-4, 2.5e-4, 2e-4])
    errors = [max_tip_difference(stepped_tips(policy, name, h), exact) for h in steps]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 1.9 < order < 2.1
