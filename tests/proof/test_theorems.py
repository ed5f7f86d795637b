"""The matrices of Theorems 1 and 2 and of the consistent-reference form: they are what their proofs need.

Two independent witnesses: the nonlinear rigid arm, and random uncertainty.
"""

import dataclasses
import itertools

import cvxpy as cp
import numpy as np
import pytest
from flint import fmpq
from slow_twins import slow_but

from fuzzyarm.envs.physics.dynamics import arm_constants, mass_matrix, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, PREMISES, TSModel, premises
from fuzzyarm.proof import theorems, vertices
from fuzzyarm.proof.vertices import error_vertices, tracking_vertices
from fuzzyarm.synthesis.expressions import half

ARM = ArmParameters()
ALPHA, WEIGHT = 3.0, np.array([4.0, 1.0, 0.25, 0.5])
SUBSETS = [subset for count in range(6) for subset in itertools.combinations(PREMISES, count)]
# Each premise alone shows a term that is missing; other subsets are slow twins.
FAST = [(), *((premise,) for premise in PREMISES), ("z1", "z3"), tuple(PREMISES)]
every_subset = pytest.mark.parametrize("kept", slow_but(FAST, SUBSETS), ids=lambda kept: "+".join(kept) or "none")
with_and_without_integral = pytest.mark.parametrize("integral", [False, True], ids=["e", "e+x_I"])
with_integral_or_slow = pytest.mark.parametrize("integral", slow_but([True], [False, True]), ids=["e", "e+x_I"])
both_multipliers = pytest.mark.parametrize("common", [False, True], ids=["own-tau", "common-tau"])
every_form = pytest.mark.parametrize("form", ["theorem2", "consistent", "fastest pole"])


def he(matrix):
    return matrix + matrix.T


def schur(matrix, size):
    """Return the Schur complement that is left of the first `size` rows."""
    corner, side = matrix[size:, size:], matrix[size:, :size]
    return matrix[:size, :size] - side.T @ np.linalg.solve(corner, side)


def positive(rng, n):
    root = rng.normal(size=(n, n))
    return root @ root.T + np.eye(n)


def vertices_of(form, model, integral, common=False):
    if form == "theorem2":
        return tracking_vertices(model, integral, WEIGHT, common_multiplier=common), theorems.tracking_psi
    psi = {"consistent": theorems.error_psi, "fastest pole": fastest_pole}[form]
    return error_vertices(model, integral, common_multiplier=common), psi


def fastest_pole(data, i, k, *, alpha, gamma2, **values):
    """Return Φ_ijk for β = `alpha`, by the signature of Ψ; there is no γ in it."""
    return theorems.error_phi(data, i, k, fastest_pole=alpha, **values)


def draw(rng, data, form):
    """Return random decision variables, the same keywords as `psi`."""
    n = data.n_e + (4 if form == "theorem2" else 0)
    P = positive(rng, n)
    P[: data.n_e, data.n_e :] = P[data.n_e :, : data.n_e] = 0.0
    values = {
        "P": P,
        "M": rng.normal(size=(2, data.n_e)),
        "L": rng.normal(size=(2, 6)),
        "Q": rng.normal(size=(n, n)),
        "X": 3.0 * np.eye(n) + rng.normal(size=(n, n)),
        "tau": rng.uniform(0.5, 2.0, size=len(data.uncertainties)),
        "gamma2": rng.uniform(0.5, 2.0),
    }
    if form != "theorem2":
        del values["L"]
    return values


# Without uncertainty ------------------------------------------------------------------------------------------------


@with_and_without_integral
def test_theorem_2_without_uncertainty_has_the_rows_of_theorem_1(integral):
    data = tracking_vertices(TSModel(ARM, NAMED_RULES[32]), integral, WEIGHT)
    values = draw(np.random.default_rng(1), data, "theorem2")
    Psi = theorems.tracking_psi(data, 5, 1, alpha=ALPHA, **values)
    assert Psi.shape == (2 * (data.n_e + 4) + 2 + 6 + 4,) * 2


