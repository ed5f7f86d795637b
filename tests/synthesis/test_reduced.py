"""The reduced inequality is equivalent to the full one, the cone program states it, and solutions are checked."""

import dataclasses
import itertools
import types

import cvxpy as cp
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis import minimise
from fuzzyarm.synthesis.conic import Problem, program, svec
from fuzzyarm.synthesis.error_model import consistent_form, paper_form, reversed_time
from fuzzyarm.synthesis.minimise import Infeasible, solve, solve_for_largest_alpha
from fuzzyarm.synthesis.reduced import ReducedModel, Variables, blended, expand, inequality
from fuzzyarm.synthesis.scaling import Scaling

ARM = ArmParameters()
GAMMA = {"consistent": 2e-4, "paper": 1000.0}
FORMS = [(form, integral, rules) for form in GAMMA for integral in (True, False) for rules in (1, 4, 8)]
# With 8 rules there are more of the same blocks.
MOST_FORMS = [pytest.param(*form, marks=pytest.mark.slow) if form[-1] == 8 else form for form in FORMS]


def scaled(form, integral, rules):
    """Return the scaled error model and the problem: α = 20 1/s, smallest gains."""
    model = TSModel(ARM, NAMED_RULES[rules])
    if form == "consistent":
        system = consistent_form(model, integral)
        unit = Scaling.of(system, ARM, 1.0)
        lyapunov = 0.37 * unit.time / (GAMMA[form] * unit.torque.mean()) ** 2
    else:
        weight = np.array([1e-5, 1e-5, 1.0, 1.0])
        system, lyapunov = paper_form(model, integral, weight, common_multiplier=False), 1e-4
    scaling = Scaling.of(system, ARM, lyapunov)
    return scaling.apply(system), Problem(alpha=20.0 / scaling.time, gamma=GAMMA[form])


def full(system, i, k, alpha, gamma2, P, M, L, Q, X, tau, block=np.block):
    """Return the full Ψ_ijk, for arrays or, with block=cp.bmat, for cvxpy expressions."""
    n, n_w, n_e = len(system.B), system.D[0].shape[1], system.blocks[0]
    zeros = np.zeros
    BM = system.B @ (M if n_e == n else block([[M, zeros((2, n - n_e))]]))
    D = system.D[k] + (0.0 if not len(system.feedforward) else system.B @ block([[zeros((2, 2)), L]]))
    blocks = system.uncertainties
    corner = -(system.E[k] @ X + X.T @ system.E[k].T)
    for t, u in zip(tau, blocks, strict=True):
        corner = corner + t * (u.H.T @ u.H)
    n_z = len(system.C)
    coupling, z = system.A[i][k] @ P + BM - system.E[k] @ Q + X.T, system.C @ P if n_z else zeros((0, n))
    below = [[u.Wx @ P - u.Wd @ Q, -u.Wd @ X, u.Ww, zeros((len(u.H), n_z))] for u in blocks]
    rows = [
        [Q + Q.T + 2.0 * alpha * P, coupling.T, zeros((n, n_w)), z.T, *(row[0].T for row in below)],
        [coupling, corner, D, zeros((n, n_z)), *(row[1].T for row in below)],
        [zeros((n_w, n)), D.T, -gamma2 * system.disturbance_weight, zeros((n_w, n_z)), *(row[2].T for row in below)],
        [z, zeros((n_z, n)), zeros((n_z, n_w)), -np.eye(n_z), *(row[3].T for row in below)],
    ]
    for a, row in enumerate(below):
        diagonal = [
            -tau[a] * np.eye(len(u.H)) if a == b else zeros((len(row[2]), len(u.H))) for b, u in enumerate(blocks)
        ]
        rows.append([*row, *diagonal])
    there = [index for index, row in enumerate(rows) if row[0].shape[0]]  # run backwards there is no w and no z
    return block([[rows[a][b] for b in there] for a in there])


def random_point(model, seed=0):
    """Return random decision variables of a whole design, and the decision vector they come from."""
    layout = program(model, Problem(alpha=0.3, gamma=1.0)).layout
    x = np.random.default_rng(seed).normal(size=layout.g + 1)
    return layout.at(x), x


