"""The inequalities of the theorems in cvxpy's variables, in SI units.

    P > 0,    Ψ_iik < 0,    Ψ_ijk + Ψ_jik < 0 (i < j),    K_jk = M_jk P11⁻¹

Ψ is that of `theorem2` (Theorem 1 where all premises are kept) or of `consistent_reference`, which has Φ of the fastest
pole as well. The functions that the proof evaluates in rational numbers are evaluated here in cvxpy's expressions. Each
variable has a unit and each row a factor (`Scaling`), because no solver gets by in SI units; that changes no solution.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import consistent_feedforward
from fuzzyarm.fuzzy_policy.proof import consistent_reference, theorem2
from fuzzyarm.fuzzy_policy.proof.block_matrix import symmetric
from fuzzyarm.fuzzy_policy.proof.certificate import inequality_name
from fuzzyarm.fuzzy_policy.proof.vertices import TrackingVertices, error_vertices, tracking_vertices
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.synthesis.search import error_system, scaled_problem
from fuzzyarm.synthesis.specification import PAPER_WEIGHT, Specification

try:
    import cvxpy as cp
except ModuleNotFoundError as error:
    raise ModuleNotFoundError('the open design problem needs cvxpy: pip install "fuzzyarm[cvxpy]"') from error

__all__ = ["Inequalities"]


class Inequalities:
    """Variables and inequalities of a specification. Vertices i, j of A and k of E count from 0.

    n, n_e and the number of multipliers are those of `Controller`; every variable is an affine expression in SI units.

    Attributes:
        specification: what is asked.
        model: the T-S model.
        P: (n, n), block diagonal.
        M: M[j, k], (2, n_e).
        L: L[j, k], (2, 6), of the paper's form: constant unless the specification leaves it free.
        Q: Q[i, j], (n, n), slack, for i <= j.
        X: X[i, j], (n, n), likewise.
        tau: tau[i, j, k], the multipliers.
        pole_Q: Q of Φ; with `pole_X` and `pole_tau` empty where no fastest pole is asked for.
        pole_X: X of Φ.
        pole_tau: τ of Φ.
        gamma2: γ² of the L2 gain, [(rad/(N m))²] in the consistent form; constant where γ is given.
        alpha: decay rate [1/s], a cvxpy parameter: assign its `value` to solve again at another one.
        inequalities: the constraints, by the names that the certificate gives them.
    """

    def __init__(self, specification: Specification, parameters: ArmParameters, scale: float) -> None:
        """Write them down; see `DesignProblem`."""
        given = self.specification = specification
        self.model = TSModel(parameters, given.kept)
        self._scaling, scaled, self._asked = scaled_problem(self.model, given, scale)
        self._weight = np.diag(scaled.disturbance_weight)
        common = given.common_multiplier
        self._data = (
            error_vertices(self.model, given.integral, common_multiplier=common)
            if given.form == "consistent"
            else tracking_vertices(self.model, given.integral, np.array(PAPER_WEIGHT), common_multiplier=common)
        )
        self._write_variables(scaled.blocks)
        self.inequalities = self._written()

    def _write_variables(self, blocks: tuple[int, ...]) -> None:
        s, data, given = self._scaling, self._data, self.specification
        vertices = [(j, k) for j in range(len(data.A)) for k in range(len(data.E))]
        state, torque = s.state, s.torque[:, np.newaxis]
        squares = [cp.Variable((size, size), symmetric=True) for size in blocks]
        self._P = squares[0] if len(squares) == 1 else symmetric([[squares[0]], [0, squares[1]]], cp.bmat)
        self._M = {at: cp.Variable((JOINTS, data.n_e)) for at in vertices}
        self.P = cp.multiply(s.lyapunov * np.outer(state, state), self._P)
        self.M = {at: cp.multiply(s.lyapunov * torque * state[: data.n_e], M) for at, M in self._M.items()}
        self.L: dict[tuple[int, int], Any] = {}
        if given.form == "paper":
            consistent = consistent_feedforward(self.model)
            shape = consistent.shape[-2:]
            unit = torque / s.disturbance[-shape[1] :]
            free, share = given.feedforward is None, given.feedforward or 0.0
            self.L = {at: cp.multiply(unit, cp.Variable(shape)) if free else share * consistent[at] for at in vertices}
        self.Q, self.X, self.tau = self._slack()
        self.pole_Q, self.pole_X, self.pole_tau = ({}, {}, {}) if given.fastest_pole is None else self._slack()
        self.alpha = cp.Parameter(nonneg=True, value=given.first_alpha, name="alpha")
        unit_gamma2 = 1.0 / float(self._weight.max())  # in which γ² is of order one
        self.gamma2 = cp.Constant(given.gamma**2) if given.gamma else unit_gamma2 * cp.Variable(nonneg=True)

    def _slack_units(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the units of Q, X (n, n) and τ (m,)."""
        s = self._scaling
        Q, X = s.time * np.outer(s.state, s.state), np.outer(s.state, 1.0 / s.row)
        return s.lyapunov * Q, s.lyapunov * X, s.lyapunov / s.time * s.uncertainty**2

    def _slack(self) -> tuple[dict[Any, Any], dict[Any, Any], dict[Any, Any]]:
        unit_Q, unit_X, unit_tau = self._slack_units()
        pairs, K = self._data.pairs, range(len(self._data.E))
        Q = {pair: cp.multiply(unit_Q, cp.Variable(unit_Q.shape)) for pair in pairs}
        X = {pair: cp.multiply(unit_X, cp.Variable(unit_X.shape)) for pair in pairs}
        return Q, X, {(*pair, k): [unit * cp.Variable() for unit in unit_tau] for pair in pairs for k in K}

    def _written(self) -> dict[str, Any]:
        """Return P >= μ, (Ψ_ijk + Ψ_jik)/2 <= -μ and, for a fastest pole, the same of Φ, rows in units."""
        row, loop = self._row_units()
        found = {"P > 0": self._P >> self._asked.margin * np.eye(self._P.shape[0])}
        for i, j in self._data.pairs:
            for k in range(len(self._data.E)):
                both = [self._psi(a, b, k, (i, j)) for a, b in ((i, j), (j, i))]
                found[inequality_name("Psi", i, j, k)] = self._negative(0.5 * (both[0] + both[1]), row)
                if self.specification.fastest_pole is not None:
                    both = [self._phi(a, b, k, (i, j)) for a, b in ((i, j), (j, i))]
                    found[inequality_name("Phi", i, j, k)] = self._negative(0.5 * (both[0] + both[1]), loop)
        return found

    def _psi(self, i: int, j: int, k: int, pair: tuple[int, int]) -> Any:
        """Return Ψ_ijk with the slack of a pair."""
        values = {"P": self.P, "M": self.M[j, k], "Q": self.Q[pair], "X": self.X[pair], "tau": self.tau[*pair, k]}
        values |= {"alpha": self.alpha, "gamma2": self.gamma2, "block": cp.bmat}
        if isinstance(self._data, TrackingVertices):
            return theorem2.psi(self._data, i, k, L=self.L[j, k], **values)
        return consistent_reference.psi(self._data, i, k, **values)

    def _phi(self, i: int, j: int, k: int, pair: tuple[int, int]) -> Any:
        """Return Φ_ijk with the slack of a pair."""
        slack = {"Q": self.pole_Q[pair], "X": self.pole_X[pair], "tau": self.pole_tau[*pair, k]}
        values = {"fastest_pole": self.specification.fastest_pole, "P": self.P, "M": self.M[j, k], "block": cp.bmat}
        return consistent_reference.phi(self._data, i, k, **values, **slack)

    def _row_units(self) -> tuple[np.ndarray, np.ndarray]:
        """Return factors of the rows of Ψ, and of those of Φ: its rows w and z are left out."""
        system, s, given = error_system(self.model, self.specification), self._scaling, self.specification
        unit = 1.0 / (np.sqrt(s.lyapunov) * s.congruence(system))
        n, n_w, n_z = len(system.B), len(self._weight), len(system.C)
        w, z = 2 * n + np.arange(n_w), 2 * n + n_w + np.arange(n_z)
        unit[w] /= np.sqrt(np.maximum(1.0, self._weight * (given.gamma or 0.0) ** 2))
        if given.form == "paper":
            unit[z] *= np.sqrt(PAPER_WEIGHT)  # Ψ has -Q⁻¹ there
        return unit, np.delete(unit, [*w, *z])

    def _negative(self, matrix: Any, unit: np.ndarray) -> Any:
        """Return the constraint that a symmetric matrix (rows, rows) is negative definite, rows in units (rows,)."""
        return cp.multiply(np.outer(unit, unit), matrix) << -self._asked.margin * np.eye(len(unit))