# The nonlinear rigid arm ---------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Family:
    """Random decision variables for every i, j, k, and the Ψ_ijk they give."""

    P: np.ndarray
    gamma2: float
    M: np.ndarray  # [j][k]
    L: np.ndarray  # [j][k]
    Q: np.ndarray  # [i][j]
    X: np.ndarray  # [i][j]
    tau: np.ndarray  # [i][j][k]
    Psi: np.ndarray  # [i][j][k]

    @classmethod
    def draw(cls, rng, data, form, psi):
        N, N_e, common = len(data.A), len(data.E), draw(rng, data, form)
        P, gamma2, n = common["P"], common["gamma2"], len(common["P"])
        M, L = rng.normal(size=(N, N_e, 2, data.n_e)), rng.normal(size=(N, N_e, 2, 6))
        Q, X = rng.normal(size=(N, N, n, n)), 5.0 * np.eye(n) + rng.normal(size=(N, N, n, n))
        tau = rng.uniform(0.5, 2.0, size=(N, N, N_e, len(data.uncertainties)))

        def one(i, j, k):
            free = {"L": L[j, k]} if form == "theorem2" else {}
            return psi(
                data, i, k, alpha=ALPHA, gamma2=gamma2, P=P, M=M[j, k], Q=Q[i, j], X=X[i, j], tau=tau[i, j, k], **free
            )

        Psi = np.array([[[one(i, j, k) for k in range(N_e)] for j in range(N)] for i in range(N)])
        return cls(P, gamma2, M, L, Q, X, tau, Psi)


def acceleration(q, dq, torque):
    """Return q̈ of the rigid arm with motor inertia and viscous friction, from the plant's own equations."""
    arm = arm_constants(ARM)
    m11, m12, m22 = mass_matrix(np.cos(q[1]), arm)
    inertia = np.array([[m11, m12], [m12, m22]]) + np.diag(ARM.motor_inertia)
    resisting = rigid_inverse_dynamics(q, dq, np.zeros(2), arm) + np.array(ARM.viscous_friction) * dq
    return np.linalg.solve(inertia, torque - resisting)


def random_arm_state(rng):
    q, dq = rng.uniform(-1, 1, 2) * ARM.joint_limit, rng.uniform(-1, 1, 2) * ARM.velocity_limit
    return q, dq, premises(q, dq, ARM)


def dropped(model, term, z):
    """Return Δ = diag(f) of one uncertain term at premises z, |f| <= 1."""
    middle, radius = model.bounds.mean(axis=1), 0.5 * np.diff(model.bounds, axis=1)[:, 0]
    rows = {u.premises[0]: len(u.H) for u in model.uncertainties}
    f = [(z - middle)[PREMISES.index(name)] / radius[PREMISES.index(name)] for name in term.premises]
    assert max(map(abs, f)) <= 1.0
    return np.diag(np.repeat(f, [rows[name] for name in term.premises]))


def consistent_motion(rng, model, data, family, d):
    """Return z, ē, ē' of the nonlinear arm at a random state, with x_r = (q_d, q̇_d) and the cancelling feedforward.

    d is all that turns the joints besides: what the dropped premises leave of the feedforward is in it.
    """
    q, dq, z = random_arm_state(rng)
    x_p, x_r, x_I, ddq_d = np.concatenate([q, dq]), *(rng.normal(size=size) for size in (4, data.n_e - 4, 2))
    x_r_dot = np.concatenate([x_r[2:], ddq_d])
    e = np.concatenate([x_p - x_r, x_I])
    h, v = model.weights(z)
    A_h, E_v = np.tensordot(h, model.A_vertices, axes=1), np.tensordot(v, model.E_vertices, axes=1)
    feedback = np.einsum("j,k,jkab->ab", h, v, family.M) @ np.linalg.solve(family.P, e)
    feedforward = (E_v @ x_r_dot - A_h @ x_r)[2:]
    torque = d - ((model.A(z) - A_h) @ x_r - (model.E(z) - E_v) @ x_r_dot)[2:]
    x_p_dot = np.concatenate([dq, acceleration(q, dq, feedback + feedforward + torque)])
    return z, e, np.concatenate([x_p_dot - x_r_dot, e[: data.n_e - 4]])


