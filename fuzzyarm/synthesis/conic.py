"""The design problem as a cone program: minimise qᵀx subject to b - A x in a product of semidefinite cones.

Each matrix inequality is written once, as a function on arrays. It is affine in its own few variables, so its values at
zero and at their unit vectors determine it; these columns are scattered to the places that the variables of each pair
(i, j) and vertex k have in x. Nothing is solved here, see `minimise`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy import sparse

from fuzzyarm.common.checks import real
from fuzzyarm.synthesis.error_model import ErrorModel, reversed_time
from fuzzyarm.synthesis.reduced import ReducedModel, Variables, inequality

__all__ = ["MARGIN", "Problem", "Program", "program", "svec"]

MARGIN = 1e-4  # strictness of the inequalities, in scaled units; far above the rounding errors of the solver


@dataclasses.dataclass(frozen=True)
class Problem:
    """The requirements of a design, in the (scaled) units of the error model.

    Attributes:
        alpha: decay rate α.
        gamma: bound of the L2 gain from w to z; None where it is minimised.
        gain_bound: bound of the feedback gains; None where it is minimised, or for no bound.
        minimise: the bound that is minimised; with "nothing", any feasible point is accepted.
        bound: what `gain_bound` bounds. "K": |K_jk| <= gain_bound, from [[gI, M], [Mᵀ, P11]] >= 0 with
            gain_bound² = g/floor. "M": |M_jk| <= gain_bound = g, Remark 3 of the paper, so |K_jk| <= gain_bound/floor.
        floor: P11 >= floor I. Without one (0) a small |M| says nothing about K = M P11⁻¹.
        margin: μ, the inequalities hold as <= -μ I.
        fastest_pole: β, V falls no faster than exp(-2βt); None for no such bound. Consistent form only.
    """

    alpha: float
    gamma: float | None = None
    gain_bound: float | None = None
    minimise: Literal["gain_bound", "gamma", "nothing"] = "gain_bound"
    bound: Literal["K", "M"] = "K"
    floor: float = 1.0
    margin: float = MARGIN
    fastest_pole: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers against each other."""
        for name in ("gain_bound", "gamma"):
            value = getattr(self, name)
            if self.minimise == name and value is not None:
                raise ValueError(f"{name} = {value} is given and minimised: leave one out")
            if value is not None:
                real(name, value, above=0.0)
        if self.gamma is None and self.minimise != "gamma":
            raise ValueError("gamma is missing: give it or minimise it")
        if self.bound == "K" and self.floor <= 0.0 and (self.gain_bound is not None or self.minimise == "gain_bound"):
            raise ValueError(f"floor = {self.floor}: bounding K needs a positive one")
        pole = self.fastest_pole
        if pole is not None and not self.alpha < pole < math.inf:
            raise ValueError(f"fastest_pole = {pole} is out of range; allowed: (alpha, inf), alpha = {self.alpha}")


@dataclasses.dataclass(frozen=True)
class Program:
    """Minimise qᵀx subject to b - A x in the cones; x[free] are the variables, the rest of x is given.

    Attributes:
        q: (n_x,).
        A: (n_rows, n_x), CSC.
        b: (n_rows,).
        orders: order of each semidefinite cone; its rows are the upper triangle by columns, off-diagonals times √2.
        layout: places of the decision variables in the full vector.
        pole_layout: the same with the slack Q, X, τ of the inequalities of `fastest_pole`; None without it.
        free: (n_x,), places of x in the full vector.
        given: the full vector, zero at the places of x.
    """

    q: np.ndarray
    A: sparse.csc_matrix
    b: np.ndarray
    orders: list[int]
    layout: Variables
    pole_layout: Variables | None
    free: np.ndarray
    given: np.ndarray

    def values(self, x: np.ndarray, layout: Variables | None = None) -> Variables:
        """Return the decision variables at x (n_x,); M, L (N, N_e, ...), Q, X (pairs, ...), tau (pairs, N_e, m).

        `layout` says which ones, by default `self.layout`.
        """
        full = self.given.copy()
        full[self.free] = x
        return (layout or self.layout).at(full)


@dataclasses.dataclass(frozen=True)
class _Cones:
    """`count` semidefinite cones of one order: -(constant + Σ values x[places]) is in the cone.

    constant is (count, t), values and places (count, entries), rows (entries,) the row of each value in its cone.
    """

    order: int
    constant: np.ndarray
    values: np.ndarray
    places: np.ndarray
    rows: np.ndarray