@pytest.mark.parametrize(("form", "integral", "rules"), MOST_FORMS)
def test_reduction_is_a_congruence(form, integral, rules):
    """For any Q and X the full Ψ with the a-rows of ẋ added to x and dropped is the reduced inequality."""
    system, _ = scaled(form, integral, rules)
    model, n = ReducedModel.of(system), len(system.B)
    v, _ = random_point(model)
    i, k, rng = len(system.A) - 1, len(system.E) - 1, np.random.default_rng(1)
    Q, X = rng.normal(size=(2, n, n))
    tau = v.tau[0, k]
    psi = full(system, i, k, 0.3, v.gamma2 / model.weight_norm, v.P, v.M[i, k], v.L[i, k], Q, X, tau)
    T = np.eye(len(psi))
    T[n : 2 * n, :n] = model.S_a @ model.S_a.T
    keep = np.delete(np.arange(len(psi)), n + np.flatnonzero(model.S_a.any(axis=1)))
    one = dataclasses.replace(
        v,
        M=v.M[i, k],
        L=v.L[i, k],
        tau=tau,
        Q=model.S_b.T @ (Q + X @ model.S_a @ model.S_a.T),
        X=model.S_b.T @ X @ model.S_b,
    )
    np.testing.assert_allclose((T.T @ psi @ T)[np.ix_(keep, keep)], inequality(model, i, k, 0.3, one), atol=1e-9)


@pytest.mark.parametrize(("form", "integral", "rules"), MOST_FORMS)
def test_expansion_undoes_the_reduction(form, integral, rules):
    """The expanded Q and X reduce to the Q_b and X_b they came from, and the a-rows of ẋ meet only w."""
    model = ReducedModel.of(scaled(form, integral, rules)[0])
    v, _ = random_point(model)
    rng = np.random.default_rng(2)
    half = rng.normal(size=blended(model, 0.3, v).shape)
    R = -half @ np.swapaxes(half, -1, -2)
    Q, X = expand(model, v, R)
    S_a, S_b = model.S_a, model.S_b
    np.testing.assert_allclose(S_b.T @ (Q + X @ S_a @ S_a.T), v.Q, atol=1e-9)
    np.testing.assert_allclose(S_b.T @ X @ S_b, v.X, atol=1e-12)
    a_rows = model.N @ v.P - S_a.T @ Q + S_a.T @ np.swapaxes(X, -1, -2) - 2.0 * S_a.T @ X @ S_a @ S_a.T
    np.testing.assert_allclose(a_rows, 0.0, atol=1e-9 * np.abs(X).max())
    # What the a-rows cost leaves R negative.
    w = slice(len(S_b) + 2, len(S_b) + 2 + model.D_a.shape[1])
    R[..., w, w] += model.D_a.T @ model.D_a / (2.0 * X[:, :1, :1, np.newaxis])
    assert np.linalg.eigvalsh(R).max() < 0.0