def check_dissipation(family, model, data, z, *, x, x_dot, w, y_error_rate, signals, dissipation, magnitude):
    """Compare V̇ + eᵀQe - γ²wᵀw + 2αV with ξᵀ Schur(Ψ_hhv) ξ: equal up to the completed squares, which are known.

    Ψ_2 maps ξ to the signals the uncertainty acts on: W x for ΔA, -W ẋ for ΔE.
    """
    h, v = model.weights(z)
    n = len(x)
    Q, X = np.einsum("i,j,ijab->ab", h, h, family.Q), np.einsum("i,j,ijab->ab", h, h, family.X)
    P_star = np.block([[family.P, np.zeros((n, n))], [Q, X]])  # (17)
    xi_vector = np.concatenate([np.linalg.solve(P_star, np.concatenate([x, x_dot])), w])
    Psi = np.einsum("i,j,k,ijkab->ab", h, h, v, family.Psi)
    proven = xi_vector @ schur(Psi, len(xi_vector)) @ xi_vector
    tau = np.einsum("i,j,k,ijkl->l", h, h, v, family.tau)
    squares = 0.0
    for scale, term, signal in zip(tau, data.uncertainties, signals, strict=True):
        y = term.H @ xi_vector[y_error_rate]
        slack = scale * y @ y + signal @ signal / scale - 2.0 * y @ dropped(model, term, z) @ signal
        assert slack >= 0.0
        squares += slack
    assert proven == pytest.approx(dissipation + squares, rel=0.0, abs=1e-9 * (magnitude + abs(proven) + squares))
    assert dissipation <= proven + 1e-9 * (magnitude + abs(proven))


@every_subset
@with_integral_or_slow
@both_multipliers
def test_theorem_2_is_the_dissipation_of_the_nonlinear_arm(kept, integral, common):
    """The proof's identity at random states, with r, x_r, d and the decision variables at random and independent.

    With all premises kept this is Theorem 1: V̇ + eᵀQe - γ²wᵀw + 2αV = ξᵀ Ω ξ exactly.
    """
    model, rng = TSModel(ARM, kept), np.random.default_rng(2)
    data, psi = vertices_of("theorem2", model, integral, common)
    family, n_e = Family.draw(rng, data, "theorem2", psi), data.n_e
    P_11, P_22 = family.P[:n_e, :n_e], family.P[n_e:, n_e:]
    A_r, B_r = vertices.reference_model()
    for _ in range(3):
        q, dq, z = random_arm_state(rng)
        x_p, x_r, x_I, r, d = np.concatenate([q, dq]), *(rng.normal(size=size) for size in (4, n_e - 4, 6, 2))
        e = np.concatenate([x_p - x_r, x_I])
        h, v = model.weights(z)
        feedback = np.einsum("j,k,jkab->ab", h, v, family.M) @ np.linalg.solve(P_11, e)  # (12)
        u = feedback + np.einsum("j,k,jkab->ab", h, v, family.L) @ r
        x_p_dot = np.concatenate([dq, acceleration(q, dq, u + d)])
        x_r_dot = A_r @ x_r + B_r @ r  # (8)
        e_dot = np.concatenate([x_p_dot - x_r_dot, e[: n_e - 4]])
        V = e @ np.linalg.solve(P_11, e) + x_r @ np.linalg.solve(P_22, x_r)
        V_dot = 2.0 * np.array([e @ np.linalg.solve(P_11, e_dot), x_r @ np.linalg.solve(P_22, x_r_dot)])
        w = np.concatenate([d, r])
        terms = np.array([*V_dot, e[:4] @ (WEIGHT * e[:4]), -family.gamma2 * w @ w, 2.0 * ALPHA * V])
        check_dissipation(
            family,
            model,
            data,
            z,
            x=np.concatenate([e, x_r]),
            x_dot=np.concatenate([e_dot, x_r_dot]),
            w=w,
            y_error_rate=slice(n_e + 4, n_e + 8),
            signals=[term.W @ x_p if term.on == "A" else -term.W @ x_p_dot for term in data.uncertainties],
            dissipation=terms.sum(),
            magnitude=np.abs(terms).sum(),
        )


