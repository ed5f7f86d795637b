"""The tracking error dynamics that a design stabilises, in one shape for every form.

    E_k ẋ = A_ik x + B u + D_k w + Σ Hᵀ f (Wx x - Wd ẋ + Ww w),    u = M P⁻¹ x + L w_r,    z = C x,

blended by the memberships; |f| <= 1 for each uncertainty. With the integral x_I = ∫ (q - q_d) dt the error is
ē = (e, x_I), else ē = e.

*Consistent reference* (this project): x = ē, w = d, z = position error; L is fixed and cancels the reference.
*Paper* (theorems 1 and 2, (10) and Remark 2): x = (ē, x_r), w = (d, r), z = Q^(1/2) e; L is free.

This is the solver's view of a design. The proof has its own, `fuzzy_policy.theorem1`, `theorem2` and
`consistent_reference`, and shares none of this code; tests hold the two together.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.fuzzy_policy.proof.vertices import reference_model
from fuzzyarm.fuzzy_policy.ts_model import TSModel


@dataclasses.dataclass(frozen=True)
class UncertainBlock:
    """Hᵀ f (Wx x - Wd ẋ + Ww w) with |f| <= 1; `premises` names it. H, Wx, Wd are (r, n), Ww (r, n_w)."""

    premises: tuple[str, ...]
    H: np.ndarray
    Wx: np.ndarray
    Wd: np.ndarray
    Ww: np.ndarray


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """Matrices of the error dynamics, in SI units or scaled.

    Attributes:
        E: N_e matrices (n, n); rows other than 2 and 3 are those of the identity.
        A: [i][k], (n, n).
        B: (n, 2).
        D: N_e matrices (n, n_w).
        C: (n_z, n).
        blocks: sizes of the diagonal blocks of P; feedback acts on the first.
        feedforward: the columns of w that L acts on, empty if L is not free.
        uncertainties: the dropped premises.
        disturbance_weight: (n_w, n_w) weight of wᵀw, the identity in SI units.
    """

    E: list[np.ndarray]
    A: list[list[np.ndarray]]
    B: np.ndarray
    D: list[np.ndarray]
    C: np.ndarray
    blocks: tuple[int, ...]
    feedforward: range
    uncertainties: list[UncertainBlock]
    disturbance_weight: np.ndarray

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The index pairs i <= j of the convex double sum."""
        return [(i, j) for i in range(len(self.A)) for j in range(i, len(self.A))]


def consistent_reference(model: TSModel, integral: bool) -> ErrorModel:
    """Return the error dynamics of the consistent-reference form; z is the position error [rad]."""
    n = 6 if integral else 4
    E, A, B = _error_vertices(model, n)
    blocks = [
        UncertainBlock(
            (u.premise,),
            _wide(u.H, n),
            _wide(u.W if u.on == "A" else 0.0 * u.W, n),
            _wide(u.W if u.on == "E" else 0.0 * u.W, n),
            np.zeros((len(u.W), 2)),
        )
        for u in model.uncertainties
    ]
    return ErrorModel(E, [[a] * len(E) for a in A], B, [B] * len(E), np.eye(2, n), (n,), range(0), blocks, np.eye(2))


