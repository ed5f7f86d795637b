"""The open cvxpy model has the optima of the fast path, takes constraints of a user's own, and fails in plain words."""

import importlib
import sys

import cvxpy as cp
import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.certified.frozen import freeze
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.proof import consistent_reference
from fuzzyarm.fuzzy_policy.proof.certificate import certify
from fuzzyarm.fuzzy_policy.proof.vertices import error_vertices
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis import DesignFailed, DesignProblem, Specification, design
from fuzzyarm.synthesis.cvxpy_model.pole_region import pi
from fuzzyarm.synthesis.minimise import solve
from fuzzyarm.synthesis.search import scaled_problem

ARM = ArmParameters()
few_rules = pytest.mark.parametrize("rules", [1, 2, 4])
one_or_more_rules = pytest.mark.parametrize("rules", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 4))])


def sector(slope):
    """|Im z| < -slope Re z as R and S of a pole region."""
    return np.zeros((2, 2)), np.array([[slope, 1.0], [-1.0, slope]])


def poles(controller):
    rng = np.random.default_rng(0)
    q, dq = rng.uniform(-np.pi, np.pi, (500, 2)), rng.uniform(-15.0, 15.0, (500, 2))
    return np.linalg.eigvals(freeze(RigidLoop(controller), q, dq)[0])


def widest(controller):
    z = poles(controller)
    return (np.abs(z.imag) / -z.real).max()


# The optima of the fast path -----------------------------------------------------------------------------------------


