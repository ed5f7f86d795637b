"""The matrices of Theorems 1 and 2 and of the consistent form are what their proofs need, by the nonlinear arm."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from flint import fmpq
from slow_twins import slow_but

from fuzzyarm.envs.physics.dynamics import arm_constants, mass_matrix, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, PREMISES, TSModel, premises
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.vertices import error_vertices, tracking_vertices

ARM = ArmParameters()
ALPHA, WEIGHT = 3.0, np.array([4.0, 1.0, 0.25, 0.5])
SUBSETS = [subset for count in range(6) for subset in itertools.combinations(PREMISES, count)]
# Each premise alone shows a term that is missing; other subsets are slow twins.
FAST = [(), *((premise,) for premise in PREMISES), ("z1", "z3"), tuple(PREMISES)]
every_subset = pytest.mark.parametrize("kept", slow_but(FAST, SUBSETS), ids=lambda kept: "+".join(kept) or "none")
with_and_without_integral = pytest.mark.parametrize("integral", [False, True], ids=["e", "e+x_I"])
both_multipliers = pytest.mark.parametrize("common", [False, True], ids=["own-tau", "common-tau"])
every_form = pytest.mark.parametrize("form", ["theorem2", "consistent", "fastest pole"])


def schur(matrix, size):
    """Return the Schur complement that is left of the first `size` rows."""
    corner, side = matrix[size:, size:], matrix[size:, :size]
    return matrix[:size, :size] - side.T @ np.linalg.solve(corner, side)


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
    root = rng.normal(size=(n, n))
    P = root @ root.T + np.eye(n)
    P[: data.n_e, data.n_e :] = P[data.n_e :, : data.n_e] = 0.0
    values = {"P": P, "M": rng.normal(size=(2, data.n_e)), "Q": rng.normal(size=(n, n))}
    values |= {"X": 3.0 * np.eye(n) + rng.normal(size=(n, n)), "gamma2": rng.uniform(0.5, 2.0)}
    values["tau"] = rng.uniform(0.5, 2.0, size=len(data.uncertainties))
    return values | ({"L": rng.normal(size=(2, 6))} if form == "theorem2" else {})


def family_of(rng, data, form, psi):
    """Return random P, γ², M and L [j][k], Q and X [i][j] and τ [i][j][k], and the Ψ [i][j][k] they give."""
    N, N_e, common = len(data.A), len(data.E), draw(rng, data, form)
    P, gamma2, n = common["P"], common["gamma2"], len(common["P"])
    M, L = rng.normal(size=(N, N_e, 2, data.n_e)), rng.normal(size=(N, N_e, 2, 6))
    Q, X = rng.normal(size=(N, N, n, n)), 5.0 * np.eye(n) + rng.normal(size=(N, N, n, n))
    tau = rng.uniform(0.5, 2.0, size=(N, N, N_e, len(data.uncertainties)))

    def one(i, j, k):
        own = {"M": M[j, k], "Q": Q[i, j], "X": X[i, j], "tau": tau[i, j, k]}
        own |= {"L": L[j, k]} if form == "theorem2" else {}
        return psi(data, i, k, alpha=ALPHA, gamma2=gamma2, P=P, **own)

    Psi = np.array([[[one(i, j, k) for k in range(N_e)] for j in range(N)] for i in range(N)])
    return SimpleNamespace(P=P, gamma2=gamma2, M=M, L=L, Q=Q, X=X, tau=tau, Psi=Psi)


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


def check_dissipation(family, model, data, z, motion, signals, terms):
    """Compare V̇ + eᵀQe - γ²wᵀw + 2αV with ξᵀ Schur(Ψ_hhv) ξ: equal up to the completed squares, which are known.

    Ψ_2 maps ξ to the signals the uncertainty acts on: W x for ΔA, -W ẋ for ΔE. A motion is x, ẋ, w and the rows of ė.
    """
    (h, v), (x, x_dot, w, y_error_rate) = model.weights(z), motion
    n, dissipation, magnitude = len(x), np.sum(terms), np.abs(terms).sum()
    Q, X = np.einsum("i,j,ijab->ab", h, h, family.Q), np.einsum("i,j,ijab->ab", h, h, family.X)
    P_star = np.block([[family.P, np.zeros((n, n))], [Q, X]])  # (17)
    xi_vector = np.concatenate([np.linalg.solve(P_star, np.concatenate([x, x_dot])), w])
    Psi = np.einsum("i,j,k,ijkab->ab", h, h, v, family.Psi)
    proven = xi_vector @ schur(Psi, len(xi_vector)) @ xi_vector
    tau = np.einsum("i,j,k,ijkl->l", h, h, v, family.tau)
    slack = [0.0]
    for scale, term, signal in zip(tau, data.uncertainties, signals, strict=True):
        y = term.H @ xi_vector[y_error_rate]
        slack.append(scale * y @ y + signal @ signal / scale - 2.0 * y @ dropped(model, term, z) @ signal)
    squares = sum(slack)
    assert min(slack) >= 0.0
    assert proven == pytest.approx(dissipation + squares, rel=0.0, abs=1e-9 * (magnitude + abs(proven) + squares))
    assert dissipation <= proven + 1e-9 * (magnitude + abs(proven))


@every_subset
@with_and_without_integral
@both_multipliers
def test_theorem_2_is_the_dissipation_of_the_nonlinear_arm(kept, integral, common):
    """The proof's identity at random states, with r, x_r, d and the decision variables at random and independent.

    With all premises kept this is Theorem 1: V̇ + eᵀQe - γ²wᵀw + 2αV = ξᵀ Ω ξ exactly.
    """
    model, rng = TSModel(ARM, kept), np.random.default_rng(2)
    data, psi = vertices_of("theorem2", model, integral, common)
    family, n_e = family_of(rng, data, "theorem2", psi), data.n_e
    P_11, P_22 = family.P[:n_e, :n_e], family.P[n_e:, n_e:]
    A_r, B_r = data.A_r, data.B_r
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
        motion = np.concatenate([e, x_r]), np.concatenate([e_dot, x_r_dot]), w, slice(n_e + 4, n_e + 8)
        signals = [term.W @ x_p if term.on == "A" else -term.W @ x_p_dot for term in data.uncertainties]
        terms = [*V_dot, e[:4] @ (WEIGHT * e[:4]), -family.gamma2 * w @ w, 2.0 * ALPHA * V]
        check_dissipation(family, model, data, z, motion, signals, terms)


@pytest.mark.parametrize("form", ["consistent", "fastest pole"])
@every_subset
@with_and_without_integral
@both_multipliers
def test_the_consistent_forms_are_the_dissipation_of_the_nonlinear_arm(kept, integral, common, form):
    """Likewise with x_r = (q_d, q̇_d) and the cancelling feedforward; d holds what the dropped premises leave of it.

    Φ is that of the arm run backwards, without d: -V̇ - 2βV = ξᵀ Schur(Φ_hhv) ξ up to the completed squares.
    """
    model, rng, on = TSModel(ARM, kept), np.random.default_rng(3), 1.0 if form == "consistent" else -1.0
    data, psi = vertices_of(form, model, integral, common)
    family, n_e = family_of(rng, data, form, psi), data.n_e
    for _ in range(3):
        d = rng.normal(size=2) if on > 0.0 else np.zeros(2)
        z, e, e_dot = consistent_motion(rng, model, data, family, d)
        V, V_dot = e @ np.linalg.solve(family.P, e), 2.0 * e @ np.linalg.solve(family.P, e_dot)
        supplied = [e[:2] @ e[:2], -family.gamma2 * d @ d] if on > 0.0 else []
        # Backwards ΔA comes with a minus, as A does; ΔE has it already.
        signals = [on * (term.W @ e[:4] if term.on == "A" else -term.W @ e_dot[:4]) for term in data.uncertainties]
        motion = e, on * e_dot, d if on > 0.0 else d[:0], slice(n_e, n_e + 4)
        terms = [on * V_dot, 2.0 * on * ALPHA * V, *supplied]
        check_dissipation(family, model, data, z, motion, signals, terms)


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
    assert {type(entry) for entry in Psi.flat} <= {fmpq, int} and (Psi == Psi.T).all()
    in_floats = {key: rounded(value) for key, value in values.items()}
    expected = psi(converted(data, rounded), i, k, alpha=10 / 3, **in_floats)
    np.testing.assert_allclose(Psi.astype(float), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@every_form
def test_one_multiplier_for_each_term(form):
    """A missing or surplus multiplier is an error, not a shorter matrix."""
    data, psi = vertices_of(form, TSModel(ARM, ()), integral=False)
    values = draw(np.random.default_rng(9), data, form)
    assert [term.premises for term in data.uncertainties] == [(name,) for name in PREMISES]
    for tau in (values["tau"][:-1], np.ones(6)):
        with pytest.raises(ValueError):
            psi(data, 0, 0, alpha=ALPHA, **values | {"tau": tau})