def program(model: ReducedModel, problem: Problem) -> Program:
    """Return the cone program of a design; see `Problem` for what is minimised."""
    system = model.system
    layout, size = _layout(system, (len(system.A), len(system.E)), (len(system.pairs),))
    families = [_inequalities(model, problem, problem.alpha, layout)]
    pole_layout = None
    if problem.fastest_pole is not None:
        pole_layout, size = _own_slack(layout, size)
        reverse = ReducedModel.of(reversed_time(system))
        families.append(_inequalities(reverse, problem, -problem.fastest_pole, pole_layout))
    families.append(_floor(system, problem, layout))
    if problem.gain_bound is not None or problem.minimise == "gain_bound":
        families.append(_gain_bound(system, problem, layout))
    A, b = _stack(families, size)
    given, fixed = np.zeros(size), np.zeros(size, dtype=bool)
    for name, place in (("gamma", layout.gamma2), ("gain_bound", layout.g)):
        fixed[place] = problem.minimise != name
    given[layout.gamma2] = (problem.gamma or 0.0) ** 2 * model.weight_norm
    gain_bound = problem.gain_bound or 0.0
    given[layout.g] = gain_bound**2 * problem.floor if problem.bound == "K" else gain_bound
    if system.given_L is not None:
        given[layout.L], fixed[layout.L] = system.given_L, True
    q = np.zeros(size)
    if problem.minimise != "nothing":
        q[layout.g if problem.minimise == "gain_bound" else layout.gamma2] = 1.0
    free = np.flatnonzero(~fixed)
    orders = [cones.order for cones in families for _ in cones.constant]
    return Program(q[free], A[:, free], b - A @ given, orders, layout, pole_layout, free, given)


def svec(matrix: np.ndarray) -> np.ndarray:
    """Return the upper triangles (..., s(s + 1)/2) of symmetric matrices by columns, off-diagonals times √2."""
    column, row = np.tril_indices(matrix.shape[-1])
    return matrix[..., row, column] * np.where(row == column, 1.0, math.sqrt(2.0))


def _layout(system: ErrorModel, vertices: tuple[int, ...], pairs: tuple[int, ...]) -> tuple[Variables, int]:
    """Return the places of the decision variables and their number; both shapes empty: those of one inequality."""
    n, n_e, n_r, m = len(system.B), system.blocks[0], len(system.feedforward), len(system.uncertainties)
    block = np.repeat(np.arange(len(system.blocks)), system.blocks)
    row, column = np.nonzero(np.triu(block[:, np.newaxis] == block))
    P = np.full((n, n), -1)
    P[row, column] = P[column, row] = np.arange(len(row))
    per_vertex, per_pair = [(*vertices, 2, n_e), (*vertices, 2, n_r)], [(*pairs, 2, n), (*pairs, 2, 2)]
    shapes = [*per_vertex, *per_pair, (*pairs, *vertices[1:], m), (), ()]
    ends = len(row) + np.cumsum([math.prod(shape) for shape in shapes])
    rest = [np.arange(end - math.prod(shape), end).reshape(shape) for end, shape in zip(ends, shapes, strict=True)]
    return Variables(P, *rest), int(ends[-1])


def _own_slack(layout: Variables, size: int) -> tuple[Variables, int]:
    """Return the layout with places behind the first `size` for Q, X and τ, and the new size."""
    parts = (layout.Q, layout.X, layout.tau)
    ends = size + np.cumsum([part.size for part in parts])
    Q, X, tau = (np.arange(end - p.size, end).reshape(p.shape) for p, end in zip(parts, ends, strict=True))
    return dataclasses.replace(layout, Q=Q, X=X, tau=tau), int(ends[-1])


