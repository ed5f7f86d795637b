"""The open problem is what `design` solves, takes constraints of a user's own, and fails in plain words."""

import dataclasses

import cvxpy as cp
import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.proof import consistent_reference
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.rigid_loop import RigidLoop, freeze
from fuzzyarm.proof.vertices import error_vertices
from fuzzyarm.synthesis import DesignFailed, DesignProblem, Specification, design
from fuzzyarm.synthesis.expressions import half
from fuzzyarm.synthesis.pole_region import pi

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


# As it stands --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "asked", [{}, {"gamma": None, "gain_bound": 1e5}, {"fastest_pole": 300.0, "gamma": 3e-4}], ids=str
)
def test_it_is_what_design_solves(asked):
    specification = Specification(**asked)
    problem = DesignProblem(specification)
    one, other = problem.solve(), design(specification)
    assert one.certificate.proven
    assert one.variables == other.variables and one.rows == other.rows
    assert one.controller.gamma == pytest.approx(other.controller.gamma, rel=1e-6)
    largest = np.abs(other.controller.gains).max()
    np.testing.assert_allclose(one.controller.gains, other.controller.gains, rtol=1e-3, atol=1e-3 * largest)
    controller = one.controller
    np.testing.assert_allclose(problem.P.value, controller.P, rtol=1e-9, atol=1e-12 * np.abs(controller.P).max())
    K = problem.M.value @ np.linalg.inv(controller.P)
    np.testing.assert_allclose(K, controller.gains, rtol=1e-6, atol=1e-9 * largest)
    assert problem.gamma2.value**0.5 == pytest.approx(controller.gamma, rel=1e-9)
    assert set(problem.inequalities) == {"P > 0", "Psi"} | ({"Phi"} if "fastest_pole" in asked else set())


@pytest.mark.parametrize("rules", [1, 4])
def test_the_largest_alpha_needs_a_floor_of_its_own(rules):
    """A free smallest eigenvalue of P allows a larger decay rate than one that is held; the values are its own."""
    specification = Specification(NAMED_RULES[rules], alpha=None, gain_bound=1e5)
    problem = DesignProblem(specification)
    free = problem.solve().controller
    assert problem.alpha.value == free.alpha
    np.testing.assert_allclose(problem.P.value, free.P, rtol=1e-9, atol=1e-12 * np.abs(free.P).max())
    problem.constraints.append(problem.floor == 1.0)
    problem.alpha.value = specification.first_alpha
    held = problem.solve().controller.alpha
    assert 0.9 * free.alpha < held <= free.alpha


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
    own.constraints += [own.M[:, :, joint, 1 - joint :: 2] == 0 for joint in range(2)]
    gains = own.solve().controller.gains
    assert not gains[..., 0, 1::2].any() and not gains[..., 1, 0::2].any() and gains[..., 0, 0::2].all()


def test_another_objective():
    """Any point within the bounds is not the smallest γ; α may be assigned again."""
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
    found = pi(data, 1, 0, R=np.array([[40.0]]), S=np.eye(1), theta=theta, **given)
    psi = consistent_reference.psi(data, 1, 0, alpha=20.0, gamma2=1.0, tau=list(theta[:, 0, 0]), **given)
    keep = np.delete(np.arange(len(psi)), 2 * data.n_e + np.arange(4))
    np.testing.assert_allclose(found, psi[np.ix_(keep, keep)], rtol=1e-12, atol=1e-9)


def test_a_stack_of_regions_in_cvxpy_has_the_values_of_each():
    data, (R, S), rng = error_vertices(TSModel(ARM, ("z1",)), True), sector(1.3), np.random.default_rng(4)
    given, theta = values(rng, data, 2)
    stack = {**given, **{name: cp.Constant(np.stack([given[name]] * 2)) for name in ("M", "Q", "X")}}
    half_of = pi(
        data, np.array([0, 0]), np.array([0, 1]), R=R, S=S, theta=cp.Constant(np.stack([theta] * 2)), put=half, **stack
    )
    for k in range(2):
        expected = pi(data, 0, k, R=R, S=S, theta=theta, **given)
        np.testing.assert_allclose(half_of.value[k] + half_of.value[k].T, expected, rtol=1e-9, atol=1e-9)


def test_slack_drops_out_of_the_region():
    """[I, (S⊗I)(I⊗E)⁻¹] Π [...]ᵀ = R⊗P + He(S⊗E⁻¹F), the condition of Chilali and Gahinet, for any Q and X."""
    data, (R, S) = error_vertices(TSModel(ARM, NAMED_RULES[32]), True), sector(1.3)
    given, _ = values(np.random.default_rng(1), data, 2)
    R = R + np.array([[2.0, 0.5], [0.5, -1.0]])
    matrix = pi(data, 3, 1, R=R, S=S, theta=np.zeros((0, 2, 2)), **given)
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


@pytest.mark.parametrize("iterations", [1, 20])
def test_a_point_that_misses_the_inequalities_says_by_how_much(iterations):
    problem = DesignProblem(Specification(()))
    missed = r"^SCS ended with optimal_inaccurate at a point that misses the inequalities by \d\S*, but the spec"
    with pytest.raises(DesignFailed, match=missed + "ification has a solution: try tighter tolerances") as caught:
        problem.solve(solver="SCS", max_iters=iterations)
    assert caught.value.problem is problem and caught.value.result is not None


def test_a_point_that_the_proof_refuses_says_how_far_it_is(monkeypatch):
    problem = DesignProblem(Specification(()))
    honest = problem.point

    def lie(*args, **options):
        point = honest(*args, **options)
        return dataclasses.replace(point, slack=((-point.slack[0][0], *point.slack[0][1:]),))

    monkeypatch.setattr(problem, "point", lie)
    with pytest.raises(DesignFailed, match=r"does not pass the proof: 1 of 2 .* the worst, Psi_1,1,1 < 0, ") as caught:
        problem.solve()
    assert not caught.value.result.proven
