"""The text of the theorems in cvxpy is that of the proof, its reduction is a congruence, and solutions are checked."""

import dataclasses

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import block_diag
from slow_twins import slow_but

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, VELOCITY, TSModel
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.block_matrix import symmetric
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.vertices import error_vertices, tracking_vertices
from fuzzyarm.synthesis import Specification
from fuzzyarm.synthesis import _design_problem as design_problem
from fuzzyarm.synthesis._design_problem import _MARGIN as MARGIN
from fuzzyarm.synthesis._design_problem import DesignProblem, NoPoint, structure_of
from fuzzyarm.synthesis._designer import to_controller
from fuzzyarm.synthesis._expressions import half
from fuzzyarm.synthesis.specification import PAPER_WEIGHT

ARM = ArmParameters()
GAMMA = {"consistent": 2e-4, "paper": 1000.0}
FORMS = [(form, integral, rules) for form in GAMMA for integral in (True, False) for rules in (1, 4, 8)]
every_form = pytest.mark.parametrize("which", slow_but([form for form in FORMS if form[-1] < 8], FORMS), ids=str)


def written(form, integral, rules, **others):
    asked = Specification(NAMED_RULES[rules], form, **{"gamma": GAMMA[form], "integral": integral, **others})
    return DesignProblem(asked, ARM)


@every_form
@pytest.mark.parametrize("common", [False, True])
def test_the_constraint_is_the_text_of_the_proof(which, common):
    """What cvxpy holds at random values is U Ψ Uᵀ of numbers, whose rows of ẋ_a are gone, and half of it is written."""
    pole = 900.0 if which[0] == "consistent" else None
    problem = written(*which, feedforward=None, fastest_pole=pole, common_multiplier=common)
    rng = np.random.default_rng(0)
    for variable in cp.Problem(problem.objective, problem.constraints).variables():
        value = rng.normal(size=variable.shape)
        variable.value = value + value.T if variable.attributes["symmetric"] else np.abs(value)
    for name in problem.inequalities.keys() - {"P > 0"}:
        numbers = problem._matrices(name, symmetric, design_problem._value_of)
        half_of = problem._matrices(name, half, lambda entry: entry).value
        np.testing.assert_allclose(half_of + np.swapaxes(half_of, 1, 2), numbers)
        U, F = problem._reduction(name), problem.inequalities[name].args[0].value
        expected = -(U @ numbers @ U.T) - MARGIN * np.eye(len(U))
        np.testing.assert_allclose(0.5 * (F + np.swapaxes(F, 1, 2)), expected, rtol=1e-9, atol=1e-9)


@every_form
def test_midpoints_of_the_vertices_are_the_mean_of_both_orders(which):
    """Ψ at (A_i + A_j)/2 with (M_i + M_j)/2 is (Ψ_ijk + Ψ_jik)/2, and a stack is its matrices, one by one."""
    form, integral, rules = which
    model, rng, paper = TSModel(ARM, NAMED_RULES[rules]), np.random.default_rng(1), form == "paper"
    own = tracking_vertices(model, integral, np.array(PAPER_WEIGHT)), error_vertices(model, integral)
    data, whole = own[not paper], theorems.tracking_psi if paper else theorems.error_psi
    n, N, K, m = data.n_e + 4 * paper, len(data.A), len(data.E), len(data.uncertainties)
    P, M, L = rng.normal(size=(n, n)), rng.normal(size=(N, K, 2, data.n_e)), rng.normal(size=(N, K, 2, 6))
    rows = [(pair, i, j, k) for pair, (i, j) in enumerate(data.pairs) for k in range(K)]
    Q, X, tau = rng.normal(size=(len(rows), n, n)), rng.normal(size=(len(rows), n, n)), rng.random((len(rows), m))

    def psi(vertices, a, k, gain, feedforward, row):
        free = {"L": feedforward} if paper else {}
        return whole(vertices, a, k, alpha=3.0, gamma2=0.7, P=P + P.T, M=gain, Q=Q[row], X=X[row], tau=tau[row], **free)

    pair, i, j, k = np.transpose(rows)
    stack = psi(data.midpoints(), pair, k, 0.5 * (M[i, k] + M[j, k]), 0.5 * (L[i, k] + L[j, k]), slice(None))
    for row, (_, i, j, k) in enumerate(rows):
        mean = 0.5 * (psi(data, i, k, M[j, k], L[j, k], row) + psi(data, j, k, M[i, k], L[i, k], row))
        np.testing.assert_allclose(stack[row], mean, rtol=1e-9, atol=1e-9 * np.abs(mean).max())


@every_form
def test_the_reduction_asks_for_no_more(which):
    """U Ψ Uᵀ of any Q and X is that of S_b Q_b and S_b X_b S_bᵀ, Q_b = S_bᵀ (Q + X S_a S_aᵀ) and X_b = S_bᵀ X S_b."""
    problem = written(*which)
    data, n, rng = problem._data, len(problem._scaling.state), np.random.default_rng(1)
    S_b, S_a = np.eye(n)[:, VELOCITY], np.delete(np.eye(n), VELOCITY, axis=1)
    P, (Q, X) = rng.normal(size=(n, n)), rng.normal(size=(2, n, n))
    values = {"P": P + P.T, "M": rng.normal(size=(2, data.n_e)), "tau": rng.random(len(data.uncertainties))}
    psi = theorems.error_psi
    if which[0] == "paper":
        psi, values["L"] = theorems.tracking_psi, rng.normal(size=(2, 6))
        values["P"] = block_diag(values["P"][: data.n_e, : data.n_e], values["P"][data.n_e :, data.n_e :])
    U, same = problem._reduction("Psi"), (S_b @ S_b.T @ (Q + X @ S_a @ S_a.T), S_b @ S_b.T @ X @ S_b @ S_b.T)
    reduced = [
        U @ psi(data, 0, 0, alpha=0.3, gamma2=0.8, Q=one, X=other, **values) @ U.T for one, other in ((Q, X), same)
    ]
    np.testing.assert_allclose(*reduced, rtol=1e-9, atol=1e-9 * np.abs(reduced[0]).max())


