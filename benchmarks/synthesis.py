"""Time of a design: our cone program against plain cvxpy on the full inequality, both solved by Clarabel on one thread.

    python benchmarks/synthesis.py [--large] [--json FILE]

The consistent form with integral (alpha = 20, gamma = 2e-4 rad/(N m)) and Theorem 2 as printed without (alpha = 20,
gamma = 1000), smallest gains. cvxpy gets the same scaled matrices, alpha, gamma, objective, margin and tolerance, all
slack kept, and each pair (Psi_ijk + Psi_jik)/2 written once with the mean of A, M and L, which halves its compiling.
The two alternate; medians of 5, with 16 and 32 rules (--large) once. The ratio is (compile + solve) / (build + solve);
our proof is not in it, cvxpy has none. Sizes count the bound of the gains in both. Where `sdpa` or `csdp` (Debian's
sdpa and coinor-csdp) is on the PATH, it solves our cone program once, in 30 s or not; SDPT3 under Octave is left out.
Half a minute, with --large three.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import cvxpy as cp
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.proof.block_matrix import he, symmetric
from fuzzyarm.fuzzy_policy.proof.certificate import certify
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.complexity import full_size, paper_formula, reduced_size
from fuzzyarm.synthesis.conic import Problem, Program, program
from fuzzyarm.synthesis.designer import to_controller
from fuzzyarm.synthesis.error_model import ErrorModel
from fuzzyarm.synthesis.minimise import TOLERANCE, solve
from fuzzyarm.synthesis.reduced import ReducedModel
from fuzzyarm.synthesis.search import scaled_problem
from fuzzyarm.synthesis.specification import Specification

SMALL = [("consistent", 1), ("consistent", 2), ("consistent", 4), ("consistent", 8), ("paper", 4), ("paper", 8)]
LARGE = [("consistent", 16), ("consistent", 32), ("paper", 32)]
TITLE = {"consistent": "consistent, integral", "paper": "Theorem 2"}
REPEATS = 5
AGREEMENT = 0.01  # of the two optima
PATIENCE = 30.0  # s, with the other solvers
OTHER_SOLVERS = {"sdpa": r"objValPrimal = (\S+)", "csdp": r"Dual objective value: (\S+)"}


def specification(form: str, rules: int) -> Specification:
    """Return what is asked of a design."""
    if form == "consistent":
        return Specification(NAMED_RULES[rules])
    return Specification(
        NAMED_RULES[rules], "paper", gamma=1000.0, integral=False, common_multiplier=True, feedforward=None
    )


# Plain cvxpy ---------------------------------------------------------------------------------------------------------


def psi(system: ErrorModel, i: int, j: int, k: int, alpha: float, gamma2: float, v: dict[str, Any]) -> cp.Expression:
    """Return (Ψ_ijk + Ψ_jik)/2 of the general error model; rows x, ẋ, w, z, uncertainties."""
    E, A, C, (n, n_w) = system.E[k], 0.5 * (system.A[i][k] + system.A[j][k]), system.C, system.D[k].shape
    P, Q, X, M = v["P"], v["Q"], v["X"], 0.5 * (v["M"][i, k] + v["M"][j, k])
    D, n_r = system.D[k], len(system.feedforward)
    if n_r:
        D = D + system.B @ (0.5 * (v["L"][i, k] + v["L"][j, k])) @ np.eye(n_r, n_w, n_w - n_r)
    corner = -he(E @ X)
    below: list[list[Any]] = []
    for tau, u in zip(v["tau"], system.uncertainties, strict=True):
        corner = corner + tau * (u.H.T @ u.H)
        below.append([u.Wx @ P - u.Wd @ Q, -u.Wd @ X, u.Ww, 0, *[0] * len(below), -tau * np.eye(len(u.H))])
    rows = [
        [he(Q) + 2.0 * alpha * P],
        [A @ P + system.B @ M @ np.eye(M.shape[1], n) - E @ Q + X.T, corner],
        [0, D.T, -gamma2 * system.disturbance_weight],
        [C @ P, 0, 0, -np.eye(len(C))],
    ]
    return symmetric([*rows, *below], cp.bmat)


def plain(system: ErrorModel, problem: Problem) -> tuple[cp.Problem, list[cp.Expression]]:
    """Return the design problem as the theorem states it, smallest gains, and its matrices Ψ."""
    assert problem.minimise == "gain_bound" and problem.gamma is not None
    system = with_unit_weight(system, problem.gamma)
    n_e, n_r, n = system.blocks[0], len(system.feedforward), len(system.B)
    blocks, g = [cp.Variable((size, size), symmetric=True) for size in system.blocks], cp.Variable()
    P = blocks[0] if len(blocks) == 1 else symmetric([[blocks[0]], [0, blocks[1]]], cp.bmat)
    vertices = list(itertools.product(range(len(system.A)), range(len(system.E))))
    M = {vertex: cp.Variable((2, n_e)) for vertex in vertices}
    L = {vertex: cp.Variable((2, n_r)) for vertex in vertices if n_r}
    matrices = []
    for i, j in system.pairs:
        Q, X = cp.Variable((n, n)), cp.Variable((n, n))
        for k in range(len(system.E)):
            v = {"P": P, "M": M, "L": L, "Q": Q, "X": X, "tau": [cp.Variable() for _ in system.uncertainties]}
            matrices.append(psi(system, i, j, k, problem.alpha, problem.gamma**2, v))
    constraints = [matrix << -problem.margin * np.eye(matrix.shape[0]) for matrix in matrices]
    constraints += [blocks[0] >> problem.floor * np.eye(n_e), *(block >> 0 for block in blocks[1:])]
    constraints += [cp.bmat([[g * np.eye(2), m], [m.T, blocks[0]]]) >> 0 for m in M.values()]
    return cp.Problem(cp.Minimize(g), constraints), matrices


def with_unit_weight(system: ErrorModel, gamma: float) -> ErrorModel:
    """Return the model in units of w with γ² weight <= 1, as `conic` has its rows; L is in these units, too."""
    unit = np.maximum(1.0, gamma**2 * np.diag(system.disturbance_weight)) ** -0.5
    return dataclasses.replace(
        system,
        D=[D * unit for D in system.D],
        uncertainties=[dataclasses.replace(u, Ww=u.Ww * unit) for u in system.uncertainties],
        disturbance_weight=system.disturbance_weight * np.outer(unit, unit),
    )


def run_cvxpy(system: ErrorModel, problem: Problem) -> dict[str, Any]:
    """Return times [s], optimum, status and recomputed margin of plain cvxpy with Clarabel."""
    settings = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE * problem.margin)
    settings["max_threads"] = 1
    begin = time.perf_counter()
    written, matrices = plain(system, problem)
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


# Ours, and other solvers on our cone program -------------------------------------------------------------------------


def run_ours(model: TSModel, asked: Specification) -> dict[str, Any]:
    """Return times [s], optimum, status and recomputed margin of the reduced program, proven."""
    scaling, system, problem = scaled_problem(model, asked, 1.0)
    solution = solve(system, problem)
    begin = time.perf_counter()
    if not certify(to_controller(model, asked, scaling, solution)).proven:
        raise SystemExit(f"{asked}: the solver's point does not pass the proof")
    return {
        "build_s": solution.build_time,
        "solve_s": solution.solve_time,
        "proof_s": time.perf_counter() - begin,
        "objective": solution.objective,
        "status": solution.status,
        "margin": solution.margin,
    }


def run_other(name: str, cone: Program) -> dict[str, Any] | None:
    """Return wall time [s] and optimum, if found, of a solver that reads SDPA files; None if not installed."""
    binary = shutil.which(name)
    if binary is None:
        return None
    environment, output = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}, ""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "design.dat-s"), Path(folder, "answer")
        write_sdpa(cone, source)
        begin = time.perf_counter()
        with contextlib.suppress(subprocess.TimeoutExpired):
            command = [binary, str(source), str(target)]
            output = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE).stdout
        seconds = time.perf_counter() - begin
        found = re.search(OTHER_SOLVERS[name], output)
    return {"seconds": seconds, "objective": float(found[1]) if found else None}


def write_sdpa(cone: Program, path: Path) -> None:
    """Write minimise qᵀx subject to Σ F_l x_l - F_0 >= 0, F_l = -A_l, F_0 = -b, in SDPA's sparse format."""
    places = []
    for block, order in enumerate(cone.orders, start=1):
        column, row = np.tril_indices(order)
        places.append(np.stack([np.full(len(row), block), row + 1, column + 1], axis=1))
    place, entries = np.vstack(places), cone.A.tocoo()
    number = np.concatenate([np.zeros(len(cone.b), dtype=int), entries.col + 1])
    at = place[np.concatenate([np.arange(len(cone.b)), entries.row])]
    value = -np.concatenate([cone.b, entries.data]) * np.where(at[:, 1] == at[:, 2], 1.0, np.sqrt(0.5))
    by_number = np.argsort(number, kind="stable")
    lines = [f"{number[e]} {at[e, 0]} {at[e, 1]} {at[e, 2]} {value[e]:.17g}" for e in by_number if value[e]]
    head = [len(cone.q), len(cone.orders), " ".join(map(str, cone.orders)), " ".join(map(repr, cone.q.tolist()))]
    path.write_text("\n".join([*map(str, head), *lines, ""]), encoding="ascii")


