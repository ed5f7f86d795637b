"""The design problem as an open cvxpy model: an objective, the inequalities of the theorems, and a user's own.

    minimise g or γ² subject to `inequalities`, P11 >= f I and [[g I, M_jk], [M_jkᵀ, P11]] >= 0 in units,

so that |K_jk| <= sqrt(g/f). Where γ is given and the gains are minimised f = 1, and where they are bounded f > 0 is a
variable, g = bound² f. It solves what `design` solves, from another text and more slowly.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import cvxpy as cp
import numpy as np

from fuzzyarm.common.bisection import last_that_works
from fuzzyarm.common.checks import finite_array, instance, listed, real, shown, whole
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, Controller
from fuzzyarm.fuzzy_policy.proof.block_matrix import symmetric
from fuzzyarm.fuzzy_policy.proof.certificate import Certificate, certify
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.synthesis.cvxpy_model.inequalities import Inequalities
from fuzzyarm.synthesis.cvxpy_model.pole_region import pi
from fuzzyarm.synthesis.designer import Design, DesignFailed, assembled
from fuzzyarm.synthesis.explanation import why_infeasible
from fuzzyarm.synthesis.search import best_solution
from fuzzyarm.synthesis.specification import Specification

__all__ = ["DesignProblem"]

ALPHA_RESOLUTION = 0.01  # relative, of the largest decay rate
DUST = 1e-9  # relative, of an entry of P or M that a solver means to be zero


class DesignProblem(Inequalities):
    """A design problem that is open to constraints and objectives of a user's own, in cvxpy.

    Attributes:
        constraints: all constraints, a list to add to.
        objective: what is minimised, a `cvxpy.Minimize`; assign another one.
        floor: f, a number without unit.
    """

    def __init__(
        self, specification: Specification, parameters: ArmParameters | None = None, scale: float = 1.0
    ) -> None:
        """Write the problem down; nothing is solved.

        Args:
            specification: what is asked; of gamma and gain_bound the one that is None is minimised.
            parameters: the arm, default Table 1.
            scale: size of P, relative to what suits most designs. It matters where the gains are minimised, which are
                bounded through the smallest eigenvalue of P; elsewhere it is a unit.
        """
        instance("specification", specification, Specification)
        parameters = ArmParameters() if parameters is None else instance("parameters", parameters, ArmParameters)
        super().__init__(specification, parameters, real("scale", scale, low=GAINS[0], high=GAINS[1]))
        bounded = specification.gain_bound is not None
        self.floor = cp.Variable() if bounded else cp.Constant(1.0)
        g = (self._asked.gain_bound or 0.0) ** 2 * self.floor if bounded else cp.Variable()
        n_e = self._data.n_e
        P11, f = self._P[:n_e, :n_e], self.floor
        self.constraints = [*self.inequalities.values(), P11 >> f * np.eye(n_e), f >= self._asked.margin]
        for M in self._M.values():
            self.constraints.append(symmetric([[g * np.eye(JOINTS)], [M.T, P11]], cp.bmat) >> 0)
        self._of_specification = list(self.constraints)
        minimised = {"gain_bound": g, "gamma": float(self._weight.max()) * self.gamma2, "nothing": 0}
        self.objective = self._objective = cp.Minimize(minimised[self._asked.minimise])

    def gain_bound(self, joint: int, state: int, bound: float) -> list[Any]:
        """Return constraints that bound one gain at every vertex, |K[joint, state]| <= bound.

        They are sufficient: m P11⁻¹ mᵀ <= bound² h and (P11⁻¹)_ss <= 1/h for the row m of M and a variable h.

        Args:
            joint: of the torque, 0 or 1.
            state: entry of ē: 0, 1 of the positions, 2, 3 of the velocities, 4, 5 of the integrals.
            bound: in [N m/rad], [N m s/rad] or [N m/(rad s)].
        """
        n_e = self._data.n_e
        joint, state = whole("joint", joint, high=JOINTS - 1), whole("state", state, high=n_e - 1)
        scaled = real("bound", bound, above=0.0) * self._scaling.state[state] / self._scaling.torque[joint]
        h, P11, unit = cp.Variable(nonneg=True), self._P[:n_e, :n_e], np.eye(n_e)[state]
        corner, rows = scaled**2 * h * np.eye(1), [M[joint : joint + 1] for M in self._M.values()]
        return [P11 >> h * np.outer(unit, unit), *(symmetric([[corner], [m.T, P11]], cp.bmat) >> 0 for m in rows)]

    def pole_region(self, R: Any, S: Any) -> list[Any]:
        """Return constraints that put the poles z of every frozen loop where R + z S + z* Sᵀ < 0, see `pole_region`.

        The proof of a controller file does not cover them: it proves α, γ and the fastest pole.

        Args:
            R: (s, s), symmetric [1/s].
            S: (s, s), without unit.
        """
        size = len(np.atleast_2d(np.asarray(S)))
        R, S = finite_array("R", R, (size, size), "1/s"), finite_array("S", S, (size, size))
        if self.specification.form != "consistent" or not np.array_equal(R, R.T):
            raise ValueError("a pole region needs the consistent form and a symmetric R")
        data, unit = self._data, self._row_units()[1]
        ends = np.cumsum([data.n_e, data.n_e, *(len(term.H) for term in data.uncertainties)])
        row = np.concatenate([np.tile(part, size) for part in np.split(unit, ends[:-1])])
        unit_Q, unit_X, unit_theta = self._slack_units()
        found = []
        for i, j in data.pairs:
            wide = {name: np.tile(unit, (size, size)) for name, unit in (("Q", unit_Q), ("X", unit_X))}
            slack = {name: cp.multiply(unit, cp.Variable(unit.shape)) for name, unit in wide.items()}
            for k in range(len(data.E)):
                slack["theta"] = [unit * cp.Variable((size, size), symmetric=True) for unit in unit_theta]
                both = [pi(data, a, k, R=R, S=S, P=self.P, M=self.M[b, k], **slack) for a, b in ((i, j), (j, i))]
                found.append(self._negative(0.5 * (both[0] + both[1]), row))
        return found

    def solve(self, solver: str = "CLARABEL", **options: Any) -> Design:
        """Return a controller that is proven from its stored gains, whatever the solver's status says.

        Args:
            solver: name of an installed one that takes semidefinite problems.
            options: of the solver, as `cvxpy.Problem.solve` takes them.

        Raises:
            DesignFailed: no point was found, or its proof does not go through.
            ValueError: the solver is not installed.
        """
        installed = cp.installed_solvers()
        if solver not in installed:
            raise ValueError(f"solver = {shown(solver)} is not installed; installed: {listed(installed)}")
        begin = time.perf_counter()
        problem = cp.Problem(self.objective, self.constraints)
        report = self._attempt(problem, solver, options)
        if report:
            raise DesignFailed(self._why(report))
        if self.specification.alpha is None:
            self._raise_alpha(problem, solver, options)
        solve_seconds = time.perf_counter() - begin
        begin = time.perf_counter()
        try:
            controller = self._controller(f"{solver}: {problem.status}")
        except (ControllerFileError, np.linalg.LinAlgError) as error:
            raise DesignFailed(f"the point of {solver} ({problem.status}) is no controller: {error}") from None
        certificate = certify(controller)
        if not certificate.proven:
            raise DesignFailed(_refused(certificate, controller.origin["status"]))
        variables = problem.size_metrics.num_scalar_variables
        rows = sum(constraint.size for constraint in self.constraints)
        return Design(controller, certificate, solve_seconds, time.perf_counter() - begin, variables, rows)

    def _attempt(self, problem: Any, solver: str, options: dict[str, Any]) -> str:
        """Give the variables values, good or not; return why there are none, else nothing."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that it may be inaccurate: the proof decides
            try:
                problem.solve(solver=solver, **options)
            except cp.SolverError as error:
                return f"{solver} found no point: {str(error).split('. ')[0].rstrip('.')}"
        found = problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE, cp.USER_LIMIT) and self._P.value is not None
        return "" if found else f"{solver} reports {problem.status}"

    def _raise_alpha(self, problem: Any, solver: str, options: dict[str, Any]) -> None:
        """Leave the variables at the largest α found; α multiplies P, so it is no variable."""

        def works(alpha: float) -> bool:
            self.alpha.value = alpha
            return not self._attempt(problem, solver, options) and problem.status == cp.OPTIMAL

        pole, first = self.specification.fastest_pole, float(self.alpha.value)
        bad, limit = (2.0 * first, RATES[1]) if pole is None else (pole, None)
        best = last_that_works(works, first, bad, resolution=ALPHA_RESOLUTION, limit=limit)
        if best is None or not works(best):
            raise DesignFailed(f"{solver} found no largest decay rate: bound the gains")

    def _controller(self, status: str) -> Controller:
        """Return the controller of the values that the variables have."""
        given, slack = self.specification, [(self.Q, self.X, self.tau)]
        if self.pole_Q:
            slack.append((self.pole_Q, self.pole_X, self.pole_tau))
        changed = self._own() or self.objective is not self._objective
        return assembled(
            self.model,
            given,
            alpha=float(self.alpha.value),
            gamma=given.gamma or float(np.sqrt(self.gamma2.value)),
            P=self._without_dust(self.P, self._P),
            M=self._by_vertex({at: self._without_dust(M, self._M[at]) for at, M in self.M.items()}),
            L=self._by_vertex(self.L),
            slack=[tuple(self._by_pair(group) for group in one) for one in slack],
            origin={"objective": "a user's own problem" if changed else given.objective, "status": status},
            package="cvxpy",
        )

    def _without_dust(self, variable: Any, scaled: Any) -> np.ndarray:
        """Return a value in SI units; what a solver means to be zero is zero."""
        return np.where(np.abs(scaled.value) < DUST * np.abs(scaled.value).max(), 0.0, variable.value)

    def _by_vertex(self, group: dict[Any, Any]) -> np.ndarray:
        """Return the values of M or L as (N, N_e, 2, ...); L of the consistent form is empty."""
        values = np.array([getattr(one, "value", one) for one in group.values()])
        return values.reshape(len(self._data.A), len(self._data.E), *values.shape[1:]) if group else values

    def _by_pair(self, group: dict[Any, Any]) -> np.ndarray:
        """Return the values of Q and X as (p, n, n), those of τ as (p, N_e, m)."""
        values = np.array([[x.value for x in one] if isinstance(one, list) else one.value for one in group.values()])
        return values if values.ndim == 3 else values.reshape(len(self._data.pairs), len(self._data.E), -1)

    def _own(self) -> list[Any]:
        """Return the constraints that were added to the specification's."""
        return [one for one in self.constraints if not any(one is other for other in self._of_specification)]

    def _why(self, report: str) -> str:
        """Return why there is no point: the specification itself, what was added to it, or the solver."""
        if best_solution(self.model, self.specification) is None:
            return f"{report}; {why_infeasible(self.model, self.specification)}"
        own = len(self._own())
        if own:
            return (
                f"{report}: the specification alone has a solution, so relax the {own} constraints added to it, or try "
                "another solver or another scale"
            )
        return f"{report}, but the specification has a solution: try another solver or another scale"


def _refused(certificate: Certificate, status: str) -> str:
    """Return how far a point is from its proof, and what to try."""
    failed = [claim for claim in certificate.claims if not claim.proven]
    worst = min(failed, key=lambda claim: claim.proof_margin)
    far = f"fails by {-worst.proof_margin:.2g} (smallest eigenvalue at unit diagonal)"
    if not np.isfinite(worst.proof_margin):
        far = "has a diagonal entry of the wrong sign"
    return (
        f"the point of the solver ({status}) does not pass the proof: {len(failed)} of {len(certificate.claims)} "
        f"inequalities fail, and the worst, {worst.name}, {far}; try tighter tolerances, another solver, a larger "
        "gamma or a smaller alpha"
    )
