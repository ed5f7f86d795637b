"""The opponents: the quadratic program without limits is the Riccati recursion; searches begin at what is shipped."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.known_arm import without_dry_friction
from fuzzyarm.fuzzy_policy.laws.observer_gains import sampled_arm, state_part

pytestmark = pytest.mark.slow  # scripts outside of the package


def script(name):
    path = Path(__file__).parents[2] / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_program_is_the_riccati_recursion_where_no_limit_binds_and_keeps_limits_where_they_do():
    module = script("predictive")
    law = module.Predictive(JointReference(), limits=True)
    error, k = 1e-3 * np.random.default_rng(0).normal(size=module.STATES), 300
    far = np.full((module.HORIZON, 2), 1e5)
    expected = -law._K[k] @ error
    np.testing.assert_allclose(law._program(k, k + module.HORIZON, error, -far, far), expected, rtol=1e-3, atol=1e-2)
    near = far.copy()
    near[0] = 0.5 * np.abs(expected)
    bound = law._program(k, k + module.HORIZON, error, -near, near)
    np.testing.assert_allclose(bound, np.clip(expected, -near[0], near[0]), rtol=1e-3)


def test_the_linearisation_at_rest_is_the_sampled_arm_but_for_gravity():
    """A and B of the observer's gains leave gravity's slope out; with it they differ by g'(q) T² / M, below 1e-3."""
    module = script("predictive")
    q = np.array([0.3, 1.2])
    x = np.concatenate([q, q, np.zeros(4)])[np.newaxis]
    A, B = module.linearised(x, np.zeros((1, 2)), 0.0)
    physics = module.equations_of(module.ARM)
    inertia = np.array(physics.mass_matrix(physics.PerJoint(*q), module.arm_constants(module.ARM)))
    whole, push = sampled_arm(without_dry_friction(module.ARM), module.PERIOD, inertia)
    state = state_part(2)
    np.testing.assert_allclose(A[0][:4], whole[state, state][:4], atol=2e-4)
    np.testing.assert_allclose(B[0], push[state], rtol=0.02, atol=1e-7)


def test_the_search_begins_at_what_is_shipped():
    module = script("classical_on_reward")
    fuzzy, observer = module.laws()
    made = fuzzy.make(*fuzzy.shipped).law.controller
    np.testing.assert_allclose(made.gains, load_policy("fuzzy-4").controller.gains, rtol=1e-3)
    np.testing.assert_array_equal(observer.make(*observer.shipped).feedback, load_policy("elastic-observer").feedback)
    assert module.BUDGET == 24000.0
