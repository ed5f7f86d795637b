"""Design end to end: the solver's word is never taken."""

import dataclasses

import cvxpy as cp
import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.eval.metrics import metrics
from fuzzyarm.eval.rollout import rollout
from fuzzyarm.fuzzy_policy.certificate import certify
from fuzzyarm.fuzzy_policy.inequality import error_model
from fuzzyarm.fuzzy_policy.pdc import FuzzyPolicy
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis import solve
from fuzzyarm.synthesis.consistent_reference import build
from fuzzyarm.synthesis.solve import DesignFailed, Specification, describe, design

pytestmark = pytest.mark.filterwarnings("ignore:Solution may be inaccurate:UserWarning")


@pytest.fixture(scope="module")
def designed():
    return design(Specification())


def test_the_design_passes_its_own_check(designed):
    controller, certificate = designed
    assert certificate.holds
    assert certify(controller).margins == certificate.margins
    assert (controller.alpha, controller.gamma, controller.model.rules) == (20.0, 2e-4, 4)


def test_the_shipped_controller_is_regenerated_to_the_same_performance(designed):
    """Same metrics in every case to half a percent of the tip error's scale."""
    shipped = load_policy("fuzzy-4")
    for case in ("nominal", "machining", "payload"):
        results = [
            metrics(rollout(FuzzyArmEnv(case=case), policy, policy_name="", case=case, seed=0))
            for policy in (shipped, FuzzyPolicy(designed[0]))
        ]
        for key in ("tip_error_max_mm", "tip_error_rms_mm", "joint_error_rms_mrad", "torque_peak_1", "torque_peak_2"):
            assert results[1][key] == pytest.approx(results[0][key], rel=0.01)


def test_poles_lie_left_of_the_decay_rate(designed):
    """At every vertex and every corner of the uncertainty the frozen closed loop is faster than α."""
    controller, _ = designed
    model = controller.model
    rng = np.random.default_rng(0)
    for z in rng.uniform(*model.bounds.T, size=(500, 5)):
        h, v = model.weights(z)
        gain = np.einsum("i,k,ikab->ab", h, v, controller.gains)
        A, E = np.zeros((6, 6)), np.eye(6)
        A[:4, :4], A[4:, :2], E[:4, :4] = model.A(z), np.eye(2), model.E(z)
        A[2:4] += gain
        assert np.linalg.eigvals(np.linalg.solve(E, A)).real.max() < -controller.alpha


def test_an_impossible_specification_fails_and_says_what_to_change():
    with pytest.raises(DesignFailed, match="lower alpha or raise gamma"):
        design(Specification(alpha=2000.0, gamma=1e-9))


@pytest.mark.parametrize("field", ["alpha", "gamma"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_bad_specifications_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        Specification(**{field: value})


def test_a_solver_that_lies_is_not_believed(monkeypatch):
    """A status "optimal" with a worthless point gives no controller."""

    def lie(problem, **_):
        for variable in problem.variables():
            variable.value = np.eye(*variable.shape) if len(variable.shape) == 2 else np.ones(variable.shape)

    monkeypatch.setattr(cp.Problem, "solve", lie)
    with pytest.raises(DesignFailed):
        design(Specification())


def test_a_design_for_another_arm_and_without_integral():
    arm = ArmParameters(mass=(12.0, 6.0), length=(0.4, 0.45))
    controller, certificate = design(Specification(kept=NAMED_RULES[1], integral=False), arm)
    assert certificate.holds
    assert controller.gains.shape == (1, 1, 2, 4)
    assert controller.model.parameters == arm


def test_building_solves_nothing():
    system = error_model(TSModel(ArmParameters()), True)
    problem = build(system, alpha=0.3, gamma=1.0, margin=1e-4)
    assert problem.problem.status is None
    assert problem.problem.is_dcp()
    # P >= I, three pairs times two vertices of E, four gain bounds
    assert len(problem.problem.constraints) == 1 + 3 * 2 + 4


def test_description_carries_the_claim_and_its_scope(designed):
    text = describe(*designed)
    for part in ("4 rules: kept z1, z3", "alpha = 20", "margin", "Not covered: the elastic joints"):
        assert part in text


def test_search_keeps_the_smallest_gains(designed, monkeypatch):
    """Every point of the search is at least as large as the one returned."""
    seen = []
    original = solve._solve

    def record(*arguments):
        result = original(*arguments)
        seen.append(result)
        return result

    monkeypatch.setattr(solve, "_solve", record)
    controller, _ = design(dataclasses.replace(Specification(), kept=NAMED_RULES[1]))
    bounds = {id(entry[1]): entry[0] for entry in seen if entry}
    assert bounds[id(controller)] == min(bounds.values())
