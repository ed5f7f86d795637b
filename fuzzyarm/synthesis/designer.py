"""From a specification to a proven controller."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
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

__all__ = ["Design", "DesignFailed", "assembled", "design", "find_design", "to_controller"]


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
    made = find_design(instance("specification", specification, Specification), parameters)
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
    v = solution
    slacks = [(v.Q, v.X, v.tau), *([v.pole_slack] if v.pole_slack is not None else [])]
    restored = [scaling.restore(v.P, v.M, v.L, *slack) for slack in slacks]
    P, M, L, *_ = restored[0]
    return assembled(
        model,
        specification,
        alpha=specification.alpha if specification.alpha is not None else v.problem.alpha * scaling.time,
        gamma=specification.gamma or v.problem.gamma or v.gamma,
        P=P,
        M=M,
        L=L,
        slack=[(Q, X, tau) for *_, Q, X, tau in restored],
        origin={"objective": specification.objective, "status": v.status},
        package="clarabel",
    )


def assembled(
    model: TSModel,
    specification: Specification,
    *,
    alpha: float,
    gamma: float,
    P: np.ndarray,
    M: np.ndarray,
    L: np.ndarray,
    slack: Sequence[tuple[np.ndarray, ...]],
    origin: dict[str, str],
    package: str,
) -> Controller:
    """Return a point of the inequalities as a controller, not proven yet.

    Args:
        model: the T-S model.
        specification: what was asked.
        alpha: decay rate [1/s].
        gamma: L2 gain, as `Controller` has it.
        P: (n, n), in SI units like all that follow.
        M: (N, N_e, 2, n_e).
        L: (N, N_e, 2, 6), read in the paper's form only.
        slack: (Q, X, τ) of Ψ and, with a fastest pole, of Φ; shapes (p, n, n), (p, n, n) and (p, N_e, m).
        origin: how it was made.
        package: that solved it, whose version is written down.
    """
    P, n_e, paper = 0.5 * (P + P.T), M.shape[-1], specification.form == "paper"
    (Q, X, tau), (pole_Q, pole_X, pole_tau) = slack[0], slack[1] if len(slack) > 1 else (None, None, None)
    return Controller(
        model=model,
        form=specification.form,
        integral=specification.integral,
        alpha=alpha,
        gamma=gamma,
        weight=np.array(PAPER_WEIGHT) if paper else None,
        common_multiplier=specification.common_multiplier,
        gains=np.linalg.solve(P[:n_e, :n_e], np.swapaxes(M, -1, -2)).swapaxes(-1, -2),
        feedforward=L if paper else None,
        P=P,
        Q=Q,
        X=X,
        tau=tau,
        origin={
            **origin,
            **({"feedforward": _feedforward_in_words(specification)} if paper else {}),
            **{name: version(name) for name in ("fuzzyarm", package)},
        },
        fastest_pole=specification.fastest_pole,
        pole_Q=pole_Q,
        pole_X=pole_X,
        pole_tau=pole_tau,
    )


def _feedforward_in_words(specification: Specification) -> str:
    share = specification.feedforward
    return "L left to the solver" if share is None else f"L = {share:g} times that of the consistent form"
