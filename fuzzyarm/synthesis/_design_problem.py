"""The design problem: the proof's inequalities on cvxpy expressions, and the point returned by a solver.

    minimise g or γ²:   P11 >= f I,   [[g I, M_jk], [M_jkᵀ, P11]] >= 0,   (Ψ_ijk + Ψ_jik)/2 <= -μ I,   likewise Φ

in the units of `Scaling`, as stacks for all i <= j and k (`Vertices.midpoints`). So |K_jk| = |M_jk P11⁻¹| <= √(g/f). If
γ is given and the gains are minimised, f = 1; if the gains are bounded, f > 0 is a variable and g = bound² f.

*Unit of P.* With P = c P̂, M = c M̂, ..., Ψ is congruent to c times Ψ at P̂, M̂, ..., c^(1/2) z and c γ². The
unit c is a parameter, like α, β and the bound on the gains, so one compiled problem serves all designs of a structure.

*Rows that no vertex changes.* In E_k ẋ = A_i x + B u + B d, only the rows b, those of q̇, depend on a vertex or on the
torques; the other rows, a, are ẋ_a = N x + D_a w. Let S_a and S_b be the columns a and b of the identity. Adding
S_a S_aᵀ times the rows of ẋ to the rows of x makes the rows ẋ_a redundant, and most of the slack, too: Q = S_b Q_b and
X = S_b X_b S_bᵀ remain. The rows x, ẋ_b, w, z and uncertainties are negative definite for some Q_b and X_b if and only
if Ψ is negative definite for some Q and X and the same P, M, L, τ. `_expanded` returns such Q and X.
"""

from __future__ import annotations

import dataclasses
import math
import time
import types
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import cvxpy as cp
import numpy as np

from fuzzyarm.common.arithmetic import consecutive, last_that_works
from fuzzyarm.common.checks import finite_array, instance, real, whole
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, consistent_feedforward
from fuzzyarm.fuzzy_policy.ts_model import VELOCITY, TSModel
from fuzzyarm.proof import _theorems as theorems
from fuzzyarm.proof.block_matrix import Assembly, symmetric, transposed
from fuzzyarm.proof.vertices import TrackingVertices, error_vertices, tracking_vertices
from fuzzyarm.synthesis._expressions import half, negative, positive
from fuzzyarm.synthesis._pole_region import pi
from fuzzyarm.synthesis._scaling import Scaling
from fuzzyarm.synthesis.specification import PAPER_WEIGHT, Specification

if TYPE_CHECKING:
    from fuzzyarm.synthesis._designer import Design

__all__ = ["CERTAIN", "PAPER_GAMMA", "DesignProblem", "NoPoint", "Point", "structure_of"]

_MARGIN = 1e-4  # μ, far above the rounding errors of the solver
_TOLERANCE = 0.01  # solver tolerance as a share of the margin: the solver's error stays far below the margin
# More threads are slower; the decomposition that keeps overlapping cliques apart has 40 % of the compact one's fill.
CLARABEL = {
    **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), _TOLERANCE * _MARGIN),
    "direct_solve_method": "faer",
    "max_threads": 1,
    "chordal_decomposition_compact": False,
}
CERTAIN = "PrimalInfeasible"
"""The solver's status if it has proven, to its full accuracy, that there is no point."""
_INFEASIBLE = (CERTAIN, "AlmostPrimalInfeasible")

# γ ties the unit c to P. In the consistent form c is proportional to σ/(γU)²; the factor 0.37 gives the smallest
# gains with z1 kept, 0.6 with z1 dropped (α = 20, γ = 2e-4). In the paper's form 1e-4 at γ = 1000 suits every model.
_BEST_SCALE = {True: 0.37, False: 0.6}
_PAPER_SCALE, PAPER_GAMMA = 1e-4, 1000.0
_ALPHA_RESOLUTION = 0.01  # relative resolution of the largest decay rate
_DUST = 1e-9  # relative size below which an entry of P or M is zero within the solver's accuracy