def paper_form(model: TSModel, integral: bool, weight: np.ndarray, *, common_multiplier: bool) -> ErrorModel:
    """Return the augmented dynamics (10) with the corrected (11) and Remark 2; `weight` is the diagonal (4,) of Q.

    With `common_multiplier` the dropped premises of A share one uncertain block, as printed in Theorem 2.
    """
    n_e = 6 if integral else 4
    n, (A_r, B_r) = n_e + 4, reference_model()
    E_e, A_e, B_e = _error_vertices(model, n_e)
    E, D, A = [], [], []
    for E_k, E_p in zip(E_e, model.E_vertices, strict=True):
        E.append(np.block([[E_k, np.zeros((n_e, 4))], [np.zeros((4, n_e)), np.eye(4)]]))
        D_k = np.zeros((n, 8))
        D_k[:n_e, :2], D_k[:4, 2:], D_k[n_e:, 2:] = B_e, -E_p @ B_r, B_r
        D.append(D_k)
    for A_i, A_p in zip(A_e, model.A_vertices, strict=True):
        row = []
        for E_p in model.E_vertices:
            A_ik = np.zeros((n, n))
            A_ik[:n_e, :n_e], A_ik[n_e:, n_e:], A_ik[:4, n_e:] = A_i, A_r, A_p - E_p @ A_r
            row.append(A_ik)
        A.append(row)
    blocks = []
    for u in model.uncertainties:
        Wx, Wd, Ww = np.zeros((len(u.W), n)), np.zeros((len(u.W), n)), np.zeros((len(u.W), 8))
        if u.on == "A":
            # ΔA acts on x_p = e + x_r.
            Wx[:, :4], Wx[:, n_e:] = u.W, u.W
        else:
            # ΔE acts on ẋ_p = ė + A_r x_r + B_r r.
            Wd[:, :4], Wx[:, n_e:], Ww[:, 2:] = u.W, -u.W @ A_r, -u.W @ B_r
        blocks.append(UncertainBlock((u.premise,), _wide(u.H, n), Wx, Wd, Ww))
    C = np.hstack([np.diag(np.sqrt(weight)), np.zeros((4, n - 4))])
    B = np.vstack([B_e, np.zeros((4, 2))])
    if common_multiplier:
        blocks = _merged(blocks)
    return ErrorModel(E, A, B, D, C, (n_e, 4), range(2, 8), blocks, np.eye(8))


def reversed_time(system: ErrorModel) -> ErrorModel:
    """Return the model of the same motion run backwards and without w: E dx/d(-t) = -A x - B u, the Δ keep their bound.

    V falls no faster than exp(-2βt) if and only if it grows no faster backwards: the inequality of a decay rate of -β
    for this model, with no rows w and z.

    Raises:
        ValueError: the model is of the paper's form, where the reference model alone has a pole at -62 rad/s.
    """
    if len(system.feedforward):
        raise ValueError("a bound of the fastest pole goes with the consistent form only")
    n = len(system.B)
    return dataclasses.replace(
        system,
        A=[[-A for A in per_k] for per_k in system.A],
        B=-system.B,
        D=[np.zeros((n, 0)) for _ in system.D],
        C=np.zeros((0, n)),
        uncertainties=[dataclasses.replace(block, Ww=block.Ww[:, :0]) for block in system.uncertainties],
        disturbance_weight=np.zeros((0, 0)),
    )


def _error_vertices(model: TSModel, n: int) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Return Ē_k, Ā_i (n, n) and B̄ (n, 2): the vertices, with ẋ_I = C_p e appended for n = 6."""
    E, A = [], []
    for vertex in model.E_vertices:
        E.append(np.eye(n))
        E[-1][:4, :4] = vertex
    for vertex in model.A_vertices:
        A.append(np.zeros((n, n)))
        A[-1][:4, :4] = vertex
        A[-1][4:, :] = np.eye(n - 4, n)
    return E, A, np.vstack([model.B, np.zeros((n - 4, 2))])


def _merged(blocks: list[UncertainBlock]) -> list[UncertainBlock]:
    """Return the blocks of A stacked into one, Δ = diag(f_2, ...), and that of E as it is."""
    groups = [[b for b in blocks if b.premises != ("z1",)], [b for b in blocks if b.premises == ("z1",)]]
    return [
        UncertainBlock(
            tuple(name for b in group for name in b.premises),
            *(np.vstack([getattr(b, key) for b in group]) for key in ("H", "Wx", "Wd", "Ww")),
        )
        for group in groups
        if group
    ]


def _wide(matrix: np.ndarray, columns: int) -> np.ndarray:
    """Return `matrix` with zero columns appended."""
    return np.hstack([matrix, np.zeros((len(matrix), columns - matrix.shape[1]))])