@every_subset
@with_integral_or_slow
@both_multipliers
def test_the_consistent_form_is_the_dissipation_of_the_nonlinear_arm(kept, integral, common):
    """Likewise with x_r = (q_d, q̇_d) and the cancelling feedforward; d holds what the dropped premises leave of it."""
    model, rng = TSModel(ARM, kept), np.random.default_rng(3)
    data, psi = vertices_of("consistent", model, integral, common)
    family, n_e = Family.draw(rng, data, "consistent", psi), data.n_e
    for _ in range(3):
        d = rng.normal(size=2)
        z, e, e_dot = consistent_motion(rng, model, data, family, d)
        V, V_dot = e @ np.linalg.solve(family.P, e), 2.0 * e @ np.linalg.solve(family.P, e_dot)
        terms = np.array([V_dot, e[:2] @ e[:2], -family.gamma2 * d @ d, 2.0 * ALPHA * V])
        check_dissipation(
            family,
            model,
            data,
            z,
            x=e,
            x_dot=e_dot,
            w=d,
            y_error_rate=slice(n_e, n_e + 4),
            signals=[term.W @ e[:4] if term.on == "A" else -term.W @ e_dot[:4] for term in data.uncertainties],
            dissipation=terms.sum(),
            magnitude=np.abs(terms).sum(),
        )


@every_subset
@with_and_without_integral
@both_multipliers
def test_the_fastest_pole_is_the_growth_of_V_on_the_nonlinear_arm_run_backwards(kept, integral, common):
    """The proof's identity for Φ: without d, -V̇ - 2βV = ξᵀ Schur(Φ_hhv) ξ up to the completed squares."""
    model, rng = TSModel(ARM, kept), np.random.default_rng(10)
    data, psi = vertices_of("fastest pole", model, integral, common)
    family, n_e = Family.draw(rng, data, "fastest pole", psi), data.n_e
    for _ in range(3):
        z, e, e_dot = consistent_motion(rng, model, data, family, np.zeros(2))
        V, V_dot = e @ np.linalg.solve(family.P, e), 2.0 * e @ np.linalg.solve(family.P, e_dot)
        terms = np.array([-V_dot, -2.0 * ALPHA * V])
        check_dissipation(
            family,
            model,
            data,
            z,
            x=e,
            x_dot=-e_dot,
            w=np.zeros(0),
            y_error_rate=slice(n_e, n_e + 4),
            # Backwards ΔA comes with a minus, as A does; ΔE has it already.
            signals=[-term.W @ e[:4] if term.on == "A" else term.W @ e_dot[:4] for term in data.uncertainties],
            dissipation=terms.sum(),
            magnitude=np.abs(terms).sum(),
        )


# Random uncertainty --------------------------------------------------------------------------------------------------


def perturbed(data, f):
    """Return certain vertices with E_p + Σ Hᵀ f W and A_p + Σ Hᵀ f W, one f for each row of each term."""
    E, A = data.E, data.A
    for Delta, term in zip(f, data.uncertainties, strict=True):
        change = term.H.T @ np.diag(Delta) @ term.W
        E, A = ([m + change for m in E], A) if term.on == "E" else (E, [m + change for m in A])
    return dataclasses.replace(data, E=E, A=A, uncertainties=[])


def with_slow_reference(data, rng):
    """Return the vertices with some A_r, B_r of order one, for eigenvalues that do not drown in 62² rad²/s²."""
    if not hasattr(data, "A_r"):
        return data
    return dataclasses.replace(data, A_r=rng.normal(size=(4, 4)), B_r=rng.normal(size=(4, 6)))


def smallest_gap(rng, data, psi, Psi, i, k, values):
    """Return the least eigenvalue of Schur(Ψ) - Ξ(perturbed), over |Schur(Ψ)|, for random f in [-1, 1] and corners."""
    least = np.inf
    certain = {**values, "tau": []}
    for corner in (False, True):
        for _ in range(6):
            f = [rng.uniform(-1, 1, len(term.W)) for term in data.uncertainties]
            Xi = psi(perturbed(data, [np.sign(x) for x in f] if corner else f), i, k, alpha=ALPHA, **certain)
            bound = schur(Psi, len(Xi))
            least = min(least, np.linalg.eigvalsh(bound - Xi)[0] / np.linalg.norm(bound, 2))
    return least