# Report --------------------------------------------------------------------------------------------------------------


def measure(form: str, rules: int, repeats: int) -> dict[str, Any]:
    """Return sizes, and medians over the repeats, ours and cvxpy alternating."""
    asked = specification(form, rules)
    model = TSModel(ArmParameters(), asked.kept)
    _, system, problem = scaled_problem(model, asked, 1.0)
    runs = [{**run_ours(model, asked), **run_cvxpy(system, problem)} for _ in range(repeats)]
    for run in runs:
        run["ratio"] = (run["cvxpy_compile_s"] + run["cvxpy_solve_s"]) / (run["build_s"] + run["solve_s"])
    columns = {key: [run[key] for run in runs] for key in runs[0]}
    middle = {key: _middle(values) for key, values in columns.items()}
    cone = program(ReducedModel.of(system), problem)
    return {
        "rules": rules,
        "form": TITLE[form],
        "repeats": repeats,
        "paper_formula": dataclasses.asdict(paper_formula(len(system.A), len(system.E))),
        "full": dataclasses.asdict(full_size(system, gains_bounded=True)),
        "reduced": dataclasses.asdict(reduced_size(system, gains_bounded=True)),
        **middle,
        "agree": abs(middle["cvxpy_objective"] / middle["objective"] - 1.0) < AGREEMENT,
        "other_solvers": {name: run_other(name, cone) for name in OTHER_SOLVERS},
    }