@pytest.mark.parametrize(("form", "integral", "rules"), [*FORMS, ("consistent", True, 32)])
def test_cone_program_is_the_inequalities(form, integral, rules):
    """b - A x is -(R + μI), cone after cone, then P11 - floor I and the bounds of the gains."""
    system, problem = scaled(form, integral, rules)
    model = ReducedModel.of(system)
    cone = program(model, problem)
    v, x = random_point(model, seed=3)
    given = dataclasses.replace(v, gamma2=np.array(problem.gamma**2 * model.weight_norm))
    R = blended(model, problem.alpha, given)
    P11 = v.P[: system.blocks[0], : system.blocks[0]]
    bounds = [np.block([[v.g * np.eye(2), M], [M.T, P11]]) for per_k in v.M for M in per_k]
    # A large γ² weight is brought down to one by a congruence of the rows w, a small one is left alone.
    unit, w = np.ones(R.shape[-1]), np.arange(len(model.S_b) + 2, len(model.S_b) + 2 + system.D[0].shape[1])
    unit[w] = 1.0 / np.sqrt(np.maximum(problem.gamma**2 * np.diag(system.disturbance_weight), 1.0))
    S = -R * np.outer(unit, unit) - problem.margin * np.eye(R.shape[-1])
    expected = [svec(S).ravel(), svec(P11 - np.eye(len(P11)))]
    expected += [svec(bound) for bound in bounds]
    np.testing.assert_allclose(cone.b - cone.A @ x[cone.free], np.concatenate(expected), rtol=1e-9, atol=1e-7)
    assert sum(order * (order + 1) // 2 for order in cone.orders) == len(cone.b)
    if rules == 32:
        assert len(cone.q) == 2582


def test_blended_inequality_is_the_mean_of_both_orders():
    """(R_ijk + R_jik)/2, pair by pair: R_ijk has the vertex A_ik and the gains M_jk, L_jk."""
    system, problem = scaled("paper", True, 8)
    model = ReducedModel.of(system)
    v, _ = random_point(model)
    R = blended(model, problem.alpha, v)
    for (p, (i, j)), k in itertools.product(enumerate(system.pairs), range(len(system.E))):
        one = dataclasses.replace(v, M=v.M[j, k], L=v.L[j, k], Q=v.Q[p], X=v.X[p], tau=v.tau[p, k])
        other = dataclasses.replace(one, M=v.M[i, k], L=v.L[i, k])
        mean = 0.5 * (inequality(model, i, k, problem.alpha, one) + inequality(model, j, k, problem.alpha, other))
        np.testing.assert_allclose(R[p, k], mean, atol=1e-10)


def test_svec_keeps_inner_products():
    A, B = np.random.default_rng(0).normal(size=(2, 5, 5))
    A, B = A + A.T, B + B.T
    assert svec(A) @ svec(B) == pytest.approx(np.trace(A @ B))
    # Upper triangle by columns, as Clarabel wants it.
    assert svec(np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])).tolist() == [1, 0, 2, 0, 0, 3]


@pytest.mark.parametrize(
    ("form", "integral", "rules"),
    MOST_FORMS,
)
def test_solution_is_a_point_of_the_full_inequality(form, integral, rules):
    system, problem = scaled(form, integral, rules)
    found = solve(system, problem)
    assert found.margin > 0.5 * problem.margin
    np.testing.assert_array_equal(found.P, found.P.T)
    assert found.largest_gain**2 <= found.objective * (1.0 + 1e-6)
    for (p, (i, j)), k in itertools.product(enumerate(system.pairs), range(len(system.E))):
        shared = {"P": found.P, "Q": found.Q[p], "X": found.X[p], "tau": found.tau[p, k]}
        psi = sum(
            full(system, a, k, problem.alpha, problem.gamma**2, M=found.M[b, k], L=found.L[b, k], **shared)
            for a, b in ((i, j), (j, i))
        )
        unit = 1.0 / np.sqrt(np.abs(np.diag(psi)))
        assert np.linalg.eigvalsh(psi * unit * unit[:, np.newaxis]).max() < -1e-9


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")  # the peer's, with some processors' LAPACK
@pytest.mark.parametrize("rules", slow_but([1, 2], [1, 2, 4]))
def test_same_optimum_as_the_full_inequality(rules):
    """Plain cvxpy on the full Ψ, all slack kept, finds the same smallest gains."""
    system, problem = scaled("consistent", True, rules)
    problem = dataclasses.replace(problem, margin=1e-6)
    n, pairs, K = len(system.B), system.pairs, range(len(system.E))
    P, g = cp.Variable((n, n), symmetric=True), cp.Variable()
    M = {(j, k): cp.Variable((2, n)) for j in range(len(system.A)) for k in K}
    constraints = [np.eye(n) << P, *(cp.bmat([[g * np.eye(2), m], [m.T, P]]) >> 0 for m in M.values())]
    for i, j in pairs:
        Q, X = cp.Variable((n, n)), cp.Variable((n, n))
        for k in K:
            tau = cp.Variable(max(len(system.uncertainties), 1))[: len(system.uncertainties)]
            gamma2 = problem.gamma**2
            both = [
                full(system, a, k, problem.alpha, gamma2, P, M[b, k], None, Q, X, list(tau), cp.bmat)
                for a, b in ((i, j), (j, i))
            ]
            constraints.append(0.5 * (both[0] + both[1]) << -problem.margin * np.eye(both[0].shape[0]))
    reference = cp.Problem(cp.Minimize(g), constraints)
    reference.solve(solver=cp.CLARABEL)
    assert solve(system, problem).objective == pytest.approx(reference.value, rel=2e-3)