class NoPoint(ValueError):
    """No strictly feasible point was found; the message says what to relax.

    Attributes:
        problem: the `DesignProblem`, with the solver's last values.
        status: reported by the solver.
        margin: margin of the solver's last point, not positive; -inf without a point.
        result: the solver's result; None if it raised an error.
        program: the cone program that cvxpy passes to the solver, b - A x in the cones `dims`.
        ray: z (rows,) in the cones with Aᵀz = 0 and bᵀz < 0, if the solver claims that there is no point, else None.
    """

    def __init__(
        self, problem: DesignProblem, status: str, margin: float, result: Any = None, program: Any = None
    ) -> None:
        self.problem, self.status, self.margin, self.result, self.program = problem, status, margin, result, program
        self.ray = np.array(result.z) if result is not None and status in _INFEASIBLE else None
        found = "a proof that there is none" if self.ray is not None else f"a point with margin {margin:.2g}"
        super().__init__(
            f"no strictly feasible point was found: the solver ended with {status} and {found}; lower alpha, or raise "
            "gamma, the gain bound or fastest_pole"
        )


@dataclasses.dataclass(frozen=True)
class Point:
    """A strictly feasible point of the full inequalities, in SI units; shapes and symbols as in `Controller`."""

    alpha: float  # α [1/s]
    gamma: float  # γ, given or found
    P: np.ndarray  # (n, n)
    M: np.ndarray  # (N, N_e, 2, n_e)
    L: np.ndarray  # (N, N_e, 2, 6); empty in the consistent form
    # (Q, X, τ) of Ψ and, with a fastest pole, of Φ: (p, n, n), (p, n, n) and (p, N_e, m)
    slack: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    margin: float  # recomputed from these values; the inequalities are <= -margin I in the units of `Scaling`
    largest_gain: float  # largest |K_jk| in these units
    objective: float  # reported by the solver: g, or γ² in units, or 0
    status: str  # reported by the solver
    variables: int  # scalar variables of the cone program
    rows: int  # rows of its cones; a matrix counts with its upper triangle
    compile_seconds: float  # time to write and compile the problem, or to change its parameters [s]
    solve_seconds: float  # time of the solver and of recomputing the margin [s]


class _Slack(NamedTuple):  # variables of Ψ or Φ, in units
    Q: Any  # Q_b (p, 2, n)
    X: Any  # X_b (p, 2, 2)
    tau: Any  # (p N_e, m)


def structure_of(specification: Specification) -> Specification:
    """Return the specification with each given limit replaced by a fixed number; equal results can share a problem."""
    values = {"alpha": 1.0, "gamma": 1.0, "gain_bound": 1.0, "fastest_pole": 2.0}
    given: dict[str, Any] = {name: one for name, one in values.items() if getattr(specification, name) is not None}
    return dataclasses.replace(specification, **given)


