"""The design problem that `design` solves, open to constraints and objectives of a user's own, in cvxpy.

One such constraint says where the poles of the frozen rigid loop lie. A region of the complex plane is the set of z
with R + z S + z* Sᵀ < 0, for R symmetric and S of the same size s: a half plane to the left of -α (R = 2α, S = 1), a
sector |Im z| < -t Re z (R = 0, S = [[t, 1], [-1, t]]), a disc of radius r about -q (R = [[-r, q], [q, -r]], S = [[0,
1], [0, 0]]). With F_ijk = A_i P + B M_jk, ⊗ the Kronecker product, slack Q, X and symmetric multipliers Θ_l of its own,
every pole of every frozen loop lies in it if Π_iik < 0 and Π_ijk + Π_jik < 0 for i < j and all k, where

            | R⊗P + He((S⊗I) Q_ij)                     ⋆                                  ⋆    |
    Π_ijk = | I⊗F_ijk - (I⊗E_k) Q_ij + X_ijᵀ (S⊗I)ᵀ    -He((I⊗E_k) X_ij) + Σ Θ_l⊗H_lᵀH_l  ⋆    |
            | I⊗W_l P  or  -(I⊗W_l) Q_ij               0  or  -(I⊗W_l) X_ij               -Θ_l⊗I|

For s = 1 this is the inequality of the decay rate, `error_psi`, without its rows d and z. Multiplied by
[I, (S⊗I)(I⊗E)⁻¹, ...] from the left and its transpose from the right, X drops out and R⊗P + He(S⊗(E⁻¹F)) is left:
the condition of Chilali and Gahinet (1996) for E⁻¹F P⁻¹.
"""

from __future__ import annotations

import time
from typing import Any

import cvxpy as cp
import numpy as np

from fuzzyarm.common.checks import finite_array, instance, listed, real, shown, whole
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.fuzzy_policy.states import PLANT
from fuzzyarm.proof.block_matrix import Assembly, he, identity, symmetric, transposed
from fuzzyarm.proof.certificate import Certificate, certify
from fuzzyarm.proof.vertices import Index, Vertices
from fuzzyarm.synthesis.designer import Design, DesignFailed, to_controller
from fuzzyarm.synthesis.expressions import half, negative, positive
from fuzzyarm.synthesis.inequalities import MARGIN, Inequalities, NoPoint
from fuzzyarm.synthesis.search import best_point, why_infeasible
from fuzzyarm.synthesis.specification import Specification

__all__ = ["DesignProblem", "pi"]


def pi(
    data: Vertices,
    i: Index,
    k: Index,
    *,
    R: np.ndarray,
    S: np.ndarray,
    P: Any,
    M: Any,
    Q: Any,
    X: Any,
    theta: Any,
    put: Assembly = symmetric,
) -> Any:
    """Return Π_ijk (..., rows, rows), symmetric and affine in P, M, Q, X and Θ, of numbers or of cvxpy's expressions.

    The vertices are of the consistent form, n = 4 or, with the integral, 6; with arrays of i and k, from 0, the result
    is a stack, as in `theorems.error_psi`. R [1/s] and S are (s, s), P is (n, n), M_jk (..., 2, n), Q_ij and X_ij
    are (..., s n, s n), and Θ (..., m, s, s) has an entry for each of `data.uncertainties`.
    """
    one, n = identity(len(S)), data.n_e
    E, wide = np.kron(one, data.error_E(k)), np.kron(S, identity(n))
    below: list[list[Any]] = []
    corner = -he(E @ X)
    for term, uncertain in enumerate(data.uncertainties):
        scale, H = theta[..., term, :, :], data.error_rows(uncertain.H.T).T
        W = np.zeros((len(uncertain.W), n))
        W[:, PLANT] = uncertain.W
        corner = corner + _kron(scale, H.T @ H)
        wide_W = np.kron(one, W)
        left, middle = (_blocks(one, W @ P), 0) if uncertain.on == "A" else (-wide_W @ Q, -wide_W @ X)
        below.append([left, middle, *[0] * len(below), -_kron(scale, identity(len(H)))])
    F = data.error_A(i) @ P + data.error_rows(data.B) @ M
    side = _blocks(one, F) - E @ Q + transposed(X) @ wide.T
    return put([[_blocks(R, P) + he(wide @ Q)], [side, corner], *below])


def _blocks(numbers: np.ndarray, matrix: Any) -> Any:
    """Return `numbers` ⊗ Y (..., s r, s c) for numbers (s, s) and Y (..., r, c)."""
    units, (r, c) = identity(len(numbers)), matrix.shape[-2:]
    return sum(
        np.kron(units[:, [a]], identity(r)) @ matrix @ (numbers[a, b] * np.kron(units[[b]], identity(c)))
        for a, b in np.argwhere(numbers)
    )


def _kron(matrix: Any, numbers: np.ndarray) -> Any:
    """Return Y ⊗ `numbers` (..., s r, s r) for Y (..., s, s) and numbers (r, r)."""
    size, r = matrix.shape[-1], len(numbers)
    left = [np.kron(identity(size), identity(r)[:, [a]]) for a in range(r)]
    return sum((numbers[a, b] * left[a]) @ matrix @ left[b].T for a, b in np.argwhere(numbers))


