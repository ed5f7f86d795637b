"""From a specification to a proven controller."""

from __future__ import annotations

import dataclasses
import time
from importlib.metadata import version

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.proof.certificate import Certificate, certify
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.synthesis.explanation import why_infeasible
from fuzzyarm.synthesis.minimise import Solution
from fuzzyarm.synthesis.scaling import Scaling
from fuzzyarm.synthesis.search import best_solution
from fuzzyarm.synthesis.specification import PAPER_WEIGHT, Specification

__all__ = ["Design", "DesignFailed", "design", "find_design", "to_controller"]


class DesignFailed(ValueError):
    """No controller whose proof goes through was found; the message says what would have to give."""


@dataclasses.dataclass(frozen=True)
class Design:
    """A proven controller and what it cost.

    Attributes:
        controller: ready to be saved.
        certificate: of its inequalities, all proven.
        solve_seconds: time of the search for a solution [s].
        proof_seconds: time of the proof [s].
        variables: decision variables of the cone program.
        rows: of its cones.
    """

    controller: Controller
    certificate: Certificate
    solve_seconds: float
    proof_seconds: float
    variables: int
    rows: int


def design(specification: Specification, parameters: ArmParameters | None = None) -> Design:
    """Return a controller for a specification; it is proven from its stored gains, whatever the solver's status says.

    Args:
        specification: what is asked.
        parameters: the arm, default Table 1.

    Raises:
        DesignFailed: no point was found whose proof goes through.
    """
    made = find_design(specification, parameters)
    if isinstance(made, Design):
        return made
    arm = ArmParameters() if parameters is None else parameters
    raise DesignFailed(f"{made}{why_infeasible(TSModel(arm, specification.kept), specification)}")


def find_design(specification: Specification, parameters: ArmParameters | None = None) -> Design | str:
    """Return what `design` returns, or without a controller what comes in front of the explanation, not looked for.

    Args:
        specification: what is asked.
        parameters: the arm, default Table 1.
    """
    parameters = ArmParameters() if parameters is None else instance("parameters", parameters, ArmParameters)
    model = TSModel(parameters, specification.kept)
    begin = time.perf_counter()
    best = best_solution(model, specification)
    solve_seconds = time.perf_counter() - begin
    if best is None:
        return ""
    begin = time.perf_counter()
    controller = to_controller(model, specification, *best)
    certificate = certify(controller)
    if not certificate.proven:
        return "the solver's point does not pass the proof: "
    return Design(controller, certificate, solve_seconds, time.perf_counter() - begin, best[1].variables, best[1].rows)


def to_controller(model: TSModel, specification: Specification, scaling: Scaling, solution: Solution) -> Controller:
    """Return the solution in SI units as a controller."""
    P, M, L, Q, X, tau = scaling.restore(solution.P, solution.M, solution.L, solution.Q, solution.X, solution.tau)
    P = 0.5 * (P + P.T)
    pole_Q, pole_X, pole_tau = (None, None, None)
    if solution.pole_slack is not None:
        *_, pole_Q, pole_X, pole_tau = scaling.restore(solution.P, solution.M, solution.L, *solution.pole_slack)
    n_e = M.shape[-1]
    paper = specification.form == "paper"
    return Controller(
        model=model,
        form=specification.form,
        integral=specification.integral,
        alpha=specification.alpha if specification.alpha is not None else solution.problem.alpha * scaling.time,
        gamma=specification.gamma or solution.problem.gamma or solution.gamma,
        weight=np.array(PAPER_WEIGHT) if paper else None,
        common_multiplier=specification.common_multiplier,
        gains=np.linalg.solve(P[:n_e, :n_e], np.swapaxes(M, -1, -2)).swapaxes(-1, -2),
        feedforward=L if paper else None,
        P=P,
        Q=Q,
        X=X,
        tau=tau,
        origin={
            "objective": specification.objective,
            "status": solution.status,
            **({"feedforward": _feedforward_in_words(specification)} if paper else {}),
            **{name: version(name) for name in ("fuzzyarm", "clarabel")},
        },
        fastest_pole=specification.fastest_pole,
        pole_Q=pole_Q,
        pole_X=pole_X,
        pole_tau=pole_tau,
    )


def _feedforward_in_words(specification: Specification) -> str:
    share = specification.feedforward
    return "L left to the solver" if share is None else f"L = {share:g} times that of the consistent form"