class DesignProblem:
    """The inequalities of a specification as an open problem: add `constraints`, assign `objective`, and `solve`.

    Vertices i, j of A and k of E count from 0; pairs are sorted by i, then j. n, n_e, N, N_e, p, m are those of
    `Controller`. P, M, L, Q, X, τ and γ² are affine expressions in SI units.

    Attributes:
        specification: the requirements.
        model: the T-S model.
        pairs: the p pairs (i, j) with i <= j.
        alpha: decay rate [1/s], a cvxpy parameter: assign its `value` to solve again at another rate.
        L: (N, N_e, 2, 6) in the paper's form, empty in the consistent one.
        inequalities: inequalities of the theorems by name; "Psi" and "Phi" are stacks (p N_e, rows, rows), k fastest.
        floor: f in P11 >= f I, dimensionless.
        constraints: list of all constraints, to which more can be added.
        objective: the objective, a `cvxpy.Minimize`, which can be replaced.
        written: the objective and the constraints of the specification.
    """

    def __init__(
        self,
        specification: Specification,
        parameters: ArmParameters | None = None,
        scale: float = 1.0,
        *,
        vertex: int | None = None,
    ) -> None:
        """State the problem without solving it.

        Args:
            specification: the requirements; whichever of gamma and gain_bound is None is minimised.
            parameters: the arm, by default that of Table 1.
            scale: size of P relative to a value that suits most designs; it matters only if the gains are minimised.
            vertex: the only vertex of A in the inequalities, which then give no controller; None for all vertices.
        """
        given = self.specification = instance("specification", specification, Specification)
        arm = ArmParameters() if parameters is None else instance("parameters", parameters, ArmParameters)
        self.model, common = TSModel(arm, given.kept), given.common_multiplier
        data = (
            error_vertices(self.model, given.integral, common_multiplier=common)
            if given.form == "consistent"
            else tracking_vertices(self.model, given.integral, np.array(PAPER_WEIGHT), common_multiplier=common)
        )
        chosen = slice(None)
        if vertex is not None:
            chosen = slice(whole("vertex", vertex, high=len(data.A) - 1), vertex + 1)
        self._data = dataclasses.replace(data, A=data.A[chosen])
        self._midpoints, self.pairs = self._data.midpoints(), self._data.pairs
        self._scaling = Scaling.of(self._data, arm)
        self._pair, self._k = (at.ravel() for at in np.indices((len(self.pairs), len(data.E))))
        self._i, self._j = np.array(self.pairs)[self._pair].T
        self._write_variables(given, chosen)
        self._write_inequalities(given)
        self.ask(given, real("scale", scale, low=GAINS[0], high=GAINS[1]))

    def ask(self, specification: Specification, scale: float = 1.0) -> None:
        """Set the parameters for another specification with the same `structure_of`; `scale` multiplies P's unit."""
        given, s = specification, self._scaling
        self.specification, self._c = given, scale * _natural(given, s)
        self.alpha.value, self._root_c.value = given.first_alpha, math.sqrt(self._c)
        if given.gamma is not None:
            self._gamma2.value = self._c * given.gamma**2
        if given.gain_bound is not None:
            self._bound2.value = (given.gain_bound / s.stiffness) ** 2
        if given.fastest_pole is not None:
            self._fastest_pole.value = given.fastest_pole

    # The variables, in units and in SI units -------------------------------------------------------------------------

    def _write_variables(self, given: Specification, chosen: slice) -> None:
        s, data, T = self._scaling, self._data, self._scaling.state
        n, n_e, vertices = len(T), data.n_e, (len(data.A), len(data.E))
        self._units = {
            "P": np.outer(T, T),
            "M": np.outer(s.torque, T[:n_e]),
            "Q": s.time * np.outer(T, T),
            "X": np.outer(T, 1.0 / s.row),
            "tau": s.uncertainty**2 / s.time,
        }
        blocks = [cp.Variable((size, size), symmetric=True) for size in ((n_e,) if n == n_e else (n_e, n - n_e))]
        off = np.zeros((n_e, n - n_e))
        self._P = blocks[0] if n == n_e else cp.bmat([[blocks[0], off], [off.T, blocks[1]]])
        self._M = cp.Variable((*vertices, JOINTS, n_e))
        self.L: Any = np.zeros((*vertices, JOINTS, 0))
        if given.form == "paper":
            consistent = consistent_feedforward(self.model)[chosen]
            unit = s.torque[:, np.newaxis] / s.disturbance[-consistent.shape[-1] :]
            free = given.feedforward is None
            self.L = cp.multiply(unit, cp.Variable(consistent.shape)) if free else given.feedforward * consistent
        p, rows, m = len(self.pairs), len(self._pair), len(s.uncertainty)
        self._slack = [
            _Slack(
                cp.Variable((p, JOINTS, n)),
                cp.Variable((p, JOINTS, JOINTS)),
                cp.Variable((rows, m)) if m else np.zeros((rows, 0)),
            )
            for _ in range(1 if given.fastest_pole is None else 2)
        ]
        self.alpha = cp.Parameter(nonneg=True, name="alpha")
        self._root_c = cp.Parameter(nonneg=True, name="square root of c")
        self._fastest_pole, self._bound2 = cp.Parameter(nonneg=True), cp.Parameter(nonneg=True)
        self._gamma2_unit = s.time / float((s.disturbance**2).max())  # the unit in which c γ² is of order one
        self._gamma2 = cp.Parameter(nonneg=True) if given.gamma else self._gamma2_unit * cp.Variable(nonneg=True)
        bounded = given.gain_bound is not None
        self.floor = cp.Variable() if bounded else cp.Constant(1.0)
        self._g = self._bound2 * self.floor if bounded else cp.Variable()

    @property
    def P(self) -> Any:
        """The matrix P (n, n) in SI units as a cvxpy expression, block diagonal."""
        return cp.multiply(self._c * self._units["P"], self._P)

    @property
    def M(self) -> Any:
        """The matrices M_jk (N, N_e, 2, n_e) in SI units as a cvxpy expression."""
        return cp.multiply(self._c * self._units["M"], self._M)

    @property
    def gamma2(self) -> Any:
        """γ² as a cvxpy expression, constant if γ is given; in the form "consistent" its unit is (rad/(N m))²."""
        given = self.specification.gamma
        return cp.Constant(given**2) if given else self._gamma2 / self._c

    # The inequalities ------------------------------------------------------------------------------------------------

    def _write_inequalities(self, given: Specification) -> None:
        P11, f = self._P[: self._data.n_e, : self._data.n_e], self.floor
        self.inequalities = {"P > 0": P11 - f * np.eye(self._data.n_e) >> 0}
        for letter in ("Psi", "Phi")[: len(self._slack)]:
            U = self._reduction(letter)
            self.inequalities[letter] = negative(U @ self._matrices(letter, half, lambda entry: entry) @ U.T, _MARGIN)
        bounded = positive(half([[self._g * np.eye(JOINTS)], [transposed(self._gains), P11]]))
        self.constraints = [*self.inequalities.values(), bounded]
        minimised = 0 if given.gamma else self._gamma2 / self._gamma2_unit
        if given.gain_bound is None:
            minimised = self._g
        else:
            self.constraints.append(f >= _MARGIN)
        self.objective = cp.Minimize(minimised)
        self.written = self.objective, tuple(self.constraints)
        self._compiled: cp.Problem | None = None

    @property
    def _gains(self) -> Any:
        """M of all vertices as one stack (N N_e, 2, n_e), in the units of `Scaling`."""
        return self._M[tuple(at.ravel() for at in np.indices(self._M.shape[:2]))]

    def _mean_of(self, M: Any) -> Any:
        return 0.5 * (M[self._i, self._k] + M[self._j, self._k])

    def _matrices(self, letter: str, put: Assembly, of: Callable[[Any], Any]) -> Any:
        """Return (Ψ_ijk + Ψ_jik)/2 for all pairs i <= j and all k or, if `letter` is "Phi", (Φ_ijk + Φ_jik)/2.

        The stack (p N_e, rows, rows), p the number of pairs, is in SI units, with P, M, ... divided by c. `put`
        assembles a matrix from block rows; `of` returns a variable or parameter itself, or its value.
        """
        data, slack, unit = self._midpoints, self._slack[letter == "Phi"], self._units
        k, pair, tau, S_b = self._k, self._pair, of(slack.tau), np.eye(len(unit["P"]))[:, VELOCITY]
        values = {
            "P": _product(unit["P"], of(self._P)),
            "M": _product(unit["M"], self._mean_of(of(self._M))),
            "Q": _product(unit["Q"], (S_b @ of(slack.Q))[pair]),
            "X": _product(unit["X"], (S_b @ of(slack.X) @ S_b.T)[pair]),
            "tau": _product(unit["tau"], tau) if tau.shape[-1] else tau,
            "put": put,
        }
        if letter == "Phi":
            return theorems.error_phi(data, pair, k, fastest_pole=of(self._fastest_pole), **values)
        values |= {"alpha": of(self.alpha), "gamma2": of(self._gamma2), "output": of(self._root_c)}
        if isinstance(data, TrackingVertices):
            return theorems.tracking_psi(data, pair, k, L=self._mean_of(of(self.L)), **values)
        return theorems.error_psi(data, pair, k, **values)

    def _row_units(self, letter: str) -> np.ndarray:
        """Return factors for the rows of Ψ or, if `letter` is "Phi", Φ, by which a large γ² in the rows w becomes one.

        The solver's tolerance is relative to the largest constant. Smaller factors are strict enough: a matrix that is
        at most -μ I with them is at most -μ I with the factors `Scaling.rows`.
        """
        s, given, unit = self._scaling, self.specification, self._scaling.rows
        _, _, w, z = consecutive(len(s.state), len(s.state), len(s.disturbance), len(s.output))
        if letter == "Phi":
            return np.delete(unit, np.r_[w, z])
        if given.gamma:
            unit[w] /= np.sqrt(np.maximum(1.0, _natural(given, s) * given.gamma**2 * s.disturbance**2 / s.time))
        return unit

    def _reduction(self, letter: str) -> np.ndarray:
        """Return U such that U Ψ Uᵀ has only the rows x, ẋ_b, w, z and uncertainties, multiplied by `_row_units`.

        If `letter` is "Phi", U is for Φ, which has no rows w and z.
        """
        unit, n = self._row_units(letter), len(self._scaling.state)
        S_a = np.delete(np.eye(n), VELOCITY, axis=1)
        T = np.eye(len(unit))
        T[:n, n : 2 * n] = S_a @ S_a.T
        kept = np.delete(np.arange(len(unit)), n + np.flatnonzero(S_a.any(axis=1)))
        return np.asarray((unit[:, np.newaxis] * T)[kept])

    # A user's own constraints ----------------------------------------------------------------------------------------

    def gain_bound(self, joint: int, state: int, bound: float) -> list[Any]:
        """Return constraints that bound one gain at every vertex, |K[joint, state]| <= bound.

        They are sufficient: m P11⁻¹ mᵀ <= bound² h and (P11⁻¹)_ss <= 1/h for the row m of M and a variable h.

        Args:
            joint: joint of the torque, 0 or 1.
            state: index in ē: 0, 1 for positions, 2, 3 for velocities, 4, 5 for integrals.
            bound: bound on the gain, in [N m/rad], [N m s/rad] or [N m/(rad s)].
        """
        n_e, s = self._data.n_e, self._scaling
        joint, state = whole("joint", joint, high=JOINTS - 1), whole("state", state, high=n_e - 1)
        scaled = real("bound", bound, above=0.0) * s.state[state] / s.torque[joint]
        h, P11, unit = cp.Variable(nonneg=True), self._P[:n_e, :n_e], np.eye(n_e)[state]
        m = self._gains[:, joint : joint + 1]
        return [P11 >> h * np.outer(unit, unit), positive(half([[scaled**2 * h * np.eye(1)], [transposed(m), P11]]))]

    def pole_region(self, R: Any, S: Any) -> list[Any]:
        """Return constraints that put the poles z of every frozen loop where R + z S + z* Sᵀ < 0 (`_pole_region`).

        The proof of a controller file does not cover these: it proves α, γ and the fastest pole.

        Args:
            R: (s, s), symmetric [1/s].
            S: (s, s), without unit.
        """
        size, n, m = len(np.atleast_2d(np.asarray(S))), self._data.n_e, len(self._data.uncertainties)
        R, S = finite_array("R", R, (size, size), "1/s"), finite_array("S", S, (size, size))
        if self.specification.form != "consistent" or not np.array_equal(R, R.T):
            raise ValueError("pole_region needs a symmetric matrix R, and a specification of form 'consistent'")
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
        return [negative(cp.multiply(np.outer(row, row), found), _MARGIN)]

    # Solving ---------------------------------------------------------------------------------------------------------

    def solve(self, solver: str = "CLARABEL", **options: Any) -> Design:
        """Return a controller that is proven from its stored gains, whatever the status of the solver.

        Args:
            solver: name of an installed solver for semidefinite problems.
            options: as for `cvxpy.Problem.solve`.

        Raises:
            DesignFailed: no point was found, or its proof fails.
            ValueError: the solver is not installed.
        """
        from fuzzyarm.synthesis._designer import solved  # it imports this module

        return solved(self, solver, options)

    def point(self, solver: str = cp.CLARABEL, **options: Any) -> Point:
        """Return the point of the specification, with the largest decay rate if α is not specified.

        α multiplies P, so it cannot be a variable: it is found by bisection, upwards from the attribute `alpha`.
        `options` are those of `cvxpy.Problem.solve`.

        Raises:
            NoPoint: no point was found that is strictly feasible when recomputed, whatever the status of the solver.
        """
        best, variables = self._point_at_alpha(solver, options), self._problem().variables()
        if self.specification.alpha is not None:
            return best
        values = [variable.value for variable in variables]

        def works(alpha: float) -> bool:
            nonlocal best, values
            self.alpha.value = alpha
            try:
                best, values = self._point_at_alpha(solver, options), [variable.value for variable in variables]
            except NoPoint:
                return False
            return True

        first, pole = best.alpha, self.specification.fastest_pole
        bad, limit = (2.0 * first, RATES[1]) if pole is None else (pole, None)  # no pole is faster: it bounds α, too
        last_that_works(works, first, bad, resolution=_ALPHA_RESOLUTION, limit=limit)
        self.alpha.value = best.alpha
        for variable, value in zip(variables, values, strict=True):
            variable.save_value(value)
        return best

    def _point_at_alpha(self, solver: str, options: dict[str, Any]) -> Point:
        begin = time.perf_counter()
        options = {**CLARABEL, **options} if solver == cp.CLARABEL else options
        problem = self._problem()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about an inaccurate point; the margin decides
            try:
                program, chain, inverse = problem.get_problem_data(solver, solver_opts=options, canon_backend="SCIPY")
                compiled = time.perf_counter()
                result = chain.solve_via_data(problem, program, solver_opts=options)
                status = str(result.status) if solver == cp.CLARABEL else ""
                if status in _INFEASIBLE:
                    raise NoPoint(self, status, -math.inf, result, program)
                problem.unpack_results(_where_it_ended(result) if status else result, chain, inverse)
            except cp.SolverError as error:
                raise NoPoint(self, str(error).split(". ")[0].rstrip("."), -math.inf) from error
        status = status or str(problem.status)
        if any(variable.value is None for variable in problem.variables()):
            raise NoPoint(self, status, -math.inf, result, program)
        reduced = {letter: self._reduced(letter) for letter in self.inequalities if letter != "P > 0"}
        margin = min(_smallest_eigenvalue(self._P.value), *(_smallest_eigenvalue(-R) for _, R in reduced.values()))
        if not margin > 0.0:
            raise NoPoint(self, status, margin, result, program)
        n_e = self._data.n_e
        gains = self._M.value @ np.linalg.inv(self._P.value[:n_e, :n_e])
        return Point(
            alpha=float(self.alpha.value),
            gamma=self.specification.gamma or math.sqrt(float(self.gamma2.value)),
            P=self._without_dust("P", self._P),
            M=self._without_dust("M", self._M),
            L=getattr(self.L, "value", self.L),
            slack=tuple(self._expanded(letter, *matrices) for letter, matrices in reduced.items()),
            margin=margin,
            largest_gain=float(np.linalg.norm(gains, ord=2, axis=(-2, -1)).max()),
            objective=float(problem.objective.value),
            status=status,
            variables=len(program["c"]),
            rows=program["A"].shape[0],
            compile_seconds=compiled - begin,
            solve_seconds=time.perf_counter() - compiled,
        )

    def _problem(self) -> cp.Problem:
        """Return the problem of the current objective and constraints, the compiled one if they are unchanged."""
        now = self.objective, *self.constraints
        before = self._compiled
        if before is None or [*map(id, now)] != [*map(id, (before.objective, *before.constraints))]:
            self._compiled = cp.Problem(self.objective, self.constraints)
        return self._compiled

    def _reduced(self, letter: str) -> tuple[np.ndarray, np.ndarray]:
        unit = self._row_units(letter)
        F, U = self._matrices(letter, symmetric, _value_of), self._reduction(letter)
        return unit[:, np.newaxis] * F * unit, U @ F @ U.T

    def _expanded(self, letter: str, F: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the full Q = S_b Q_b + S_a (N P - ε S_aᵀ) and X = S_b X_b S_bᵀ + ε S_a S_aᵀ, and τ, in SI units.

        After the congruence, the rows ẋ_a have the diagonal block -2εI and are coupled only to w, through D_a. They
        reduce the margin of the rows w by D_aᵀ D_a / 2ε, which is half of the margin of R < 0 there if
        ε = |D_a (-R⁻¹)_ww D_aᵀ|; a larger ε would worsen the conditioning.

        F and R are the stacks from `_reduced`.
        """
        slack, n, p, unit = self._slack[letter == "Phi"], len(self._scaling.state), len(self.pairs), self._units
        S_b, S_a = np.eye(n)[:, VELOCITY], np.delete(np.eye(n), VELOCITY, axis=1)
        w, epsilon = slice(n + JOINTS, n + JOINTS + len(self._scaling.disturbance)), np.ones((p, 1, 1))
        if letter == "Psi":
            D_a = S_a.T @ F[:, n : 2 * n, w.start + n - JOINTS : w.stop + n - JOINTS]
            cost = np.linalg.norm(D_a @ np.linalg.inv(-R)[:, w, w] @ transposed(D_a), ord=2, axis=(-2, -1))
            epsilon = np.maximum(1.0, cost.reshape(p, -1).max(axis=1))[:, np.newaxis, np.newaxis]
        NP = S_a @ S_a.T @ F[0, n : 2 * n, :n]
        Q = S_b @ slack.Q.value + NP - epsilon * (S_a @ S_a.T)
        X = S_b @ slack.X.value @ S_b.T + epsilon * (S_a @ S_a.T)
        tau = _value_of(slack.tau).reshape(p, len(self._pair) // p, len(unit["tau"]))
        return self._c * unit["Q"] * Q, self._c * unit["X"] * X, self._c * unit["tau"] * tau

    def _without_dust(self, name: str, variable: Any) -> np.ndarray:
        """Return P or M in SI units; entries that are zero within the solver's accuracy become zero."""
        value = variable.value
        return np.where(np.abs(value) < _DUST * np.abs(value).max(), 0.0, self._c * self._units[name] * value)


def _natural(given: Specification, scaling: Scaling) -> float:
    """Return the unit c of P that makes the problem of a specification well scaled, given the other units."""
    if given.form == "paper":
        return _PAPER_SCALE * (PAPER_GAMMA / (given.gamma or PAPER_GAMMA)) ** 2
    gamma = given.gamma or 1.0 / scaling.stiffness
    return float(_BEST_SCALE["z1" in given.kept] * scaling.time / (gamma * scaling.torque.mean()) ** 2)


def _product(unit: np.ndarray, values: Any) -> Any:
    """Return the entry-by-entry product of `unit` and a cvxpy expression or numbers."""
    return cp.multiply(unit, values) if isinstance(values, cp.Expression) else unit * values


def _value_of(entry: Any) -> Any:
    return getattr(entry, "value", entry)


def _smallest_eigenvalue(matrices: np.ndarray) -> float:
    """Return the smallest eigenvalue of symmetric matrices, -inf if an entry is not finite."""
    return float(np.linalg.eigvalsh(matrices).min()) if np.isfinite(matrices).all() else -math.inf


def _where_it_ended(result: Any) -> Any:
    """Return Clarabel's result with a status for which cvxpy accepts the final iterate, whatever was reported."""
    names = ("x", "z", "s", "obj_val", "obj_val_dual", "solve_time", "iterations")
    return types.SimpleNamespace(status="AlmostSolved", **{name: getattr(result, name) for name in names})
