"""The scaled and the SI inequality are congruent: scaling changes no solution."""

import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.error_model import consistent_form, paper_form
from fuzzyarm.synthesis.scaling import Scaling

ARM = ArmParameters()
WEIGHT = np.array([1e-5, 1e-5, 1.0, 1.0])


def full_inequality(system, i, k, *, alpha, gamma2, P, M, L, Q, X, tau):
    """Psi_ijk of the general error dynamics, written out once more."""
    A, B, E = system.A[i][k], system.B, system.E[k]
    n, n_w, n_z = len(A), system.D[k].shape[1], len(system.C)
    wide_M, D = np.zeros((2, n)), system.D[k].copy()
    wide_M[:, : system.blocks[0]] = M
    D[:, n_w - L.shape[1] :] += B @ L
    corner = -(E @ X + (E @ X).T) + sum(t * u.H.T @ u.H for t, u in zip(tau, system.uncertainties, strict=True))
    sizes = [n, n, n_w, n_z, *(len(u.H) for u in system.uncertainties)]
    rows = np.cumsum([0, *sizes])
    full = np.zeros((rows[-1], rows[-1]))

    def put(row, column, block):
        full[rows[row] : rows[row + 1], rows[column] : rows[column + 1]] = block
        full[rows[column] : rows[column + 1], rows[row] : rows[row + 1]] = block.T

    put(0, 0, Q + Q.T + 2.0 * alpha * P)
    put(1, 0, A @ P + B @ wide_M - E @ Q + X.T)
    put(1, 1, corner)
    put(2, 1, D.T)
    put(2, 2, -gamma2 * system.disturbance_weight)
    put(3, 0, system.C @ P)
    put(3, 3, -np.eye(n_z))
    for position, (t, u) in enumerate(zip(tau, system.uncertainties, strict=True), start=4):
        put(position, 0, u.Wx @ P - u.Wd @ Q)
        put(position, 1, -u.Wd @ X)
        put(position, 2, u.Ww)
        put(position, position, -t * np.eye(len(u.H)))
    return full


@pytest.mark.parametrize("form", ["consistent", "paper", "paper with a common multiplier"])
@pytest.mark.parametrize("integral", [True, False])
@pytest.mark.parametrize("rules", [32, 8, 4, 2, 1])
def test_scaled_and_si_inequality_are_congruent(rules, integral, form):
    """Psi = c D Psi_scaled D for random decision variables, with alpha = sigma alpha_scaled."""
    model = TSModel(ARM, NAMED_RULES[rules])
    if form == "consistent":
        system = consistent_form(model, integral)
    else:
        system = paper_form(model, integral, WEIGHT, common_multiplier=form != "paper")
    scaling = Scaling.of(system, ARM, lyapunov=0.37)
    n, m, n_e = len(system.B), len(system.uncertainties), system.blocks[0]
    rng = np.random.default_rng(rules)
    P = rng.normal(size=(n, n))
    variables = {
        "P": P + P.T,
        "M": rng.normal(size=(2, n_e)),
        "L": rng.normal(size=(2, len(system.feedforward))),
        "Q": rng.normal(size=(n, n)),
        "X": rng.normal(size=(n, n)),
        "tau": rng.normal(size=m),
    }
    i, k = len(system.A) - 1, len(system.E) - 1
    scaled = full_inequality(scaling.apply(system), i, k, alpha=0.3, gamma2=1.7, **variables)
    restored = dict(zip(variables, scaling.restore(**variables), strict=True))
    native = full_inequality(system, i, k, alpha=0.3 * scaling.time, gamma2=1.7, **restored)
    D = scaling.congruence(system)
    assert (D > 0.0).all()
    difference = np.abs(native / np.outer(D, D) / scaling.lyapunov - scaled)
    assert difference.max() < 1e-9 * np.abs(scaled).max()


def test_scaled_matrices_are_of_order_one():
    """What the scaling is for: SI entries spread over seven decades, scaled ones over three at most."""
    system = consistent_form(TSModel(ARM), True)
    scaled = Scaling.of(system, ARM, lyapunov=1.0).apply(system)
    for matrix in (*scaled.E, *(A for per_k in scaled.A for A in per_k), scaled.B):
        assert np.abs(matrix).max() < 3.0
    np.testing.assert_allclose(scaled.B[2:4], np.eye(2))