UNCERTAIN = [(), ("z1",), ("z3",), ("z1", "z3"), ("z2", "z3", "z4", "z5")]  # in all terms, in those of A, in that of E


@pytest.mark.parametrize("kept", slow_but([UNCERTAIN[0], *UNCERTAIN[3:]], UNCERTAIN), ids="+".join)
@with_and_without_integral
@both_multipliers
@every_form
def test_psi_bounds_every_uncertainty(kept, integral, common, form):
    """Ξ + ΔΞ <= Schur(Ψ) for all |f| <= 1, so Ψ < 0 proves the dissipation inequality; true of *any* τ > 0."""
    rng = np.random.default_rng(4)
    data, psi = vertices_of(form, TSModel(ARM, kept), integral, common)
    data = with_slow_reference(data, rng)
    for _ in range(3):
        values = draw(rng, data, form)
        i, k = int(rng.integers(len(data.A))), int(rng.integers(len(data.E)))
        Psi = psi(data, i, k, alpha=ALPHA, **values)
        assert smallest_gap(rng, data, psi, Psi, i, k, values) > -1e-12


@with_and_without_integral
def test_the_printed_sign_of_T_32_proves_too_much(integral):
    """With -W_e (A_r P22 - Q12), as printed, Ψ < 0 would not bound the uncertainty of E."""
    rng = np.random.default_rng(5)
    data, psi = vertices_of("theorem2", TSModel(ARM, ("z2", "z3", "z4", "z5")), integral)
    data = with_slow_reference(data, rng)
    values, n_e = draw(rng, data, "theorem2"), data.n_e
    Psi = psi(data, 0, 0, alpha=ALPHA, **values)
    T_32 = Psi[-2:, n_e : n_e + 4]
    T_32 += 2.0 * data.uncertainties[0].W @ values["Q"][:4, n_e:]
    Psi[n_e : n_e + 4, -2:] = T_32.T
    assert smallest_gap(rng, data, psi, Psi, 0, 0, values) < -1e-4


# A feasible point ----------------------------------------------------------------------------------------------------


SIGMA = vertices.REFERENCE_POLE


def in_units_of_sigma(data):
    """Return the vertices with q̇ in σ rad/s and torques in σ² N m: the same arm, and numbers a solver can bear."""
    f = np.array([1.0, 1.0, SIGMA, SIGMA]) / SIGMA**2
    A = [np.vstack([a[:2], a[2:] * f]) for a in data.A]
    terms = [dataclasses.replace(t, W=t.W * f) if t.on == "A" else t for t in data.uncertainties]
    A_r = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), -2.0 * np.eye(2)]])
    B_r = np.vstack([np.zeros((2, 6)), -np.hstack([A_r[2:], -np.eye(2)])])
    return dataclasses.replace(data, A=A, uncertainties=terms, A_r=A_r, B_r=B_r)