@pytest.mark.slow
def test_objectives_agree_with_each_other():
    """Smallest γ at the smallest gain of γ is γ; so is the largest α; a bound of M bounds K."""
    system, problem = scaled("consistent", True, 4)
    found = solve(system, problem)
    gain = found.objective**0.5
    back = solve(system, Problem(alpha=problem.alpha, gain_bound=gain, minimise="gamma"))
    assert back.gamma == pytest.approx(problem.gamma, rel=1e-3)
    quick = solve_for_largest_alpha(
        system, dataclasses.replace(problem, alpha=0.1, gain_bound=gain, minimise="nothing"), resolution=0.01
    )
    assert quick.problem.alpha == pytest.approx(problem.alpha, rel=0.015)
    assert quick.largest_gain <= gain * (1.0 + 1e-6)
    # P and M doubled keep K: with floor 2 the variable g doubles, the bound that it means is about the same.
    doubled = dataclasses.replace(problem, floor=2.0, gain_bound=1.2 * gain, minimise="nothing")
    assert solve(system, doubled).largest_gain <= 1.2 * gain
    smallest = solve(system, dataclasses.replace(problem, floor=2.0)).objective / 2.0
    with pytest.raises(Infeasible):
        solve(system, dataclasses.replace(doubled, gain_bound=0.97 * smallest**0.5))
    assert solve(system, dataclasses.replace(doubled, gain_bound=1.03 * smallest**0.5)).margin > 0.0
    remark3 = solve(system, dataclasses.replace(problem, bound="M", floor=2.0))
    assert np.linalg.norm(remark3.M, ord=2, axis=(-2, -1)).max() == pytest.approx(remark3.objective, rel=1e-3)
    assert np.linalg.eigvalsh(remark3.P).min() > 2.0 * (1.0 - 1e-4)
    assert remark3.largest_gain <= remark3.objective / 2.0 * (1.0 + 1e-4)
    given = solve(
        system,
        dataclasses.replace(problem, bound="M", gain_bound=1.1 * remark3.objective, floor=2.0, minimise="nothing"),
    )
    assert np.linalg.norm(given.M, ord=2, axis=(-2, -1)).max() <= 1.1 * remark3.objective * (1.0 + 1e-4)


def test_infeasible_problem_carries_its_proof():
    """The dual ray z is in the cones, Aᵀz = 0 and bᵀz < 0."""
    system, problem = scaled("consistent", True, 4)
    with pytest.raises(Infeasible, match="lower alpha") as caught:
        solve(system, dataclasses.replace(problem, alpha=30.0, gamma=1e-9))
    cone, z = caught.value.program, caught.value.ray
    assert caught.value.status == "PrimalInfeasible"
    assert cone.b @ z < 0.0
    assert np.abs(cone.A.T @ z).max() < 1e-5 * -(cone.b @ z)
    start = 0
    for order in cone.orders:
        column, row = np.tril_indices(order)
        triangle = z[start : start + len(row)] * np.where(row == column, 0.5, np.sqrt(0.5))
        Z = np.zeros((order, order))
        Z[row, column] = triangle
        assert np.linalg.eigvalsh(Z + Z.T).min() > -1e-5 * np.abs(z).max()
        start += len(row)


@pytest.mark.parametrize("x", [0.0, np.nan])
def test_a_solver_that_lies_is_not_believed(monkeypatch, x):
    def lie(cone, tolerance):
        return types.SimpleNamespace(status="Solved", x=np.full(len(cone.q), x), obj_val=0.0, iterations=1)

    monkeypatch.setattr(minimise, "_clarabel", lie)
    with pytest.raises(Infeasible, match="Solved") as caught:
        solve(*scaled("consistent", True, 4))
    assert caught.value.ray is None and not caught.value.margin > 0.0


def test_problems_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="gamma is missing"):
        Problem(alpha=0.3)
    with pytest.raises(ValueError, match="given and minimised"):
        Problem(alpha=0.3, gamma=1.0, gain_bound=1.0)
    with pytest.raises(ValueError, match="out of range"):
        Problem(alpha=0.3, gamma=np.inf)
    with pytest.raises(ValueError, match="floor"):
        Problem(alpha=0.3, gamma=1.0, floor=0.0)
    system, problem = scaled("consistent", True, 1)
    with pytest.raises(ValueError, match="gain_bound is missing"):
        solve_for_largest_alpha(system, dataclasses.replace(problem, minimise="nothing"))