class DesignProblem(Inequalities):
    """The inequalities of a specification as an open problem: add to `constraints`, assign `objective`, and `solve`."""

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

    def gain_bound(self, joint: int, state: int, bound: float) -> list[Any]:
        """Return constraints that bound one gain at every vertex, |K[joint, state]| <= bound.

        They are sufficient: m P11⁻¹ mᵀ <= bound² h and (P11⁻¹)_ss <= 1/h for the row m of M and a variable h.

        Args:
            joint: of the torque, 0 or 1.
            state: entry of ē: 0, 1 of the positions, 2, 3 of the velocities, 4, 5 of the integrals.
            bound: in [N m/rad], [N m s/rad] or [N m/(rad s)].
        """
        n_e, s = self._data.n_e, self._scaling
        joint, state = whole("joint", joint, high=JOINTS - 1), whole("state", state, high=n_e - 1)
        scaled = real("bound", bound, above=0.0) * s.state[state] / s.torque[joint]
        h, P11, unit = cp.Variable(nonneg=True), self._P[:n_e, :n_e], np.eye(n_e)[state]
        m = self._gains[:, joint : joint + 1]
        return [P11 >> h * np.outer(unit, unit), positive(half([[scaled**2 * h * np.eye(1)], [transposed(m), P11]]))]

    def pole_region(self, R: Any, S: Any) -> list[Any]:
        """Return constraints that put the poles z of every frozen loop where R + z S + z* Sᵀ < 0, see the module.

        The proof of a controller file does not cover them: it proves α, γ and the fastest pole.

        Args:
            R: (s, s), symmetric [1/s].
            S: (s, s), without unit.
        """
        size, n, m = len(np.atleast_2d(np.asarray(S))), self._data.n_e, len(self._data.uncertainties)
        R, S = finite_array("R", R, (size, size), "1/s"), finite_array("S", S, (size, size))
        if self.specification.form != "consistent" or not np.array_equal(R, R.T):
            raise ValueError("a pole region needs the consistent form and a symmetric R")
        rows, pairs, unit = len(self._pair), len(self.pairs), self._units
        Q, X = (
            cp.multiply(np.tile(unit[name], (size, size)), cp.Variable((pairs, size * n, size * n))) for name in "QX"
        )
        theta: Any = np.zeros((rows, 0, size, size))
        if m:
            free = cp.Variable((rows, m, size, size))
            theta = cp.multiply(0.5 * unit["tau"][:, np.newaxis, np.newaxis], free + transposed(free))
        P, M = cp.multiply(unit["P"], self._P), cp.multiply(unit["M"], self._mean_of(self._M))
        slack = {"Q": Q[self._pair], "X": X[self._pair], "theta": theta}
        found = pi(self._midpoints, self._pair, self._k, R=R, S=S, P=P, M=M, **slack, put=half)
        ends = np.cumsum([n, n, *(len(term.H) for term in self._data.uncertainties)])[:-1]
        row = np.concatenate([np.tile(part, size) for part in np.split(self._row_units("Phi"), ends)])
        return [negative(cp.multiply(np.outer(row, row), found), MARGIN)]

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
        try:
            point = self.point(solver, **options)
        except NoPoint as error:
            raise DesignFailed(self._why(error, solver), self, error.result) from error
        solve_seconds = time.perf_counter() - begin
        begin = time.perf_counter()
        objective, constraints = self._of_specification
        changed = self.objective is not objective or len(self._own()) > 0
        words = "a user's own problem" if changed or len(self.constraints) < len(constraints) else None
        try:
            controller = to_controller(self.model, self.specification, point, words, "cvxpy")
        except (ControllerFileError, np.linalg.LinAlgError) as error:
            raise DesignFailed(
                f"the point of {solver} ({point.status}) is no controller: {error}", self, point
            ) from error
        certificate = certify(controller)
        if not certificate.proven:
            raise DesignFailed(_refused(certificate, point.status), self, certificate)
        return Design(controller, certificate, solve_seconds, time.perf_counter() - begin, point.variables, point.rows)

    def _own(self) -> list[Any]:
        """Return the constraints that were added to the specification's."""
        return [one for one in self.constraints if not any(one is other for other in self._of_specification[1])]

    def _why(self, error: NoPoint, solver: str) -> str:
        """Return why there is no point: the specification itself, what was added to it, or the solver."""
        if error.result is None:
            report = f"{solver} found no point: {error.status}"
        elif np.isfinite(error.margin):
            report = (
                f"{solver} ended with {error.status} at a point that misses the inequalities by {-error.margin:.2g}"
            )
        else:
            report = f"{solver} ended with {error.status}"
        if isinstance(best_point(self.specification, self.model.parameters), NoPoint):
            return f"{report}; {why_infeasible(self.specification, self.model.parameters)}"
        own = len(self._own())
        relax = f"the specification alone has a solution, so relax the {own} constraints added to it, or try "
        tried = "tighter tolerances, another solver or another scale"
        return f"{report}: {relax}{tried}" if own else f"{report}, but the specification has a solution: try {tried}"


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