def _middle(values: list[Any]) -> Any:
    """Return the median of numbers, None if any is missing, all different words."""
    if isinstance(values[0], str):
        return " ".join(sorted(set(values)))
    return None if None in values else median(values)


def print_tables(rows: Sequence[dict[str, Any]]) -> None:
    """Print the sizes, then the times."""
    console = Console(width=120, highlight=False)
    sizes, times = (Table(box=None, padding=(0, 1, 0, 0)) for _ in range(2))
    sizes.title = "Variables / rows"
    times.title = escape("Time [s] on one thread; bound g and margin μ of the scaled problem")
    for table in (sizes, times):
        table.add_column("rules", justify="right")
        table.add_column("form", no_wrap=True)
    for heading in ("paper's formula", "full (cvxpy)", "reduced (ours)"):
        sizes.add_column(heading, justify="right")
    headings = "cvxpy compile,cvxpy solve,our build,our solve,our proof,ratio,our g,cvxpy g,our μ,cvxpy μ"
    for heading in (*headings.split(","), *OTHER_SOLVERS):
        times.add_column(heading.replace(" ", "\n"), justify="right")
    for row in rows:
        head = (str(row["rules"]), row["form"])
        counts = [row[key] for key in ("paper_formula", "full", "reduced")]
        sizes.add_row(*head, *(f"{count['variables']} / {count['rows']}" for count in counts))
        keys = ("cvxpy_compile_s", "cvxpy_solve_s", "build_s", "solve_s", "proof_s")
        cells = [*(f"{row[key]:.3f}" for key in keys), f"{row['ratio']:.1f}"]
        cells += [f"{row[key]:.5g}" for key in ("objective", "cvxpy_objective")]
        cells += [f"{row[key]:.1e}" if row[key] is not None else "none" for key in ("margin", "cvxpy_margin")]
        times.add_row(*head, *cells, *map(_other_cell, row["other_solvers"].values()))
    console.print(sizes, "", times, sep="\n")


def _other_cell(other: dict[str, Any] | None) -> str:
    if other is None:
        return "not\ninstalled"
    if other["objective"] is None:
        return f"> {PATIENCE:g}" if other["seconds"] >= PATIENCE else "failed"
    return f"{other['seconds']:.2f}"


def main() -> int:
    """Measure, print and optionally write; 1 if the two optima differ anywhere."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", action="store_true", help="16 and 32 rules too")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    cases = [(case, REPEATS) for case in SMALL] + [(case, 1) for case in LARGE if options.large]
    load, rows = os.getloadavg(), []
    for (form, rules), repeats in cases:
        rows.append(measure(form, rules, repeats))
        print(f"{rules} rules, {TITLE[form]}: done", file=sys.stderr, flush=True)
    print_tables(rows)
    made_on = {**current_provenance(), "threads": 1, "load_average_before": load, "load_average_after": os.getloadavg()}
    machine = made_on["machine"]
    for row in rows:
        if (row["status"], row["cvxpy_status"]) != ("Solved", "Solved"):
            print(f"{row['rules']} rules, {row['form']}: ours ended {row['status']}, cvxpy's {row['cvxpy_status']}")
    print(f"\n{machine['cpu']}, {machine['cores']} cores, 1 thread used; load average before {load[0]:.1f}")
    if options.json:
        command = "python benchmarks/synthesis.py" + " --large" * options.large
        document = {"command": command, **made_on, "rows": rows}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")
    return 0 if all(row["agree"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