@one_or_more_rules
def test_same_smallest_gains(rules):
    specification = Specification(NAMED_RULES[rules])
    problem = DesignProblem(specification)
    made = problem.solve()
    assert made.certificate.proven
    assert set(problem.inequalities) == {claim.name for claim in made.certificate.claims}
    _, system, asked = scaled_problem(TSModel(ARM, specification.kept), specification, 1.0)
    assert problem.objective.value == pytest.approx(solve(system, asked).objective, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("asked", [{"fastest_pole": 300.0, "gamma": 3e-4}, {"form": "paper", "gamma": 1000.0}])
def test_same_smallest_gains_with_phi_and_with_theorem_2(asked):
    specification = Specification(NAMED_RULES[4], **asked)
    problem = DesignProblem(specification)
    assert problem.solve().certificate.proven
    _, system, scaled = scaled_problem(TSModel(ARM, specification.kept), specification, 1.0)
    assert problem.objective.value == pytest.approx(solve(system, scaled).objective, rel=2e-3)


@pytest.mark.slow
@few_rules
def test_same_smallest_gamma(rules):
    """The fast path searches for the scale of P; here the floor of P is a variable."""
    specification = Specification(NAMED_RULES[rules], gamma=None, gain_bound=1e5)
    found = DesignProblem(specification).solve().controller.gamma
    assert found == pytest.approx(design(specification).controller.gamma, rel=5e-3)


@pytest.mark.slow
@few_rules
def test_same_largest_alpha(rules):
    """With the floor of the fast path; a free floor allows a larger one."""
    specification = Specification(NAMED_RULES[rules], alpha=None, gain_bound=1e5)
    expected = design(specification).controller.alpha
    problem = DesignProblem(specification)
    free = problem.solve().controller.alpha
    assert free >= 0.99 * expected
    problem.constraints.append(problem.floor == 1.0)
    problem.alpha.value = specification.first_alpha
    assert problem.solve().controller.alpha == pytest.approx(expected, rel=0.02)


# A user's own --------------------------------------------------------------------------------------------------------


def test_own_constraints_hold_and_the_controller_is_proven_from_its_file(tmp_path):
    """A sector and a bound of a gain that the plain design does not meet."""
    problem = DesignProblem(Specification(()))
    plain = problem.solve().controller
    assert widest(plain) > 1.8 and plain.origin["objective"] == "smallest bound on the scaled gains"
    problem.constraints += problem.pole_region(*sector(1.8)) + problem.gain_bound(1, 3, 520.0)
    made = problem.solve()
    assert widest(made.controller) < 1.8
    assert np.abs(made.controller.gains[..., 1, 3]).max() < 520.0
    made.controller.save(tmp_path / "own.json")
    again = Controller.load(tmp_path / "own.json")
    assert certify(again).proven and again.origin["objective"] == "a user's own problem"


@pytest.mark.slow
def test_a_bounded_gain_is_below_its_bound_and_a_sparsity_is_exact():
    specification = Specification(NAMED_RULES[4], gain_bound=2e5)
    problem = DesignProblem(specification)
    free = np.abs(problem.solve().controller.gains[..., 0, 0]).max()
    problem.constraints += problem.gain_bound(0, 0, 0.7 * free)
    assert np.abs(problem.solve().controller.gains[..., 0, 0]).max() <= 0.7 * free * (1.0 + 1e-6)
    own = DesignProblem(specification)
    own.constraints.append(own.P[0::2, 1::2] == 0)
    own.constraints += [M[joint : joint + 1, 1 - joint :: 2] == 0 for M in own.M.values() for joint in range(2)]
    gains = own.solve().controller.gains
    assert not gains[..., 0, 1::2].any() and not gains[..., 1, 0::2].any() and gains[..., 0, 0::2].all()


def test_another_objective():
    """Any point within the bounds is not the smallest γ; α may be assigned anew."""
    problem = DesignProblem(Specification((), gamma=None, gain_bound=2e5))
    smallest = problem.solve().controller.gamma
    problem.objective = cp.Minimize(0)
    problem.alpha.value = 5.0
    made = problem.solve().controller
    assert made.gamma > 1.01 * smallest and made.alpha == 5.0


# The pole region -----------------------------------------------------------------------------------------------------


def values(rng, data, size):
    n, root = data.n_e, rng.normal(size=(data.n_e, data.n_e))
    given = {"P": root @ root.T, "M": rng.normal(size=(2, n))}
    given |= {name: rng.normal(size=(size * n, size * n)) for name in ("Q", "X")}
    half = rng.normal(size=(len(data.uncertainties), size, size))
    return given, half + np.swapaxes(half, 1, 2)


@pytest.mark.parametrize("integral", [False, True])
def test_half_plane_is_the_inequality_of_the_decay_rate(integral):
    data = error_vertices(TSModel(ARM, ("z3",)), integral)
    given, theta = values(np.random.default_rng(0), data, 1)
    found = pi(data, 1, 0, R=np.array([[40.0]]), S=np.eye(1), theta=list(theta), **given).value
    psi = consistent_reference.psi(data, 1, 0, alpha=20.0, gamma2=1.0, tau=list(theta[:, 0, 0]), **given)
    keep = np.delete(np.arange(len(psi)), 2 * data.n_e + np.arange(4))
    np.testing.assert_allclose(found, psi[np.ix_(keep, keep)], rtol=1e-12, atol=1e-9)


def test_slack_drops_out_of_the_region():
    """[I, (S⊗I)(I⊗E)⁻¹] Π [...]ᵀ = R⊗P + He(S⊗E⁻¹F), the condition of Chilali and Gahinet, for any Q and X."""
    data, (R, S) = error_vertices(TSModel(ARM, NAMED_RULES[32]), True), sector(1.3)
    given, _ = values(np.random.default_rng(1), data, 2)
    R = R + np.array([[2.0, 0.5], [0.5, -1.0]])
    matrix = pi(data, 3, 1, R=R, S=S, theta=[], **given).value
    E, F = data.error_E(1), data.error_A(3) @ given["P"] + data.error_rows(data.B) @ given["M"]
    left = np.hstack([np.eye(12), np.kron(S, np.eye(6)) @ np.kron(np.eye(2), np.linalg.inv(E))])
    half = np.kron(S, np.linalg.solve(E, F))
    np.testing.assert_allclose(left @ matrix @ left.T, np.kron(R, given["P"]) + half + half.T, rtol=1e-9, atol=1e-7)


def test_a_region_that_makes_no_sense_is_refused():
    problem = DesignProblem(Specification(()))
    with pytest.raises(ValueError, match=r"R has shape \(1,\); allowed: \(2, 2\)"):
        problem.pole_region([1.0], np.eye(2))
    with pytest.raises(ValueError, match="symmetric R"):
        problem.pole_region([[0.0, 1.0], [0.0, 0.0]], np.eye(2))
    with pytest.raises(ValueError, match="consistent form"):
        DesignProblem(Specification((), "paper", gamma=1000.0)).pole_region(*sector(1.0))
    with pytest.raises(ValueError, match="state = 6"):
        problem.gain_bound(0, 6, 1.0)
    with pytest.raises(ValueError, match="bound = 0"):
        problem.gain_bound(0, 0, 0.0)


# What fails ----------------------------------------------------------------------------------------------------------


def test_a_solver_that_is_not_installed():
    with pytest.raises(ValueError, match=r"solver = 'NOSUCH' is not installed; installed: CLARABEL, .*SCS"):
        DesignProblem(Specification(())).solve(solver="NOSUCH")


def test_a_solver_for_other_problems():
    with pytest.raises(DesignFailed, match=r"^HIGHS found no point: The solver HIGHS cannot solve this problem, but"):
        DesignProblem(Specification(())).solve(solver="HIGHS")


@pytest.mark.slow
def test_an_infeasible_specification_says_what_would_have_to_give():
    with pytest.raises(DesignFailed, match="alpha would have to give: the largest that works is about"):
        DesignProblem(Specification((), alpha=400.0, gain_bound=1e5)).solve()


def test_own_constraints_that_cannot_be_met_are_told_from_the_specification():
    problem = DesignProblem(Specification(()))
    problem.constraints += [problem.P[0, 0] <= 0.0]
    with pytest.raises(DesignFailed, match="the specification alone has a solution, so relax the 1 constraints added"):
        problem.solve()


@pytest.mark.parametrize(
    ("iterations", "far"), [(1, "has a diagonal entry of the wrong sign"), (20, r"fails by 0\.\d+ ")]
)
def test_a_point_that_the_proof_refuses_says_how_far_it_is(iterations, far):
    message = rf"\(SCS: optimal_inaccurate\) does not pass the proof: 1 of 2 .* the worst, Psi_1,1,1 < 0, {far}"
    with pytest.raises(DesignFailed, match=message):
        DesignProblem(Specification(())).solve(solver="SCS", max_iters=iterations)


def test_without_cvxpy_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    monkeypatch.delitem(sys.modules, "fuzzyarm.synthesis.cvxpy_model.inequalities")
    with pytest.raises(ModuleNotFoundError, match=r'pip install "fuzzyarm\[cvxpy\]"'):
        importlib.import_module("fuzzyarm.synthesis.cvxpy_model.inequalities")
