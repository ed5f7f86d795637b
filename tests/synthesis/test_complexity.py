"""Table 2 of the paper to every digit, and true sizes compared with inequalities that are written out."""

import itertools

import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.vertices import error_vertices, tracking_vertices
from fuzzyarm.synthesis._design_problem import DesignProblem
from fuzzyarm.synthesis.complexity import _Size as Size
from fuzzyarm.synthesis.complexity import full_size, paper_formula
from fuzzyarm.synthesis.specification import PAPER_WEIGHT, Specification

ARM = ArmParameters()
TABLE_2 = {32: Size(5138, 33816), 16: Size(1298, 8728), 8: Size(338, 2328), 4: Size(98, 664)}


def vertices(rules, form, integral, common):
    model = TSModel(ARM, NAMED_RULES[rules])
    if form == "consistent":
        return error_vertices(model, integral)
    return tracking_vertices(model, integral, np.array(PAPER_WEIGHT), common_multiplier=common)


@pytest.mark.parametrize(
    ("form", "integral", "common"),
    [("consistent", True, False), ("consistent", False, False)]
    + [("paper", integral, common) for integral in (True, False) for common in (True, False)],
)
def test_full_size_is_that_of_the_theorem_written_out(form, integral, common):
    """Every entry of P, M, L, Q, X, τ and γ², and the rows of each Ψ_ijk + Ψ_jik."""
    data, psi = vertices(4, form, integral, common), theorems.error_psi
    n_e, m, size = data.n_e, len(data.uncertainties), [data.n_e]
    slack, L = {"Q": np.zeros((n_e, n_e)), "X": np.zeros((n_e, n_e))}, {}
    if form == "paper":
        psi, size, L = theorems.tracking_psi, [n_e, 4], {"L": np.zeros((2, 6))}
        slack = {name: np.zeros((n_e + 4, n_e + 4)) for name in slack}
    P, M, tau = np.eye(sum(size)), np.zeros((2, n_e)), np.zeros(m)
    variables, rows = 1 + sum(one * (one + 1) // 2 for one in size), len(P)
    variables += 2 * 2 * (M.size + sum(one.size for one in L.values()))
    variables += 3 * (slack["Q"].size + slack["X"].size + 2 * tau.size)
    for i, k in itertools.product((0, 0, 1), range(2)):  # of the pairs (0, 0), (0, 1), (1, 1)
        rows += len(psi(data, i, k, alpha=1.0, gamma2=1.0, P=P, M=M, tau=tau, **L, **slack))
    assert full_size(data) == Size(variables, rows)


@pytest.mark.parametrize("rules", TABLE_2)
def test_table_2_to_every_digit_and_what_is_solved_is_smaller(rules):
    """Variables of the compiled problem, g included; cvxpy counts the symmetric P by all its entries."""
    model = TSModel(ARM, NAMED_RULES[rules])
    assert paper_formula(len(model.A_vertices), len(model.E_vertices)) == TABLE_2[rules]
    if rules in (4, 32):
        solved = DesignProblem(Specification(NAMED_RULES[rules]), ARM)._problem().size_metrics.num_scalar_variables - 15
        assert solved == {4: 136, 32: 2582}[rules]
        assert solved < 0.5 * full_size(vertices(rules, "consistent", True, False)).variables
