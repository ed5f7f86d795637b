"""Linear algebra of the gains: against NumPy and SciPy, and the same bits with every kernel of the BLAS library."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from fuzzyarm.fuzzy_policy.laws._riccati import exponential, riccati
from fuzzyarm.numbers.linear import product, solved

RANDOM = np.random.default_rng(0)


def test_products_solutions_and_exponentials_of_several_matrices():
    a, b = RANDOM.normal(size=(3, 5, 5)), RANDOM.normal(size=(3, 5, 2))
    a[0, 0, 0] = 0.0  # needs a pivot
    np.testing.assert_allclose(product(a, b), a @ b, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(solved(a, b), np.linalg.solve(a, b), rtol=1e-11)
    np.testing.assert_allclose(
        exponential(20.0 * a), expm(20.0 * a), rtol=1e-9, atol=1e-10 * np.abs(expm(20.0 * a)).max()
    )
    np.testing.assert_array_equal(exponential(np.zeros((2, 2))), np.eye(2))
    assert np.isnan(solved(np.zeros((2, 2)), np.eye(2))).all()


def test_the_equation_is_solved_where_it_has_a_solution():
    A, B = RANDOM.normal(size=(4, 6, 6)), RANDOM.normal(size=(4, 6, 2))
    A[3], B[3] = np.eye(6), 0.0  # nothing can be stabilised there
    Q = np.broadcast_to(np.eye(6), A.shape)
    found = riccati(A, B @ np.swapaxes(B, -1, -2), Q)
    expected = [solve_discrete_are(a, b, np.eye(6), np.eye(2)) for a, b in zip(A[:3], B[:3], strict=True)]
    np.testing.assert_allclose(found[:3], expected, rtol=1e-9, atol=1e-9)
    assert np.isnan(found[3]).all()


@pytest.mark.parametrize("robot", [None, pytest.param("planar-3r", marks=pytest.mark.slow)])
def test_gains_are_the_same_bits_with_every_kernel(robot):
    code = (
        "import sys\n"
        "from fuzzyarm.envs.physics.equations import chosen_arm\n"
        "from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights\n"
        "from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import feedback_table\n"
        "from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, gain_tables\n"
        f"arm = chosen_arm({robot!r}, None)\n"
        "_, *tables = gain_tables(arm, 1e-3, ObserverWeights())\n"
        "for table in (*tables, feedback_table(arm, 1e-3, AdaptiveWeights())):\n"
        "    sys.stdout.buffer.write(table.tobytes())"
    )
    found = set()
    for kernel in ("Haswell", "Sandybridge"):  # which every processor of the last ten years can run; else ignored
        environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True)
        found.add(hashlib.sha256(done.stdout).hexdigest())
    assert len(found) == 1