def test_a_model_of_another_structure_is_refused():
    system, _ = scaled("consistent", True, 4)
    with pytest.raises(ValueError, match="rows other than those of q̇"):
        ReducedModel.of(dataclasses.replace(system, E=[1.1 * E for E in system.E]))


def test_places_outside_the_blocks_of_P_are_zero():
    model = ReducedModel.of(scaled("paper", True, 4)[0])
    P = random_point(model)[0].P
    np.testing.assert_array_equal(P[:6, 6:], 0.0)
    assert isinstance(program(model, Problem(alpha=0.3, gamma=1.0)).layout, Variables)


# The fastest pole: the same for the motion run backwards -------------------------------------------------------------

BACKWARDS = [form[1:] for form in FORMS if form[0] == "consistent"]
BACKWARDS = [pytest.param(*form, marks=pytest.mark.slow) if form[-1] == 8 else form for form in BACKWARDS]


@pytest.mark.parametrize(("integral", "rules"), BACKWARDS)
def test_reduction_of_the_reversed_motion_is_a_congruence(integral, rules):
    """There is no w: S_a is added to the rows of x, and with an expanded Q the a-rows of ẋ meet nothing."""
    system = reversed_time(scaled("consistent", integral, rules)[0])
    model, n = ReducedModel.of(system), len(system.B)
    v, _ = random_point(model)
    i, k, p = len(system.A) - 1, len(system.E) - 1, 0
    half = np.random.default_rng(2).normal(size=blended(model, -2.0, v).shape)
    Q, X = (array[p] for array in expand(model, v, -half @ np.swapaxes(half, -1, -2)))
    psi = full(system, i, k, -2.0, 0.0, v.P, v.M[i, k], v.L[i, k], Q, X, v.tau[p, k])
    T, a_rows = np.eye(len(psi)), n + np.flatnonzero(model.S_a.any(axis=1))
    T[n : 2 * n, :n] = model.S_a @ model.S_a.T
    after, keep = T.T @ psi @ T, np.delete(np.arange(len(psi)), a_rows)
    one = dataclasses.replace(v, M=v.M[i, k], L=v.L[i, k], tau=v.tau[p, k], Q=v.Q[p], X=v.X[p])
    np.testing.assert_allclose(after[np.ix_(keep, keep)], inequality(model, i, k, -2.0, one), atol=1e-9)
    np.testing.assert_allclose(after[np.ix_(a_rows, keep)], 0.0, atol=1e-9)
    assert np.linalg.eigvalsh(after[np.ix_(a_rows, a_rows)]).max() < 0.0


@pytest.mark.parametrize(("integral", "rules"), BACKWARDS)
def test_cone_program_has_the_inequalities_of_both_directions(integral, rules):
    """The cones of β follow those of α; M and P are the same, Q, X and τ have places of their own."""
    system, problem = scaled("consistent", integral, rules)
    model, reverse = ReducedModel.of(system), ReducedModel.of(reversed_time(system))
    cone, plain = program(model, dataclasses.replace(problem, fastest_pole=3.0)), program(model, problem)
    x = np.random.default_rng(4).normal(size=len(cone.q))
    v, back = cone.values(x), cone.values(x, cone.pole_layout)
    for name in ("P", "M", "L", "gamma2", "g"):
        np.testing.assert_array_equal(getattr(v, name), getattr(back, name))
    slack = [getattr(one, name).ravel() for one in (v, back) for name in ("Q", "X", "tau")]
    assert len(np.unique(np.concatenate(slack))) == sum(map(len, slack))
    expected, pairs = [], len(system.pairs) * len(system.E)
    for one, alpha, values in ((model, problem.alpha, v), (reverse, -3.0, back)):
        R = blended(one, alpha, values)
        unit, w = np.ones(R.shape[-1]), np.arange(len(one.S_b) + 2, len(one.S_b) + 2 + one.D_a.shape[1])
        weight = np.diag(one.system.disturbance_weight)
        unit[w] = 1.0 / np.sqrt(np.maximum(problem.gamma**2 * weight, 1.0))
        expected.append(svec(-R * np.outer(unit, unit) - problem.margin * np.eye(len(unit))).ravel())
    both = np.concatenate(expected)
    np.testing.assert_allclose((cone.b - cone.A @ x)[: len(both)], both, rtol=1e-9, atol=1e-7)
    assert cone.orders == plain.orders[:pairs] + pairs * [R.shape[-1]] + plain.orders[pairs:]


