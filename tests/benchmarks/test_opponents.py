"""The opponents: the quadratic program without limits is the Riccati recursion; searches begin at what is shipped."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.dynamics import arm_constants, frictionless
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import State, filled, flat
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.known_arm import travel_of, without_dry_friction
from fuzzyarm.fuzzy_policy.laws.observer_gains import sampled_arm, state_part
from fuzzyarm.rl_baselines.algorithms import find_algorithm

pytestmark = pytest.mark.slow  # scripts outside of the package


def script(name):
    """A script, which imports its neighbours."""
    folder = str(Path(__file__).parents[2] / "benchmarks")
    sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(folder)


@pytest.fixture(scope="module")
def plans():
    return script("predictive_plan")


def plan_from(plans, model, t):
    return plans.plan_of(JointReference(), t, model, 0.0218, 1.57)


def test_the_program_is_the_riccati_recursion_where_no_limit_binds_and_keeps_limits_where_they_do(plans):
    begin, n = 0.3, plans.HORIZON
    plan = plan_from(plans, plans.Model.of(0.0), begin + plans.PERIOD * np.arange(n))
    error, optimum = 1e-3 * np.random.default_rng(0).normal(size=plans.STATES), plans.Optimum(limits=True)
    far = np.full((n, 2), 1e5)
    expected = -plan.K[0] @ error
    np.testing.assert_allclose(optimum.program(plan, 0, n, error, -far, far), expected, rtol=1e-3, atol=1e-2)
    near = far.copy()
    near[0] = 0.5 * np.abs(expected)
    bound = optimum.program(plan, 0, n, error, -near, near)
    np.testing.assert_allclose(bound, np.clip(expected, -near[0], near[0]), rtol=1e-3)


def test_the_linearisation_at_rest_is_the_sampled_arm_but_for_gravity(plans):
    """A and B of the observer's gains leave gravity's slope out; with it they differ by g'(q) T² / M, below 1e-3."""
    q, arm = np.array([0.3, 1.2]), arm_constants(plans.ARM)
    x = np.concatenate([q, q, np.zeros(4)])[np.newaxis]
    A, B = plans.linearised(x, np.zeros((1, 2)), arm, np.zeros((1, 2)))
    physics = equations_of(plans.ARM)
    inertia = np.array(physics.mass_matrix(physics.PerJoint(*q), arm))
    whole, push = sampled_arm(without_dry_friction(plans.ARM), plans.PERIOD, inertia)
    state = state_part(2)
    np.testing.assert_allclose(A[0][:4], whole[state, state][:4], atol=2e-4)
    np.testing.assert_allclose(B[0], push[state], rtol=0.02, atol=1e-7)


def test_the_planned_motion_solves_the_equations_of_the_loaded_arm(plans):
    """A sample of the arm without dry friction, from x_d under u_ff less that friction, ends at the next x_d."""
    t = 0.4 + plans.PERIOD * np.arange(2)
    loaded = plans.Model.of(5.0)
    smooth = frictionless(loaded.arm)
    force = np.array([3.0, -2.0])
    x, u, _ = plans.motion(JointReference(), t, plans.Model(smooth, 40.0, force))
    push = 40.0 * travel_of(plans.ARM, x[:, 2:4], x[:, 6:8]) + force
    physics = equations_of(plans.ARM)
    start = filled(State, x[0])
    line = [*push.mean(axis=0), *(push[1] - push[0])]
    end = held_of(physics)(start, physics.PerJoint(*u[0]), line[:2], line[2:], smooth, plans.PERIOD / 50, 50)
    np.testing.assert_allclose(flat(end)[:4], x[1, :4], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(flat(end)[4:], x[1, 4:], rtol=0.0, atol=1e-4)


def test_the_search_begins_at_what_is_shipped():
    module = script("classical_on_reward")
    fuzzy, observer = module.laws()
    made = fuzzy.make(*fuzzy.shipped).law.controller
    np.testing.assert_allclose(made.gains, load_policy("fuzzy-4").controller.gains, rtol=1e-3)
    np.testing.assert_array_equal(observer.make(*observer.shipped).feedback, load_policy("elastic-observer").feedback)
    assert max(one.total_timesteps * one.action_period for one in trainings()) <= module.BUDGET


def trainings():
    """The settings of the learned policies that are compared there."""
    presets = find_algorithm("ppo").presets
    return presets["robust"], presets["residual"]


def test_a_search_is_not_repeated_with_the_same_budget_alone(tmp_path):
    module, path = script("classical_on_reward"), tmp_path / "result.json"
    assert module.searches_of(None, 1.0) == module.searches_of(path, 1.0) == {}
    path.write_text(json.dumps({"budget_s": 1.0, "commit": "c", "searches": {"law": {"tries": 3}}}))
    assert module.searches_of(path, 1.0) == {"law": {"commit": "c", "tries": 3}}
    assert module.searches_of(path, 2.0) == {}
