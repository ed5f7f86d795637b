"""The scaled and the SI inequality are congruent: scaling changes no solution."""

import numpy as np
import pytest

from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.inequality import error_model, psi
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.scaling import Scaling

ARM = ArmParameters()


@pytest.mark.parametrize("integral", [True, False])
@pytest.mark.parametrize("rules", [8, 4, 2, 1])
def test_scaled_and_si_inequality_are_congruent(rules, integral):
    """Ψ = c D Ψ̃ D for random decision variables, with α = σ α̃."""
    system = error_model(TSModel(ARM, NAMED_RULES[rules]), integral)
    scaling = Scaling.of(system, ARM, lyapunov=0.37)
    n, m = len(system.B), len(system.uncertainties)
    rng = np.random.default_rng(rules)
    P = rng.normal(size=(n, n))
    variables = {
        "P": P + P.T,
        "M": rng.normal(size=(2, n)),
        "Q": rng.normal(size=(n, n)),
        "X": rng.normal(size=(n, n)),
        "tau": rng.normal(size=m),
    }
    i, k = len(system.A) - 1, len(system.E) - 1
    scaled = psi(scaling.apply(system), i, k, alpha=0.3, gamma2=1.7, **variables)
    restored = dict(zip(variables, scaling.restore(**variables), strict=True))
    native = psi(system, i, k, alpha=0.3 * scaling.time, gamma2=1.7, **restored)
    D = scaling.congruence(system)
    assert (D > 0.0).all()
    np.testing.assert_allclose(native / np.outer(D, D) / scaling.lyapunov, scaled, rtol=1e-9, atol=1e-9)


def test_scaled_matrices_are_of_order_one():
    """What the scaling is for: SI entries spread over seven decades, scaled ones over three at most."""
    system = error_model(TSModel(ARM), True)
    scaled = Scaling.of(system, ARM, lyapunov=1.0).apply(system)
    for matrix in (*scaled.E, *scaled.A, scaled.B):
        assert np.abs(matrix).max() < 3.0
    np.testing.assert_allclose(scaled.B[2:4], np.eye(2))
