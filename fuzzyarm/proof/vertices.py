"""The vertex matrices of the inequalities, with the integral of Remark 2 appended.

    Ē_k = diag(E_pk, I),   Ā_i = [[A_pi, 0], [C_p, 0]],   B̄ = [B_p; 0],   C_p = [I 0],

act on ē = (e, x_I), ẋ_I = C_p e = q - q_d; without the integral ē = e and the barred matrices are those of the plant.
The entries are all floats or all exact rationals, because NumPy cannot multiply a mixture of the two.
"""

import dataclasses
from typing import Self

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.ts_model import ERROR_STATES, PLANT, PLANT_STATES, TSModel, Uncertainty
from fuzzyarm.proof.block_matrix import identity
from fuzzyarm.proof.definiteness import exact, rational

__all__ = ["REFERENCE_POLE", "Index", "TrackingVertices", "Vertices", "error_vertices", "tracking_vertices"]

Index = int | np.ndarray  # number of a vertex, from 0, or an array of numbers, for a stack of matrices
REFERENCE_POLE = 62.0  # rad/s, double pole of the reference model (8), section 6.1.3


@dataclasses.dataclass(frozen=True)
class Vertices:
    """The T-S model in the form used by the inequalities, in SI units; lists and arrays must not be changed."""

    E: list[np.ndarray]  # N_e matrices E_pk, (4, 4)
    A: list[np.ndarray]  # N matrices A_pi, (4, 4)
    B: np.ndarray  # B_p = B_d, (4, 2)
    integral: bool  # whether ē = (e, x_I), n_e = 6, or ē = e, n_e = 4
    uncertainties: list[Uncertainty]  # the dropped premises, one term for each multiplier τ

    @property
    def n_e(self) -> int:
        """The number of entries of ē."""
        return ERROR_STATES if self.integral else PLANT_STATES

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The index pairs (i, j), i <= j, of vertices of A in the double sum of the inequalities."""
        return [(i, j) for i in range(len(self.A)) for j in range(i, len(self.A))]

    def midpoints(self) -> Self:
        """Return the same data, with the matrices (A_i + A_j)/2 of all `pairs`, in their order, in place of the A_i.

        Ψ_ijk = Ψ(A_i, M_jk, L_jk) is affine: (Ψ_ijk + Ψ_jik)/2 = Ψ((A_i + A_j)/2, (M_ik + M_jk)/2, (L_ik + L_jk)/2).
        """
        return dataclasses.replace(self, A=[0.5 * (self.A[i] + self.A[j]) for i, j in self.pairs])

    def error_E(self, k: Index) -> np.ndarray:
        """Return Ē_k = diag(E_pk, I), (..., n_e, n_e), for one index k or an array of them."""
        return self._with_integral(self.E, k, identity(self.n_e)[PLANT_STATES:])

    def error_A(self, i: Index) -> np.ndarray:
        """Return Ā_i = [[A_pi, 0], [C_p, 0]], (..., n_e, n_e), for one index i or an array of them."""
        return self._with_integral(self.A, i, identity(self.n_e)[: self.n_e - PLANT_STATES])

    def _with_integral(self, plant: list[np.ndarray], index: Index, below: np.ndarray) -> np.ndarray:
        """Return [[Y, 0], below], (..., n_e, n_e), for each of the matrices Y = plant[index] (4, 4)."""
        chosen = np.asarray(plant)[index]
        whole = np.zeros((*chosen.shape[:-2], self.n_e, self.n_e), dtype=chosen.dtype)
        whole[..., PLANT, PLANT], whole[..., PLANT_STATES:, :] = chosen, below
        return whole

    def error_rows(self, plant_rows: np.ndarray) -> np.ndarray:
        """Return [Y; 0], (..., n_e, m), for rows Y (..., 4, m) of the plant: the zero rows are for ẋ_I, if present."""
        *stack, _, columns = plant_rows.shape
        whole = np.zeros((*stack, self.n_e, columns), dtype=plant_rows.dtype)
        whole[..., PLANT, :] = plant_rows
        return whole


@dataclasses.dataclass(frozen=True)
class TrackingVertices(Vertices):
    """The vertices of the paper's own form, with the reference model (8) and the weight of (13)."""

    A_r: np.ndarray  # (4, 4)
    B_r: np.ndarray  # (4, 6)
    Q_inverse: np.ndarray  # Q⁻¹ of eᵀQe in (13), (4, 4)


def error_vertices(
    model: TSModel, integral: bool, *, common_multiplier: bool = False, rationals: bool = False
) -> Vertices:
    """Return the vertices of a T-S model for ē = (e, x_I) with the integral (Remark 2), else for e.

    With a `common_multiplier` all dropped premises of A share one multiplier, as in the printed Theorem 2, and all
    those of E another; otherwise each has its own, which is less conservative. Entries are floats or, with `rationals`,
    exact; they are computed from the robot parameters.
    """
    polytope = model.polytope_in(rational) if rationals else model.polytope
    terms, B = polytope.uncertainties, model.B
    if common_multiplier:
        terms = [_stacked(group) for on in ("A", "E") if (group := [term for term in terms if term.on == on])]
    if rationals:
        B, terms = exact(B), [dataclasses.replace(term, H=exact(term.H), W=exact(term.W)) for term in terms]
    return Vertices(polytope.E, polytope.A, B, integral, terms)


def tracking_vertices(
    model: TSModel, integral: bool, weight: np.ndarray, *, common_multiplier: bool = False, rationals: bool = False
) -> TrackingVertices:
    """Return `error_vertices` with the reference model, equation (8), of (q_d, q̇_d, q̈_d), Q = diag(`weight` (4,))."""
    plain = error_vertices(model, integral, common_multiplier=common_multiplier, rationals=rationals)
    p, I, O = REFERENCE_POLE, np.eye(JOINTS), np.zeros((JOINTS, JOINTS))  # noqa: E741  identity
    A_r, B_r = np.block([[O, I], [-(p**2) * I, -2.0 * p * I]]), np.block([[O, O, O], [p**2 * I, 2.0 * p * I, I]])
    Q_inverse = np.diag(1.0 / weight)
    if rationals:
        A_r, B_r, Q_inverse = exact(A_r), exact(B_r), exact(np.diag(weight))
        np.fill_diagonal(Q_inverse, 1 / np.diagonal(Q_inverse))
    return TrackingVertices(**vars(plain), A_r=A_r, B_r=B_r, Q_inverse=Q_inverse)


def _stacked(terms: list[Uncertainty]) -> Uncertainty:
    """Return several terms Hᵀ Δ W of one matrix as a single term with one multiplier."""
    names = tuple(name for term in terms for name in term.premises)
    return Uncertainty(names, terms[0].on, *(np.vstack([getattr(term, part) for term in terms]) for part in "HW"))
