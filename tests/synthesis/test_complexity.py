"""Table 2 of the paper to every digit, and true sizes compared with problems that are written out."""

import cvxpy as cp
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.proof import consistent_reference, theorem2
from fuzzyarm.fuzzy_policy.proof.vertices import error_vertices, tracking_vertices
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.complexity import Size, full_size, paper_formula, reduced_size
from fuzzyarm.synthesis.conic import Problem, program
from fuzzyarm.synthesis.reduced import ReducedModel
from fuzzyarm.synthesis.search import error_system
from fuzzyarm.synthesis.specification import PAPER_WEIGHT, Specification

ARM = ArmParameters()
TABLE_2 = {32: Size(5138, 33816), 16: Size(1298, 8728), 8: Size(338, 2328), 4: Size(98, 664)}

every_form = pytest.mark.parametrize(
    ("form", "integral", "common"),
    [("consistent", True, False), ("consistent", False, False)]
    + [("paper", integral, common) for integral in (True, False) for common in (True, False)],
)


def error_model(rules, form, integral, common, feedforward=None):
    """Return the error model; by default with a free L, as the paper counts."""
    specification = Specification(
        NAMED_RULES[rules], form, integral=integral, common_multiplier=common, feedforward=feedforward
    )
    return error_system(TSModel(ARM, specification.kept), specification)


@pytest.mark.parametrize("rules", TABLE_2)
def test_table_2_to_every_digit(rules):
    model = TSModel(ARM, NAMED_RULES[rules])
    N, N_e = len(model.A_vertices), len(model.E_vertices)
    assert (N, N_e) == (rules // 2, 2)
    assert paper_formula(N, N_e) == TABLE_2[rules]


def written_down(form, integral, common):
    """Return the theorem's inequalities for 4 rules, γ² free, as the modules of the theorems write them for cvxpy."""
    model = TSModel(ARM, NAMED_RULES[4])
    shared = {"alpha": 20.0, "gamma2": cp.Variable(), "block": cp.bmat}
    if form == "consistent":
        data, psi, L = error_vertices(model, integral), consistent_reference.psi, {}
        blocks = [cp.Variable((data.n_e, data.n_e), symmetric=True)]
        shared["P"] = blocks[0]
    else:
        data = tracking_vertices(model, integral, np.array(PAPER_WEIGHT), common_multiplier=common)
        psi = theorem2.psi
        blocks = [cp.Variable((size, size), symmetric=True) for size in (data.n_e, 4)]
        off = np.zeros((data.n_e, 4))
        shared["P"] = cp.bmat([[blocks[0], off], [off.T, blocks[1]]])
        L = {(j, k): cp.Variable((2, 6)) for j in range(2) for k in range(2)}
    M = {(j, k): cp.Variable((2, data.n_e)) for j in range(2) for k in range(2)}
    constraints = [block >> 0 for block in blocks]
    for i, j in ((0, 0), (0, 1), (1, 1)):
        slack = {name: cp.Variable(shared["P"].shape) for name in ("Q", "X")}
        for k in range(2):
            tau = list(cp.Variable(len(data.uncertainties)))
            halves = [
                psi(data, a, k, M=M[b, k], tau=tau, **({"L": L[b, k]} if L else {}), **slack, **shared)
                for a, b in ((i, j), (j, i))
            ]
            constraints.append((halves[0] + halves[1]) << 0)
    return cp.Problem(cp.Minimize(shared["gamma2"]), constraints)


@every_form
def test_full_size_is_that_of_the_theorem_written_in_cvxpy(form, integral, common):
    problem = written_down(form, integral, common)
    symmetric = [v.shape[0] * (v.shape[0] + 1) // 2 for v in problem.variables() if v.attributes["symmetric"]]
    others = [v.size for v in problem.variables() if not v.attributes["symmetric"]]
    rows = sum(constraint.shape[0] for constraint in problem.constraints)
    assert full_size(error_model(4, form, integral, common)) == Size(sum(symmetric) + sum(others), rows)


@every_form
@pytest.mark.parametrize("rules", slow_but([4, 1], [32, 4, 2, 1]))
@pytest.mark.parametrize("minimise", ["gamma", "gain_bound"])
@pytest.mark.parametrize("feedforward", [None, 0.0], ids=["free L", "L = 0"])
def test_reduced_size_is_that_of_the_cone_program(form, integral, common, rules, minimise, feedforward):
    system = error_model(rules, form, integral, common, feedforward)
    cone = program(
        ReducedModel.of(system), Problem(0.3, gamma=1.0 if minimise == "gain_bound" else None, minimise=minimise)
    )
    size = reduced_size(system, gains_bounded=minimise == "gain_bound")
    assert size == Size(len(cone.q), sum(cone.orders))


def test_sizes_of_the_largest_model():
    """Consistent form with integral and Theorem 2 without, 32 rules: reduction takes three quarters and more."""
    consistent = error_model(32, "consistent", True, False)
    assert full_size(consistent).variables == 10198
    assert reduced_size(consistent).variables == 2582
    theorem = error_model(32, "paper", False, False)
    assert full_size(theorem).variables == 18069
    assert reduced_size(theorem).variables == 3381
    bounded = full_size(theorem, gains_bounded=True)
    assert bounded == Size(18069, full_size(theorem).rows + 32 * (2 + 4))