def proven(problem, point):
    """Whether every inequality of a point is proven with the full slack, pair by pair."""
    return certify(to_controller(problem.model, problem.specification, point, "a test")).proven


@pytest.mark.parametrize(
    ("which", "others"),
    [*((form, {"feedforward": None}) for form in FORMS if form[-1] < 8), (FORMS[1], {"fastest_pole": 900.0})],
    ids=str,
)
def test_a_point_solves_the_full_inequalities(which, others):
    problem = written(*which, **others)
    point = problem.point()
    np.testing.assert_array_equal(point.P, point.P.T)
    assert point.margin > 0.5 * MARGIN and proven(problem, point)
    assert point.largest_gain**2 <= point.objective * (1.0 + 1e-6)


def test_one_compiled_problem_serves_all_specifications_of_a_structure():
    """Parameters alone change: the point of a problem that was asked for others before is that of a new one."""
    first = Specification(gamma=1.7e-4, fastest_pole=170.0)
    second = dataclasses.replace(first, alpha=15.0, gamma=2.5e-4, fastest_pole=300.0)
    assert structure_of(first) == structure_of(second) != structure_of(dataclasses.replace(first, fastest_pole=None))
    problem = DesignProblem(structure_of(first), ARM)
    assert problem._problem().is_dcp(dpp=True)
    for one in (first, second, first):
        problem.ask(one)
        again, new = problem.point(), DesignProblem(one, ARM).point()
        assert (again.alpha, again.gamma) == (one.alpha, one.gamma)
        np.testing.assert_allclose(again.objective, new.objective, rtol=1e-6)
        np.testing.assert_allclose(again.M, new.M, rtol=1e-3, atol=1e-3 * np.abs(new.M).max())


def test_the_units_absorb_the_size_of_an_arm():
    """An arm of a thousand times the inertia has the same cone program, at γ a thousand times smaller."""
    names = ("mass", "inertia", "motor_inertia", "viscous_friction")
    heavy = dataclasses.replace(ARM, **{name: tuple(1e3 * x for x in getattr(ARM, name)) for name in names})
    light, heavy = (
        DesignProblem(Specification(gamma=gamma), arm)
        ._problem()
        .get_problem_data(cp.CLARABEL, canon_backend="SCIPY")[0]
        for arm, gamma in ((ARM, 2e-4), (heavy, 2e-7))
    )
    np.testing.assert_allclose(light["A"].toarray(), heavy["A"].toarray(), rtol=1e-9, atol=1e-9)
    assert np.abs(light["A"].data).max() < 20.0


def test_an_infeasible_problem_carries_its_proof():
    """The dual ray z is in the cones, Aᵀz = 0 and bᵀz < 0."""
    with pytest.raises(NoPoint, match="lower alpha, or raise gamma") as caught:
        written("consistent", True, 4, alpha=1800.0, gamma=1e-9).point()
    error, z = caught.value, caught.value.ray
    A, b, dims = (error.program[name] for name in ("A", "b", "dims"))
    assert error.status == "PrimalInfeasible" == str(error.result.status) and error.margin == -np.inf
    assert error.problem.specification.gamma == 1e-9
    assert b @ z < 0.0 and np.abs(A.T @ z).max() < 1e-5 * -(b @ z)
    nonneg, *cones, beyond = np.split(z, np.cumsum([dims.nonneg, *(order * (order + 1) // 2 for order in dims.psd)]))
    assert nonneg.min(initial=0.0) > -1e-5 * np.abs(z).max() and not beyond.size
    for order, cone in zip(dims.psd, cones, strict=True):
        column, row = np.tril_indices(order)
        Z = np.zeros((order, order))
        Z[row, column] = cone * np.where(row == column, 0.5, np.sqrt(0.5))
        assert np.linalg.eigvalsh(Z + Z.T).min() > -1e-5 * np.abs(z).max()


@pytest.mark.parametrize("x", [0.0, np.nan])
def test_a_solver_that_lies_is_not_believed(monkeypatch, x):
    """A point that breaks an inequality is none, whatever the status says."""
    honest = design_problem._where_it_ended

    def lie(result):
        told = honest(result)
        told.x = np.full(len(told.x), x)
        return told

    monkeypatch.setattr(design_problem, "_where_it_ended", lie)
    with pytest.raises(NoPoint, match="Solved and a point with margin") as caught:
        written("consistent", True, 4).point()
    assert caught.value.ray is None and not caught.value.margin > 0.0


def test_a_point_where_the_solver_stopped_early_counts_by_its_margin():
    """Too few iterations leave a point with its margin; a few more make one that is strictly feasible, not optimal."""
    problem = written("consistent", True, 4)
    with pytest.raises(NoPoint, match="MaxIterations and a point with margin -") as caught:
        problem.point(max_iter=2)
    assert np.isfinite(caught.value.margin) and caught.value.result.iterations == 2
    early, best = problem.point(max_iter=11), problem.point()
    assert early.status != "Solved" and early.margin > 0.0 and proven(problem, early)
    assert early.objective > 1.0001 * best.objective