def _affine(
    system: ErrorModel, matrix: Callable[[Variables], np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return svec matrix(v) as constant (..., t) and values (..., entries) at places and rows (entries,).

    Places are those of the layout of one inequality; `matrix` maps variables (n_x, ...) to (..., n_x, s, s).
    """
    layout, size = _layout(system, (), ())
    image = svec(matrix(layout.at(np.eye(size + 1, size, k=-1))))
    columns = image[..., 1:, :] - image[..., :1, :]
    places, rows = np.nonzero(columns.any(axis=tuple(range(columns.ndim - 2))))
    return image[..., 0, :], columns[..., places, rows], places, rows


def _places(layout: Variables, i: np.ndarray, k: np.ndarray, pair: np.ndarray) -> np.ndarray:
    """Return the places in the full layout, (count, n_x), of the variables of one inequality, with M_ik and L_ik."""
    count, upper = len(i), np.arange(layout.P.max() + 1)
    parts = [
        np.broadcast_to(upper, (count, len(upper))), layout.M[i, k], layout.L[i, k], layout.Q[pair], layout.X[pair],
        layout.tau[pair, k], np.full(count, layout.gamma2), np.full(count, layout.g),
    ]  # fmt: skip
    return np.concatenate([part.reshape(count, -1) for part in parts], axis=1)


def _inequalities(model: ReducedModel, problem: Problem, alpha: float, layout: Variables) -> _Cones:
    """Return (R_ijk + R_jik)/2 + μI <= 0, rows in units, for all pairs i <= j and all k; R_ijk has A_ik and M_jk."""
    system = model.system
    vertex_i, vertex_k = np.ogrid[: len(system.A), : len(system.E)]

    def matrix(v: Variables) -> np.ndarray:
        R = inequality(model, vertex_i[..., np.newaxis], vertex_k[..., np.newaxis], alpha, v)
        unit = _row_units(model, problem, R.shape[-1])
        return R * np.outer(unit, unit) + problem.margin * np.eye(len(unit))

    constant, values, places, rows = _affine(system, matrix)
    pair = np.repeat(np.arange(len(system.pairs)), len(system.E))
    i, j = np.array(system.pairs)[pair].T
    k = np.tile(np.arange(len(system.E)), len(system.pairs))
    return _Cones(
        order=_order(constant),
        constant=0.5 * (constant[i, k] + constant[j, k]),
        values=0.5 * np.concatenate([values[i, k], values[j, k]], axis=1),
        places=np.concatenate([_places(layout, other, k, pair)[:, places] for other in (j, i)], axis=1),
        rows=np.tile(rows, 2),
    )


def _row_units(model: ReducedModel, problem: Problem, size: int) -> np.ndarray:
    """Return factors (s,) <= 1 of the rows that bring a large given γ² weight down to order one.

    The solver's tolerance is relative to the largest constant; if R <= -μI holds after this congruence, it also holds
    before.
    """
    unit, start = np.ones(size), len(model.S_b) + 2
    weight = np.diag(model.system.disturbance_weight)
    unit[start : start + len(weight)] = np.maximum(1.0, weight * (problem.gamma or 0.0) ** 2) ** -0.5
    return unit


def _gain_bound(system: ErrorModel, problem: Problem, layout: Variables) -> _Cones:
    """Return [[gI, M_jk], [M_jkᵀ, S]] >= 0 for all j, k, with S = P11 or gI."""
    n_e = system.blocks[0]

    def matrix(v: Variables) -> np.ndarray:
        g = v.g[..., np.newaxis, np.newaxis]
        corner = v.P[..., :n_e, :n_e] if problem.bound == "K" else g * np.eye(n_e)
        upper = np.concatenate([g * np.eye(2), v.M], axis=-1)
        return -np.concatenate([upper, np.concatenate([np.swapaxes(v.M, -1, -2), corner], axis=-1)], axis=-2)

    constant, values, places, rows = _affine(system, matrix)
    j, k = (index.ravel() for index in np.indices((len(system.A), len(system.E))))
    everywhere = _places(layout, j, k, np.zeros_like(j))[:, places]
    return _Cones(_order(constant), np.tile(constant, (len(j), 1)), np.tile(values, (len(j), 1)), everywhere, rows)


def _floor(system: ErrorModel, problem: Problem, layout: Variables) -> _Cones:
    """Return P11 >= floor I."""
    n_e = system.blocks[0]
    constant, values, places, rows = _affine(system, lambda v: problem.floor * np.eye(n_e) - v.P[..., :n_e, :n_e])
    # P comes first in every layout: its places are the same.
    return _Cones(_order(constant), constant[np.newaxis], values[np.newaxis], places[np.newaxis], rows)


def _order(constant: np.ndarray) -> int:
    """Return s of a triangle of s(s + 1)/2."""
    return math.isqrt(2 * constant.shape[-1])


def _stack(families: list[_Cones], size: int) -> tuple[sparse.csc_matrix, np.ndarray]:
    """Return A and b of all cones."""
    start, rows = 0, []
    for cones in families:
        count, triangle = cones.constant.shape
        rows.append((start + triangle * np.arange(count)[:, np.newaxis] + cones.rows).ravel())
        start += count * triangle
    columns = np.concatenate([cones.places.ravel() for cones in families])
    values = np.concatenate([cones.values.ravel() for cones in families])
    # Entries at the same position are summed; those that are zero at this vertex are removed.
    A = sparse.csc_matrix((values, (np.concatenate(rows), columns)), shape=(start, size))
    A.eliminate_zeros()
    return A, -np.concatenate([cones.constant.ravel() for cones in families])
