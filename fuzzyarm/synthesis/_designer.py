"""From a specification to a proven controller: a feasible point of the inequalities, its controller, and the proof."""

import dataclasses
import time
from importlib.metadata import version
from typing import Any

import cvxpy as cp
import numpy as np

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.common.checks import instance, listed, shown
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.proof.certificate import Certificate, certify
from fuzzyarm.synthesis._design_problem import DesignProblem, NoPoint, Point
from fuzzyarm.synthesis._feasibility import best_point, why_infeasible
from fuzzyarm.synthesis.specification import PAPER_WEIGHT, Specification

__all__ = ["Design", "DesignFailed", "describe", "design", "solved", "to_controller"]


class DesignFailed(ValueError):
    """No controller could be proven; the message says which requirement would have to be relaxed.

    Attributes:
        problem: the last `DesignProblem` solved, with the solver's last values; None if there is none.
        result: the solver's answer or, if that was not proven, the `Point` or the `Certificate`; None if there is none.
    """

    def __init__(self, message: str, problem: Any = None, result: Any = None) -> None:
        super().__init__(message)
        self.problem, self.result = problem, result


@dataclasses.dataclass(frozen=True)
class Design:
    """A proven controller, and the time and size of its computation.

    Attributes:
        controller: the controller, ready to be saved.
        certificate: certificate of the controller's inequalities, all proven.
        solve_seconds: time of the search for a solution [s].
        proof_seconds: time of the proof [s].
        variables: number of scalar variables of the cone program.
        rows: number of rows of its cones; a matrix counts with its upper triangle.
    """

    controller: Controller
    certificate: Certificate
    solve_seconds: float
    proof_seconds: float
    variables: int
    rows: int


def design(specification: Specification, parameters: ArmParameters | None = None, *, explain: bool = True) -> Design:
    """Return a controller for a specification; it is proven from its stored gains, whatever the solver's status says.

    Args:
        specification: the requirements.
        parameters: the arm, by default that of Table 1.
        explain: whether to find the requirement to relax if no solution is found, which takes many more solves.

    Raises:
        DesignFailed: no provable point was found.
    """
    given, begin = instance("specification", specification, Specification), time.perf_counter()
    arm = ArmParameters() if parameters is None else instance("parameters", parameters, ArmParameters)
    best = best_point(given, arm)
    if isinstance(best, NoPoint):
        raise DesignFailed(why_infeasible(given, arm) if explain else str(best), best.problem, best.result)
    return _proven(TSModel(arm, given.kept), given, best, time.perf_counter() - begin)


def solved(problem: DesignProblem, solver: str, options: dict[str, Any]) -> Design:
    """Solve a problem that the user may have changed, and return the proven design; see `DesignProblem.solve`."""
    installed = cp.installed_solvers()
    if solver not in installed:
        raise ValueError(f"solver = {shown(solver)} is not installed; installed: {listed(installed)}")
    asked, model, begin = problem.specification, problem.model, time.perf_counter()
    objective, constraints = problem.written
    own = [one for one in problem.constraints if not any(one is other for other in constraints)]
    try:
        point = problem.point(solver, **options)
    except NoPoint as error:
        missed = f"; its last point misses the inequalities by {-error.margin:.2g}" if np.isfinite(error.margin) else ""
        if isinstance(best_point(asked, model.parameters), NoPoint):
            advice = why_infeasible(asked, model.parameters)
        else:
            relax = f"relax the added constraints ({len(own)}), or " if own else ""
            tried = "try tighter tolerances, another solver or another scale"
            advice = f"the specification alone has a solution: {relax}{tried}"
        message = f"{solver} found no feasible point ({error.status}{missed}); {advice}"
        raise DesignFailed(message, problem, error.result) from error
    changed = own or problem.objective is not objective or len(problem.constraints) < len(constraints)
    words = "a user's own problem" if changed else None
    return _proven(model, asked, point, time.perf_counter() - begin, words, "cvxpy", problem)


