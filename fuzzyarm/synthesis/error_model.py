"""The tracking error dynamics that a design stabilises, in one shape for every form.

    E_k ẋ = A_ik x + B u + D_k w + Σ Hᵀ f (Wx x - Wd ẋ + Ww w),    u = M P⁻¹ x + L w_r,    z = C x,

blended by the memberships; |f| <= 1 for each uncertainty. With the integral x_I = ∫ (q - q_d) dt the error is
ē = (e, x_I), else ē = e.

*Consistent reference* (this project): x = ē, w = d, z = position error; L is fixed and cancels the reference.
*Paper* (theorems 1 and 2, (10) and Remark 2): x = (ē, x_r), w = (d, r), z = Q^(1/2) e; L is free or given.

The solver uses this model. The proof has its own in `fuzzy_policy.proof`: `theorem1`, `theorem2` and
`consistent_reference`. It shares none of this code; tests compare the two.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.controller import consistent_feedforward
from fuzzyarm.fuzzy_policy.proof.vertices import reference_model
from fuzzyarm.fuzzy_policy.states import ERROR_STATES, INTEGRAL, PLANT, PLANT_STATES
from fuzzyarm.fuzzy_policy.ts_model import TSModel

__all__ = ["ErrorModel", "OneVertex", "UncertainBlock", "consistent_form", "paper_form", "reversed_time"]

_TORQUE, _COMMAND = consecutive(JOINTS, 3 * JOINTS)  # w = (d, r) of the paper's form, r = (q_d, q̇_d, q̈_d)


@dataclasses.dataclass(frozen=True)
class OneVertex(TSModel):
    """A T-S model with one vertex of A alone: the inequalities of its design are some of those of the whole.

    Attributes:
        number: of the vertex, 0 for the first.
    """

    number: int = 0

    @property
    def A_vertices(self) -> list[np.ndarray]:
        """The one of the matrices A_pi."""
        return super().A_vertices[self.number : self.number + 1]


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
        E: N_e matrices (n, n); rows other than those of q̇ are those of the identity.
        A: [i][k], (n, n).
        B: (n, 2).
        D: N_e matrices (n, n_w).
        C: (n_z, n).
        blocks: sizes of the diagonal blocks of P; feedback acts on the first.
        feedforward: the columns of w that L acts on, empty in the consistent form.
        uncertainties: the dropped premises.
        disturbance_weight: (n_w, n_w) weight of wᵀw, the identity in SI units.
        given_L: (N, N_e, 2, n_r), the L that is given; None: it is free.
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
    given_L: np.ndarray | None = None

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The index pairs i <= j of the convex double sum."""
        return [(i, j) for i in range(len(self.A)) for j in range(i, len(self.A))]


def consistent_form(model: TSModel, integral: bool) -> ErrorModel:
    """Return the error dynamics of the consistent-reference form; z is the position error [rad]."""
    n = ERROR_STATES if integral else PLANT_STATES
    E, A, B = _error_vertices(model, n)
    blocks = [
        UncertainBlock(
            (u.premise,),
            _wide(u.H, n),
            _wide(u.W if u.on == "A" else 0.0 * u.W, n),
            _wide(u.W if u.on == "E" else 0.0 * u.W, n),
            np.zeros((len(u.W), JOINTS)),
        )
        for u in model.uncertainties
    ]
    return ErrorModel(
        E, [[a] * len(E) for a in A], B, [B] * len(E), np.eye(JOINTS, n), (n,), range(0), blocks, np.eye(JOINTS)
    )


def paper_form(
    model: TSModel, integral: bool, weight: np.ndarray, *, common_multiplier: bool, share: float | None = None
) -> ErrorModel:
    """Return the augmented dynamics (10) with the corrected (11) and Remark 2; `weight` is the diagonal (4,) of Q.

    With `common_multiplier` the dropped premises of A share one uncertain block, as printed in Theorem 2. L is `share`
    times that of the consistent form, or free.
    """
    n_e = ERROR_STATES if integral else PLANT_STATES
    n, (A_r, B_r) = n_e + PLANT_STATES, reference_model()
    E_e, A_e, B_e = _error_vertices(model, n_e)
    E, D, A = [], [], []
    for E_k, E_p in zip(E_e, model.E_vertices, strict=True):
        E.append(
            np.block([[E_k, np.zeros((n_e, PLANT_STATES))], [np.zeros((PLANT_STATES, n_e)), np.eye(PLANT_STATES)]])
        )
        D_k = np.zeros((n, _COMMAND.stop))
        D_k[:n_e, _TORQUE], D_k[PLANT, _COMMAND], D_k[n_e:, _COMMAND] = B_e, -E_p @ B_r, B_r
        D.append(D_k)
    for A_i, A_p in zip(A_e, model.A_vertices, strict=True):
        row = []
        for E_p in model.E_vertices:
            A_ik = np.zeros((n, n))
            A_ik[:n_e, :n_e], A_ik[n_e:, n_e:], A_ik[PLANT, n_e:] = A_i, A_r, A_p - E_p @ A_r
            row.append(A_ik)
        A.append(row)
    blocks = []
    for u in model.uncertainties:
        Wx, Wd, Ww = np.zeros((len(u.W), n)), np.zeros((len(u.W), n)), np.zeros((len(u.W), _COMMAND.stop))
        if u.on == "A":
            # ΔA acts on x_p = e + x_r.
            Wx[:, PLANT], Wx[:, n_e:] = u.W, u.W
        else:
            # ΔE acts on ẋ_p = ė + A_r x_r + B_r r.
            Wd[:, PLANT], Wx[:, n_e:], Ww[:, _COMMAND] = u.W, -u.W @ A_r, -u.W @ B_r
        blocks.append(UncertainBlock((u.premise,), _wide(u.H, n), Wx, Wd, Ww))
    C = np.hstack([np.diag(np.sqrt(weight)), np.zeros((PLANT_STATES, n - PLANT_STATES))])
    B = np.vstack([B_e, np.zeros((PLANT_STATES, JOINTS))])
    if common_multiplier:
        blocks = _merged(blocks)
    return ErrorModel(
        E, A, B, D, C, (n_e, PLANT_STATES), range(_COMMAND.start, _COMMAND.stop), blocks, np.eye(_COMMAND.stop),
        None if share is None else share * consistent_feedforward(model),
    )  # fmt: skip


def reversed_time(system: ErrorModel) -> ErrorModel:
    """Return the model of the same motion in reversed time, without w: E dx/d(-t) = -A x - B u, the Δ keep their bound.

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
    """Return Ē_k, Ā_i (n, n) and B̄ (n, 2): the vertices, with ẋ_I = C_p e appended where n has room for it."""
    E, A = [], []
    for vertex in model.E_vertices:
        E.append(np.eye(n))
        E[-1][PLANT, PLANT] = vertex
    for vertex in model.A_vertices:
        A.append(np.zeros((n, n)))
        A[-1][PLANT, PLANT] = vertex
        A[-1][INTEGRAL] = np.eye(n - PLANT_STATES, n)
    return E, A, np.vstack([model.B, np.zeros((n - PLANT_STATES, JOINTS))])


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