@pytest.mark.slow
@pytest.mark.parametrize(("integral", "rules", "pole"), [(True, 1, 15.0), (True, 4, 2.0), (False, 4, 2.0)])
def test_same_optimum_as_both_full_inequalities(integral, rules, pole):
    """Plain cvxpy on Ψ and Φ, all slack kept, finds the same smallest gains; the bound is felt."""
    system, problem = scaled("consistent", integral, rules)
    reverse, problem = reversed_time(system), dataclasses.replace(problem, margin=1e-6)
    n, K = len(system.B), range(len(system.E))
    P, g = cp.Variable((n, n), symmetric=True), cp.Variable()
    M = {(j, k): cp.Variable((2, n)) for j in range(len(system.A)) for k in K}
    constraints = [np.eye(n) << P, *(cp.bmat([[g * np.eye(2), m], [m.T, P]]) >> 0 for m in M.values())]
    for (i, j), (one, alpha) in itertools.product(system.pairs, ((system, problem.alpha), (reverse, -pole))):
        Q, X = cp.Variable((n, n)), cp.Variable((n, n))
        for k in K:
            tau, gamma2 = list(cp.Variable(len(system.uncertainties))), problem.gamma**2
            both = [full(one, a, k, alpha, gamma2, P, M[b, k], None, Q, X, tau, cp.bmat) for a, b in ((i, j), (j, i))]
            constraints.append(0.5 * (both[0] + both[1]) << -problem.margin * np.eye(both[0].shape[0]))
    reference = cp.Problem(cp.Minimize(g), constraints)
    reference.solve(solver=cp.CLARABEL)
    found = solve(system, dataclasses.replace(problem, fastest_pole=pole))
    assert found.objective == pytest.approx(reference.value, rel=1e-4)
    assert found.objective > 1.005 * solve(system, problem).objective


def test_a_solution_of_both_is_a_point_of_both_full_inequalities():
    system, problem = scaled("consistent", True, 4)
    found = solve(system, dataclasses.replace(problem, fastest_pole=3.0))
    Q, X, tau = found.pole_slack
    for (p, (i, j)), k in itertools.product(enumerate(system.pairs), range(len(system.E))):
        rest = {"gamma2": 0.0, "P": found.P, "L": found.L[i, k], "Q": Q[p], "X": X[p], "tau": tau[p, k]}
        phi = sum(full(reversed_time(system), a, k, -3.0, M=found.M[b, k], **rest) for a, b in ((i, j), (j, i)))
        unit = 1.0 / np.sqrt(np.abs(np.diag(phi)))
        assert np.linalg.eigvalsh(phi * unit * unit[:, np.newaxis]).max() < -1e-9
    assert solve(system, problem).pole_slack is None


def test_a_solver_that_breaks_the_strip_alone_is_not_believed(monkeypatch):
    """The optimum without β, and slack of zero for it."""
    system, problem = scaled("consistent", True, 4)
    honest = minimise._clarabel(program(ReducedModel.of(system), problem), 1e-6)

    def lie(cone, tolerance):
        x = np.append(honest.x, np.zeros(len(cone.q) - len(honest.x)))
        return types.SimpleNamespace(status="Solved", x=x, obj_val=0.0, iterations=1)

    monkeypatch.setattr(minimise, "_clarabel", lie)
    assert solve(system, problem).margin > 0.0
    with pytest.raises(Infeasible, match="Solved"):
        solve(system, dataclasses.replace(problem, fastest_pole=3.0))


def test_a_fastest_pole_that_makes_no_sense_is_refused():
    for pole in (0.3, 0.1, np.inf, np.nan):
        with pytest.raises(ValueError, match="fastest_pole"):
            Problem(alpha=0.3, gamma=1.0, fastest_pole=pole)
    with pytest.raises(ValueError, match="consistent form only"):
        reversed_time(scaled("paper", True, 4)[0])