def _proven(
    model: TSModel,
    specification: Specification,
    point: Point,
    solve_seconds: float,
    objective: str | None = None,
    package: str = "clarabel",
    problem: DesignProblem | None = None,
) -> Design:
    """Return the proven design of a `point`; DesignFailed says by how much the proof fails, and contains `problem`.

    `solve_seconds` [s] becomes part of the design; the other arguments are those of `to_controller`.
    """
    begin = time.perf_counter()
    try:
        controller = to_controller(model, specification, point, objective, package)
    except (ControllerFileError, np.linalg.LinAlgError) as error:
        message = f"no controller follows from the solver's point ({point.status}): {error}"
        raise DesignFailed(message, problem, point) from error
    certificate = certify(controller)
    if certificate.proven:
        seconds = time.perf_counter() - begin
        return Design(controller, certificate, solve_seconds, seconds, point.variables, point.rows)
    failed = [claim for claim in certificate.claims if not claim.proven]
    worst = min(failed, key=lambda claim: claim.proof_margin)
    far = f"fails by {-worst.proof_margin:.2g} (smallest eigenvalue at unit diagonal)"
    if not np.isfinite(worst.proof_margin):
        far = "has a diagonal entry of the wrong sign"
    message = (
        f"the solver's point ({point.status}) does not pass the proof: {len(failed)} of {len(certificate.claims)} "
        f"inequalities fail, and the worst, {worst.name}, {far}; try tighter tolerances, another solver, a larger "
        "gamma or a smaller alpha"
    )
    raise DesignFailed(message, problem, certificate)


def to_controller(
    model: TSModel, specification: Specification, point: Point, objective: str | None = None, package: str = "clarabel"
) -> Controller:
    """Return the controller of a feasible point of the inequalities, not yet proven.

    `objective` states in words what was minimised (None: the objective of the specification); the version of `package`
    is recorded.
    """
    P, M, paper = 0.5 * (point.P + point.P.T), point.M, specification.form == "paper"
    n_e = M.shape[-1]
    Q, X, tau = point.slack[0]
    pole_Q, pole_X, pole_tau = point.slack[1] if len(point.slack) > 1 else (None, None, None)
    share = specification.feedforward
    words = "L left to the solver" if share is None else f"L = {share:g} times that of the consistent form"
    return Controller(
        model=model,
        form=specification.form,
        integral=specification.integral,
        alpha=point.alpha,
        gamma=point.gamma,
        weight=np.array(PAPER_WEIGHT) if paper else None,
        common_multiplier=specification.common_multiplier,
        gains=np.linalg.solve(P[:n_e, :n_e], np.swapaxes(M, -1, -2)).swapaxes(-1, -2),
        feedforward=point.L if paper else None,
        P=P,
        Q=Q,
        X=X,
        tau=tau,
        origin={
            "objective": objective or specification.objective,
            "status": point.status,
            **({"feedforward": words} if paper else {}),
            **{name: version(name) for name in ("fuzzyarm", package)},
        },
        fastest_pole=specification.fastest_pole,
        pole_Q=pole_Q,
        pole_X=pole_X,
        pole_tau=pole_tau,
    )


def describe(result: Design) -> str:
    """Return a readable description of the solved problem and the controller."""
    controller, certificate = result.controller, result.certificate
    model = controller.model
    dropped = [name for u in model.uncertainties for name in u.premises]
    multipliers = "one multiplier for all of A" if controller.common_multiplier else "one multiplier each"
    pole = "" if controller.fastest_pole is None else f"fastest pole {at_most(controller.fastest_pole, 6)} 1/s, "
    names = ["K q1", "K q2", "K dq1", "K dq2"] + (["H q1", "H q2"] if controller.integral else [])
    lines = [
        f"{model.rules} rules: kept {', '.join(model.kept) or 'none'}; as uncertainty: "
        f"{', '.join(dropped) or 'none'}, {multipliers}; {controller.form} form, "
        f"{'with' if controller.integral else 'without'} integral",
        f"alpha = {at_least(controller.alpha, 6)} 1/s, gamma = {at_most(controller.gamma, 4)}, {pole}"
        f"{controller.origin['objective']}; {result.variables} variables, {result.rows} cone rows, solved in "
        f"{result.solve_seconds:.2f} s",
        f"all {len(certificate.claims)} inequalities proven in exact rational arithmetic from the stored gains in "
        f"{result.proof_seconds:.2f} s, smallest margin {certificate.proof_margin:.2g}",
        "",
        "gains [N m/rad, N m s/rad, N m/(rad s)]:",
        "vertex  torque " + "".join(f"{name:>13}" for name in names),
    ]
    for i, per_k in enumerate(controller.gains):
        for k, gain in enumerate(per_k):
            for joint in range(JOINTS):
                head = f"i={i + 1} k={k + 1}   {joint + 1}     " if joint == 0 else f"           {joint + 1}     "
                lines.append(head + "".join(f" {value:12.1f}" for value in gain[joint]))
    return "\n".join([*lines, "", certificate.statement])
