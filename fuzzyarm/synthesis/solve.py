"""From a specification to a checked controller."""

from __future__ import annotations

import dataclasses
import math
from importlib.metadata import version

import cvxpy as cp
import numpy as np
from scipy.optimize import minimize_scalar

from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.certificate import Certificate, certify
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.inequality import error_model
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES, TSModel
from fuzzyarm.synthesis.consistent_reference import DesignProblem, build
from fuzzyarm.synthesis.scaling import Scaling

MARGIN = 1e-4  # strictness of the scaled inequalities; the solver's tolerance may not eat it up
TOLERANCE = 1e-7
LYAPUNOV_RANGE = (-4.0, 1.0)  # log10 of the scale c of V that the search covers, relative to the first guess


class DesignFailed(ValueError):
    """No controller that passes its own check was found; carries the specification in its message."""


@dataclasses.dataclass(frozen=True)
class Specification:
    """What is asked of a design.

    Attributes:
        kept: premises kept as fuzzy rules.
        alpha: decay rate [1/s]; the paper's is 20.
        gamma: bound of the L2 gain from d to the position error [rad/(N m)].
        integral: whether to feed back the integral of the position error (Remark 2).
    """

    kept: tuple[str, ...] = NAMED_RULES[4]
    alpha: float = 20.0
    gamma: float = 2e-4
    integral: bool = True

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, unit in (("alpha", "1/s"), ("gamma", "rad/(N m)")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value} {unit} is out of range; allowed: (0, inf) {unit}")


def design(specification: Specification, parameters: ArmParameters | None = None) -> tuple[Controller, Certificate]:
    """Return the controller with the smallest bound on its scaled gains, and its certificate.

    The scale c of the Lyapunov function cannot be a variable of the semidefinite program (γ ties it to P); a bounded
    scalar search over it wraps the program. The result is checked from its stored gains, never from the
    solver's status.

    Raises:
        DesignFailed: no point of the search gave a controller that passes the check.
    """
    parameters = parameters or ArmParameters()
    model = TSModel(parameters, specification.kept)
    found: list[tuple[float, Controller, Certificate]] = []

    def bound(log_scale: float) -> float:
        candidate = _solve(model, specification, 10.0**log_scale)
        if candidate is None:
            return math.inf
        found.append(candidate)
        return candidate[0]

    first_guess = math.log10(_natural_scale(model, specification))
    low, high = (first_guess + offset for offset in LYAPUNOV_RANGE)
    # A coarse scan finds the feasible stretch, the bounded search refines inside it.
    grid = np.linspace(low, high, 11)
    values = [bound(point) for point in grid]
    best = int(np.argmin(values))
    if not math.isfinite(values[best]):
        raise DesignFailed(
            f"no feasible controller found for {model.rules} rules (kept: {', '.join(model.kept) or 'none'}), "
            f"alpha = {specification.alpha:g} 1/s, gamma = {specification.gamma:g} rad/(N m): "
            "lower alpha or raise gamma"
        )
    bracket = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    minimize_scalar(lambda point: min(bound(point), 1e12), bounds=bracket, method="bounded", options={"xatol": 0.02})
    _, controller, certificate = min(found, key=lambda entry: entry[0])
    return controller, certificate


def _natural_scale(model: TSModel, specification: Specification) -> float:
    """Return the scale c at which the scaled inequality has a unit γ block: σ / (γ U)²."""
    scaling = Scaling.of(error_model(model, specification.integral), model.parameters, 1.0)
    return float(scaling.time / (specification.gamma * scaling.torque.mean()) ** 2)


def _solve(model: TSModel, specification: Specification, scale: float) -> tuple[float, Controller, Certificate] | None:
    """Return (bound on the scaled gains, controller, certificate) at Lyapunov scale c, or None."""
    native = error_model(model, specification.integral)
    scaling = Scaling.of(native, model.parameters, scale)
    system = scaling.apply(native)
    design_problem = build(system, alpha=specification.alpha / scaling.time, gamma=specification.gamma, margin=MARGIN)
    try:
        design_problem.problem.solve(
            solver=cp.CLARABEL, tol_gap_abs=TOLERANCE, tol_gap_rel=TOLERANCE, tol_feas=TOLERANCE, max_iter=100
        )
    except cp.SolverError:
        return None
    if design_problem.P.value is None:
        return None
    controller = _controller(model, specification, scaling, design_problem)
    certificate = certify(controller)
    if not certificate.holds:
        return None
    # The bound is recomputed from the gains: the solver's number may be a little off.
    scaled_gains = controller.gains * scaling.state / scaling.torque[:, np.newaxis]
    return float(np.linalg.norm(scaled_gains, ord=2, axis=(-2, -1)).max()), controller, certificate


def _controller(model: TSModel, specification: Specification, scaling: Scaling, solved: DesignProblem) -> Controller:
    N, N_e = len(model.A_vertices), len(model.E_vertices)
    pairs = list(solved.Q)
    P, M, Q, X, tau = scaling.restore(
        solved.P.value,
        np.array([[solved.M[j, k].value for k in range(N_e)] for j in range(N)]),
        np.array([solved.Q[pair].value for pair in pairs]),
        np.array([solved.X[pair].value for pair in pairs]),
        np.array([[solved.tau[pair, k].value for k in range(N_e)] for pair in pairs]).reshape(len(pairs), N_e, -1),
    )
    P = 0.5 * (P + P.T)
    return Controller(
        model=model,
        integral=specification.integral,
        alpha=specification.alpha,
        gamma=specification.gamma,
        gains=np.linalg.solve(P, np.swapaxes(M, -1, -2)).swapaxes(-1, -2),
        P=P,
        Q=Q,
        X=X,
        tau=tau,
        origin={
            "form": "consistent reference, one multiplier per dropped premise",
            "objective": "smallest bound on the scaled gains",
            "fuzzyarm": version("fuzzyarm"),
            "cvxpy": version("cvxpy"),
            "clarabel": version("clarabel"),
        },
    )


def describe(controller: Controller, certificate: Certificate) -> str:
    """Return what was solved and what came out, for a person."""
    model = controller.model
    kept, dropped = ", ".join(model.kept) or "none", ", ".join(u.premise for u in model.uncertainties) or "none"
    names = ["K q1", "K q2", "K dq1", "K dq2"] + (["H q1", "H q2"] if controller.integral else [])
    lines = [
        f"{model.rules} rules: kept {kept}; as uncertainty: {dropped}; {controller.origin['form']}",
        f"alpha = {controller.alpha:g} 1/s, gamma = {controller.gamma:g} rad/(N m), {controller.origin['objective']}",
        f"{len(certificate.margins)} inequalities recomputed from the stored gains, "
        f"smallest margin {certificate.margin:.2g} (eigenvalue, unit diagonal, double precision)",
        "",
        "gains [N m/rad, N m s/rad, N m/(rad s)]:",
        "vertex  torque " + "".join(f"{name:>12}" for name in names),
    ]
    for i, per_k in enumerate(controller.gains):
        for k, gain in enumerate(per_k):
            for joint in range(2):
                head = f"i={i + 1} k={k + 1}   {joint + 1}     " if joint == 0 else f"           {joint + 1}     "
                lines.append(head + "".join(f"{value:12.1f}" for value in gain[joint]))
    return "\n".join([*lines, "", certificate.statement])
