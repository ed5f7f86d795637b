"""Time of a design: stacked and reduced, as `design` solves it, against the theorem pair by pair; Clarabel, one thread.

    python benchmarks/synthesis.py [--large] [--json FILE]

The consistent form with integral (alpha = 20, gamma = 2e-4 rad/(N m)) and Theorem 2 as printed without (alpha = 20,
gamma = 1000), smallest gains. Both are the proof's text on cvxpy's expressions, in the same units, with the same margin
and tolerance. The peer has all slack and one constraint for each (Psi_ijk + Psi_jik)/2, with cvxpy's default backend;
ours is one constraint for all of them, without the slack of rows that no vertex changes, compiled again for each run.
The two alternate; medians of 5, with 16 and 32 rules (--large) once. The ratio is (compile + solve) of the peer over
ours; our proof is not in it, the peer has none. Sizes count the bound of the gains in both. Half a minute, with --large
three.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import sys
import time
import warnings
from statistics import median
from typing import Any

import cvxpy as cp
import numpy as np
from measuring import options_of, printed, write

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.vertices import TrackingVertices
from fuzzyarm.synthesis._design_problem import _MARGIN as MARGIN
from fuzzyarm.synthesis._design_problem import _TOLERANCE as TOLERANCE
from fuzzyarm.synthesis._design_problem import DesignProblem
from fuzzyarm.synthesis._designer import to_controller
from fuzzyarm.synthesis.complexity import full_size, paper_formula
from fuzzyarm.synthesis.specification import Specification

SMALL = [("consistent", 1), ("consistent", 2), ("consistent", 4), ("consistent", 8), ("paper", 4), ("paper", 8)]
LARGE = [("consistent", 16), ("consistent", 32), ("paper", 32)]
TITLE = {"consistent": "consistent, integral", "paper": "Theorem 2"}
REPEATS = 5
AGREEMENT = 0.01  # of the two optima


def specification(form: str, rules: int) -> Specification:
    """Return what is asked of a design."""
    if form == "consistent":
        return Specification(NAMED_RULES[rules])
    return Specification(
        NAMED_RULES[rules], "paper", gamma=1000.0, integral=False, common_multiplier=True, feedforward=None
    )


# As the theorem states it ---------------------------------------------------------------------------------------------


def plain(problem: DesignProblem) -> tuple[cp.Problem, list[cp.Expression]]:
    """Return the problem of smallest gains pair by pair, with all slack, and its matrices (Ψ_ijk + Ψ_jik)/2."""
    data, s, unit, asked = problem._midpoints, problem._scaling, problem._units, problem.specification
    n, n_e, row, paper = len(s.state), data.n_e, problem._row_units("Psi"), isinstance(data, TrackingVertices)
    blocks, g = (
        [cp.Variable((size, size), symmetric=True) for size in ((n_e, n - n_e) if paper else (n_e,))],
        cp.Variable(),
    )
    P = symmetric_of(blocks)
    vertices = list(itertools.product(range(len(problem._data.A)), range(len(data.E))))
    M = {at: cp.Variable((JOINTS, n_e)) for at in vertices}
    L = {at: cp.Variable((JOINTS, 3 * JOINTS)) for at in vertices}
    unit_L = s.torque[:, np.newaxis] / s.disturbance[-3 * JOINTS :] if paper else None
    psi, matrices = theorems.tracking_psi if paper else theorems.error_psi, []
    for pair, (i, j) in enumerate(problem.pairs):
        Q, X = (cp.multiply(unit[name], cp.Variable((n, n))) for name in "QX")
        for k in range(len(data.E)):
            values = {"tau": cp.multiply(unit["tau"], cp.Variable(len(s.uncertainty)))} if len(s.uncertainty) else {}
            values = {"tau": np.zeros(0), **values, "M": cp.multiply(unit["M"], 0.5 * (M[i, k] + M[j, k]))}
            if paper:
                values["L"] = cp.multiply(unit_L, 0.5 * (L[i, k] + L[j, k]))
            matrix = psi(
                data, pair, k, alpha=asked.alpha, gamma2=problem._c * asked.gamma**2, output=problem._c**0.5,
                P=cp.multiply(unit["P"], P), Q=Q, X=X, put=mirrored, **values,
            )  # fmt: skip
            matrices.append(cp.multiply(np.outer(row, row), matrix))
    constraints = [matrix << -MARGIN * np.eye(len(row)) for matrix in matrices]
    constraints += [blocks[0] >> np.eye(n_e), *(block >> 0 for block in blocks[1:])]
    constraints += [cp.bmat([[g * np.eye(JOINTS), m], [m.T, blocks[0]]]) >> 0 for m in M.values()]
    return cp.Problem(cp.Minimize(g), constraints), matrices


def symmetric_of(blocks: list[Any]) -> Any:
    """Return the block diagonal matrix."""
    return mirrored([[*[0] * place, block] for place, block in enumerate(blocks)])


def mirrored(lower: list[list[Any]]) -> Any:
    """Return the symmetric matrix of a lower triangle of blocks by `cvxpy.bmat`."""
    sizes = [row[-1].shape[0] for row in lower]

    def entry(row: int, column: int) -> Any:
        if column > row:
            return entry(column, row).T
        given = lower[row][column]
        return np.zeros((sizes[row], sizes[column])) if isinstance(given, int) else given

    return cp.bmat([[entry(row, column) for column in range(len(sizes))] for row in range(len(sizes))])


def run_plain(asked: Specification) -> dict[str, Any]:
    """Return times [s], optimum, status and recomputed margin with Clarabel."""
    settings = {**dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE * MARGIN), "max_threads": 1}
    problem = DesignProblem(asked, ArmParameters())
    begin = time.perf_counter()
    written, matrices = plain(problem)
    data, chain, inverse = written.get_problem_data(cp.CLARABEL, solver_opts=settings)
    compiled = time.perf_counter()
    answer = chain.solve_via_data(written, data, solver_opts=settings)
    end = time.perf_counter()
    margin = None  # where cvxpy gives no point away
    with warnings.catch_warnings(), contextlib.suppress(cp.SolverError):
        warnings.simplefilter("ignore", UserWarning)  # inaccurate or failed: the status says so
        written.unpack_results(answer, chain, inverse)
        margin = -max(float(np.linalg.eigvalsh(matrix.value).max()) for matrix in matrices)
    return {
        "cvxpy_compile_s": compiled - begin,
        "cvxpy_solve_s": end - compiled,
        "cvxpy_objective": float(answer.obj_val),
        "cvxpy_status": str(answer.status),
        "cvxpy_margin": margin,
    }


# Stacked and reduced --------------------------------------------------------------------------------------------------


def reduced_size(asked: Specification) -> dict[str, int]:
    """Return the variables and rows of the cone program that `design` solves."""
    compiled = DesignProblem(asked, ArmParameters())._problem()
    data = compiled.get_problem_data(cp.CLARABEL, canon_backend="SCIPY")[0]
    return {"variables": len(data["c"]), "rows": sum(data["dims"].psd)}


def run_ours(asked: Specification) -> dict[str, Any]:
    """Return times [s], optimum, status and recomputed margin of the reduced program, proven."""
    begin = time.perf_counter()
    problem = DesignProblem(asked, ArmParameters())
    written = time.perf_counter()
    point = problem.point()
    solved = time.perf_counter()
    if not certify(to_controller(problem.model, asked, point)).proven:
        raise SystemExit(f"{asked}: the solver's point does not pass the proof")
    return {
        "build_s": written - begin + point.compile_seconds,
        "solve_s": point.solve_seconds,
        "proof_s": time.perf_counter() - solved,
        "objective": point.objective,
        "status": point.status,
        "margin": point.margin,
    }


# Report --------------------------------------------------------------------------------------------------------------


def measure(form: str, rules: int, repeats: int) -> dict[str, Any]:
    """Return sizes, and medians over the repeats, ours and the peer alternating."""
    asked = specification(form, rules)
    runs = [{**run_ours(asked), **run_plain(asked)} for _ in range(repeats)]
    for run in runs:
        run["ratio"] = (run["cvxpy_compile_s"] + run["cvxpy_solve_s"]) / (run["build_s"] + run["solve_s"])
    columns = {key: [run[key] for run in runs] for key in runs[0]}
    middle = {key: _middle(values) for key, values in columns.items()}
    data = DesignProblem(asked, ArmParameters())._data
    return {
        "rules": rules,
        "form": TITLE[form],
        "repeats": repeats,
        "paper_formula": dataclasses.asdict(paper_formula(len(data.A), len(data.E))),
        "full": dataclasses.asdict(full_size(data, gains_bounded=True)),
        "reduced": reduced_size(asked),
        **middle,
        "agree": abs(middle["cvxpy_objective"] / middle["objective"] - 1.0) < AGREEMENT,
    }


def _middle(values: list[Any]) -> Any:
    """Return the median of numbers, None if any is missing, all different words."""
    if isinstance(values[0], str):
        return " ".join(sorted(set(values)))
    return None if None in values else median(values)


def main() -> int:
    """Measure, print and optionally write; 1 if the two optima differ anywhere."""
    parser = options_of(__doc__)
    parser.add_argument("--large", action="store_true", help="16 and 32 rules too")
    options = parser.parse_args()
    cases = [(case, REPEATS) for case in SMALL] + [(case, 1) for case in LARGE if options.large]
    load, rows = os.getloadavg(), printed(measure(*case, repeats) for case, repeats in cases)
    loads = {"load_average_before": load, "load_average_after": os.getloadavg()}
    write(options.json, "synthesis.py" + " --large" * options.large, threads=1, **loads, rows=rows)
    return 0 if all(row["agree"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
