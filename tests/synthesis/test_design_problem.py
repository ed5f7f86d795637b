"""The open problem is what `design` solves, takes constraints of a user's own, and fails in plain words."""

import cvxpy as cp
import numpy as np
import pytest
from support.rigid_loop import RigidLoop

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.vertices import error_vertices
from fuzzyarm.synthesis import DesignFailed, DesignProblem, Specification, design
from fuzzyarm.synthesis._design_problem import pi

ARM = ArmParameters()


def sector(slope):
    """|Im z| < -slope Re z as R and S of a pole region."""
    return np.zeros((2, 2)), np.array([[slope, 1.0], [-1.0, slope]])


def widest(controller):
    q, dq = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 500, 2))
    z = np.linalg.eigvals(RigidLoop(controller).frozen(np.pi * q, 15.0 * dq)[0])
    return (np.abs(z.imag) / -z.real).max()


@pytest.mark.parametrize(
    "asked", [{}, {"gamma": None, "gain_bound": 1e5}, {"fastest_pole": 300.0, "gamma": 3e-4}], ids=str
)
def test_it_is_what_design_solves(asked):
    specification = Specification(**asked)
    problem = DesignProblem(specification)
    one, other = problem.solve(), design(specification)
    assert one.certificate.proven and (one.variables, one.rows) == (other.variables, other.rows)
    controller, gains = one.controller, other.controller.gains
    assert controller.gamma == pytest.approx(other.controller.gamma, rel=1e-6)
    largest = np.abs(gains).max()
    np.testing.assert_allclose(controller.gains, gains, rtol=1e-3, atol=1e-3 * largest)
    np.testing.assert_allclose(problem.P.value, controller.P, rtol=1e-9, atol=1e-12 * np.abs(controller.P).max())
    K = problem.M.value @ np.linalg.inv(controller.P)
    np.testing.assert_allclose(K, controller.gains, rtol=1e-6, atol=1e-9 * largest)
    assert problem.gamma2.value**0.5 == pytest.approx(controller.gamma, rel=1e-9)
    assert set(problem.inequalities) == {"P > 0", "Psi"} | ({"Phi"} if "fastest_pole" in asked else set())


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


def test_another_objective():
    """Any point within the bounds is not the smallest γ; α may be assigned again, and a sparsity is exact."""
    problem = DesignProblem(Specification((), gamma=None, gain_bound=2e5))
    smallest = problem.solve().controller.gamma
    problem.objective = cp.Minimize(0)
    problem.alpha.value = 5.0
    problem.constraints.append(problem.P[0::2, 1::2] == 0)
    problem.constraints += [problem.M[:, :, joint, 1 - joint :: 2] == 0 for joint in range(2)]
    made = problem.solve().controller
    assert made.gamma > 1.01 * smallest and made.alpha == 5.0
    assert not made.gains[..., 0, 1::2].any() and not made.gains[..., 1, 0::2].any() and made.gains[..., 0, 0::2].all()


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
    psi = theorems.error_psi(data, 1, 0, alpha=20.0, gamma2=1.0, tau=theta[:, 0, 0], **given)
    keep = np.delete(np.arange(len(psi)), 2 * data.n_e + np.arange(4))
    np.testing.assert_allclose(found, psi[np.ix_(keep, keep)], rtol=1e-12, atol=1e-9)


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


def test_what_makes_no_sense_is_refused():
    problem, impossible = DesignProblem(Specification(())), DesignProblem(Specification(()))
    paper = DesignProblem(Specification((), "paper", gamma=1000.0))
    impossible.constraints += [impossible.P[0, 0] <= 0.0]
    for call, message in (
        (lambda: problem.pole_region([1.0], np.eye(2)), r"R has shape \(1,\); allowed: \(2, 2\)"),
        (lambda: problem.pole_region([[0.0, 1.0], [0.0, 0.0]], np.eye(2)), "symmetric matrix R"),
        (lambda: paper.pole_region(*sector(1.0)), "form .consistent."),
        (lambda: problem.gain_bound(0, 6, 1.0), "state = 6"),
        (lambda: problem.gain_bound(0, 0, 0.0), "bound = 0"),
        (lambda: problem.solve(solver="NOSUCH"), r"solver = 'NOSUCH' is not installed; installed: CLARABEL, .*SCS"),
        (lambda: problem.solve(solver="HIGHS"), r"^HIGHS found no feasible point \(The solver HIGHS cannot solve this"),
        (impossible.solve, r"the specification alone has a solution: relax the added constraints \(1\)"),
    ):
        with pytest.raises((ValueError, DesignFailed), match=message):
            call()


@pytest.mark.parametrize("iterations", [1, 20])
def test_a_point_that_misses_the_inequalities_says_by_how_much(iterations):
    problem = DesignProblem(Specification(()))
    missed = r"optimal_inaccurate; its last point misses the inequalities by \d\S*\); the spec"
    with pytest.raises(DesignFailed, match=missed + "ification alone has a solution: try tighter tolerances") as caught:
        problem.solve(solver="SCS", max_iters=iterations)
    assert caught.value.problem is problem and caught.value.result is not None
