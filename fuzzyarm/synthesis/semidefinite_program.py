"""Small semidefinite programs: minimise qᵀx subject to F_0 + Σ x_k F_k >= 0 for families of matrices."""

from __future__ import annotations

import dataclasses
import math

import clarabel  # type: ignore[import-untyped]
import numpy as np
from scipy import sparse

__all__ = ["Family", "minimise", "svec", "symmetric_units"]


@dataclasses.dataclass(frozen=True)
class Family:
    """Matrices F_0 + Σ x_k F_k that must be positive semidefinite.

    Attributes:
        constant: F_0, (B, s, s).
        linear: F_k, (B, variables, s, s).
    """

    constant: np.ndarray
    linear: np.ndarray


def svec(matrix: np.ndarray) -> np.ndarray:
    """Return the upper triangles (..., s(s + 1)/2) of matrices (..., s, s) by columns; off-diagonal numbers × √2."""
    column, row = np.tril_indices(matrix.shape[-1])
    return matrix[..., row, column] * np.where(row == column, 1.0, math.sqrt(2.0))


def symmetric_units(size: int) -> np.ndarray:
    """Return a basis of the symmetric matrices (s, s): one entry and its mirror image are the number 1."""
    row, column = np.tril_indices(size)
    units = np.zeros((len(row), size, size))
    every = np.arange(len(row))
    units[every, row, column] = units[every, column, row] = 1.0
    return units


def minimise(q: np.ndarray, families: list[Family], tolerance: float = 1e-7) -> tuple[np.ndarray, str]:
    """Return the point where Clarabel ends and its status, which proves nothing.

    Args:
        q: weights of the variables, (variables,).
        families: the constraints.
        tolerance: of the solver, relative.
    """
    rows = [-np.swapaxes(svec(family.linear), 1, 2).reshape(-1, len(q)) for family in families]
    A = sparse.csc_matrix(np.concatenate(rows))
    b = np.concatenate([svec(family.constant).ravel() for family in families])
    cones = [clarabel.PSDTriangleConeT(family.constant.shape[-1]) for family in families for _ in family.constant]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.direct_solve_method, settings.max_threads = "faer", 1
    answer = clarabel.DefaultSolver(sparse.csc_matrix((len(q), len(q))), q, A, b, cones, settings).solve()
    return np.array(answer.x), str(answer.status)