def solve_theorem_2(data, alpha):
    """Return some P, M, L, γ² and the largest eigenvalue of (23), recomputed."""
    n_e, n, N, N_e = data.n_e, data.n_e + 4, len(data.A), len(data.E)
    P_11, P_22 = cp.Variable((n_e, n_e), symmetric=True), cp.Variable((4, 4), symmetric=True)
    P, gamma2 = cp.bmat([[P_11, np.zeros((n_e, 4))], [np.zeros((4, n_e)), P_22]]), cp.Variable()
    M, L = ([[cp.Variable((2, m)) for _ in range(N_e)] for _ in range(N)] for m in (n_e, 6))
    bounded = [
        P_11 >> 0.1 * np.eye(n_e),
        P_11 << 10.0 * np.eye(n_e),
        P_22 >> 1e-3 * np.eye(4),
        P_22 << 10.0 * np.eye(4),
    ]
    sums = []
    for i, j in data.pairs:
        Q, X = cp.Variable((n, n)), cp.Variable((n, n))
        for k in range(N_e):
            common = {"alpha": alpha, "gamma2": gamma2, "P": P, "Q": Q, "X": X, "put": half}
            common["tau"] = cp.Variable(len(data.uncertainties))
            one, other = (
                theorems.tracking_psi(data, a, k, M=M[b][k], L=L[b][k], **common) for a, b in ((i, j), (j, i))
            )
            sums.append((one + other) + (one + other).T)
    negative = [total << -1e-3 * np.eye(total.shape[0]) for total in sums]
    cp.Problem(cp.Minimize(gamma2), bounded + negative + [cp.norm(m) <= 100.0 for row in M for m in row]).solve(
        solver=cp.CLARABEL, canon_backend="SCIPY", tol_gap_abs=1e-4, tol_gap_rel=1e-4, tol_feas=1e-6
    )
    largest = max(np.linalg.eigvalsh(total.value)[-1] for total in sums)
    M, L = (np.array([[v.value for v in row] for row in table]) for table in (M, L))
    return P_11.value, P_22.value, M, L, float(gamma2.value), largest


def worst_dissipation(model, data, point, q, dq, e, alpha):
    """Return V and the largest V̇ + eᵀe - γ²wᵀw + 2αV over all w = (d, r), on the nonlinear arm at (q, q̇)."""
    P_11, P_22, M, L, gamma2 = point
    h, v = model.weights(premises(q, dq, ARM))
    M_hv, L_hv = (np.einsum("j,k,jkab->ab", h, v, table) for table in (M, L))
    x_p = np.concatenate([q, dq / SIGMA])
    x_r = x_p - e[:4]
    y, y_r = np.linalg.solve(P_11, e), np.linalg.solve(P_22, x_r)

    def V_dot(w):
        u = M_hv @ y + L_hv @ w[2:] + w[:2]
        x_p_dot = np.concatenate([x_p[2:], acceleration(q, dq, SIGMA**2 * u) / SIGMA**2])
        x_r_dot = data.A_r @ x_r + data.B_r @ w[2:]
        return 2.0 * y @ np.concatenate([x_p_dot - x_r_dot, e[:2]]) + 2.0 * y_r @ x_r_dot

    slope = np.array([V_dot(unit) - V_dot(np.zeros(8)) for unit in np.eye(8)])
    w, V = slope / (2.0 * gamma2), e @ y + x_r @ y_r
    return V, V_dot(w) + e[:4] @ e[:4] - gamma2 * w @ w + 2.0 * alpha * V


@pytest.mark.parametrize("kept", slow_but([()], [(), ("z1", "z3")]), ids=lambda kept: "+".join(kept) or "none")
@pytest.mark.parametrize("common", slow_but([True], [False, True]), ids=["own-tau", "common-tau"])  # as printed
def test_a_feasible_point_bounds_the_dissipation_of_the_nonlinear_arm(kept, common):
    """With (23) satisfied, no w makes the dissipation positive; a fivefold decay rate is refuted at the same point."""
    model, rng, alpha = TSModel(ARM, kept), np.random.default_rng(6), 20.0 / SIGMA
    data = in_units_of_sigma(tracking_vertices(model, True, np.ones(4), common_multiplier=common))
    *point, largest = solve_theorem_2(data, alpha)
    assert largest < 0.0
    refuted = False
    for _ in range(150):
        q, dq, _ = random_arm_state(rng)
        e = np.linalg.cholesky(point[0]) @ rng.normal(size=6)
        V, dissipation = worst_dissipation(model, data, point, q, dq, e, alpha)
        assert dissipation < 0.0
        refuted |= dissipation + 2.0 * 4.0 * alpha * V > 0.0
    assert refuted


# Entries of three kinds ----------------------------------------------------------------------------------------------


exactly = np.vectorize(lambda entry: fmpq(*float(entry).as_integer_ratio()) / 3, otypes=[object])
some_models = pytest.mark.parametrize("rules", slow_but([4, 1], [32, 4, 1]))


def converted(data, convert):
    """Return the vertices with every array converted."""
    fields = {field.name: getattr(data, field.name) for field in dataclasses.fields(data)}
    fields = {name: convert(value) if isinstance(value, np.ndarray) else value for name, value in fields.items()}
    fields |= {name: [convert(matrix) for matrix in fields[name]] for name in ("E", "A")}
    fields["uncertainties"] = [dataclasses.replace(u, H=convert(u.H), W=convert(u.W)) for u in data.uncertainties]
    return type(data)(**fields)


def rounded(value):
    return np.array(value, dtype=float) if np.ndim(value) else int(value.p) / int(value.q)


@some_models
@with_and_without_integral
@both_multipliers
@every_form
def test_exact_entries_stay_exact(rules, integral, common, form):
    rng = np.random.default_rng(6)
    floats, psi = vertices_of(form, TSModel(ARM, NAMED_RULES[rules]), integral, common)
    data = converted(floats, exactly)  # thirds: most entries have no float
    values = {key: exactly(value) if np.ndim(value) else fmpq(5, 7) for key, value in draw(rng, floats, form).items()}
    i, k = len(data.A) - 1, len(data.E) - 1
    Psi = psi(data, i, k, alpha=fmpq(10, 3), **values)
    assert Psi.dtype == object
    assert {type(entry) for entry in Psi.flat} <= {fmpq, int}
    assert (Psi == Psi.T).all()
    in_floats = {key: rounded(value) for key, value in values.items()}
    expected = psi(converted(data, rounded), i, k, alpha=10 / 3, **in_floats)
    np.testing.assert_allclose(Psi.astype(float), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@some_models
@with_and_without_integral
@both_multipliers
@every_form
def test_cvxpy_expressions_have_the_same_value_and_are_affine(rules, integral, common, form):
    data, psi = vertices_of(form, TSModel(ARM, NAMED_RULES[rules]), integral, common)
    values = draw(np.random.default_rng(7), data, form)
    variables = {
        key: cp.Variable(np.shape(value), symmetric=True) if key == "P" else cp.Variable(np.shape(value))
        for key, value in values.items()
    }
    expression = psi(data, 0, 0, alpha=ALPHA, **variables, put=half)
    assert expression.is_affine()
    for key, variable in variables.items():
        variable.value = values[key]
    np.testing.assert_allclose(
        expression.value + expression.value.T, psi(data, 0, 0, alpha=ALPHA, **values), rtol=1e-12, atol=1e-10
    )


@some_models
@with_and_without_integral
@both_multipliers
@every_form
def test_psi_is_symmetric_and_affine_in_the_decision_variables(rules, integral, common, form):
    rng = np.random.default_rng(8)
    data, psi = vertices_of(form, TSModel(ARM, NAMED_RULES[rules]), integral, common)
    first, second = draw(rng, data, form), draw(rng, data, form)
    mixed = {key: -0.3 * first[key] + 1.3 * second[key] for key in first}
    matrices = [psi(data, 0, 0, alpha=ALPHA, **values) for values in (first, second, mixed)]
    np.testing.assert_array_equal(matrices[0], matrices[0].T)
    np.testing.assert_allclose(matrices[2], -0.3 * matrices[0] + 1.3 * matrices[1], rtol=1e-11, atol=1e-10)


@every_form
def test_one_multiplier_for_each_term(form):
    """A missing or surplus multiplier is an error, not a shorter matrix."""
    data, psi = vertices_of(form, TSModel(ARM, ()), integral=False)
    values = draw(np.random.default_rng(9), data, form)
    assert [term.premises for term in data.uncertainties] == [(name,) for name in PREMISES]
    for tau in (values["tau"][:-1], np.ones(6)):
        with pytest.raises(ValueError, match=r"allowed: 5, one for each"):
            psi(data, 0, 0, alpha=ALPHA, **{**values, "tau": tau})


def test_the_printed_multipliers_are_one_for_A_and_one_for_E():
    data, _ = vertices_of("theorem2", TSModel(ARM, ("z3",)), integral=True, common=True)
    assert [(term.on, term.premises) for term in data.uncertainties] == [("A", ("z2", "z4", "z5")), ("E", ("z1",))]
