"""The design inequality without the slack variables of its trivial rows: same solutions, a quarter of the variables.

Only the rows b, those of q̇, of E_k ẋ = A_ik x + B u + D_k w depend on a vertex or on the input; the others, a, read
ẋ_a = N x + D_a w. Adding S_a times the a-rows of ẋ to the rows of x makes them redundant, and with them most of the
slack: Q and X (n, n) stay only as Q_b = S_bᵀ (Q + X S_a S_aᵀ) and X_b = S_bᵀ X S_b. The rows left, x, ẋ_b, w, z and
uncertainties, are negative definite if and only if the full inequality is, with the same P, M, L, τ, for some Q and X:

    | He(S_a N P + S_b Q_b + αP)                     *                             *          *   *  |
    | A_b P + B_b [M 0] - E_bb Q_b + X_bᵀ S_bᵀ       -He(E_bb X_b) + Σ τ H_bᵀ H_b  *          *   *  |
    | (S_a D_a)ᵀ                                     (D_b + B_b [0 L])ᵀ            -γ² weight *   *  |
    | C P                                            0                             0          -I  *  |
    | Wx P - Wd_b Q_b                                -Wd_b X_b                     Ww         0   -τI|

S_a and S_b are the columns a and b of the identity. `expand` goes back to the full Q and X.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.common.slices import consecutive
from fuzzyarm.fuzzy_policy.states import VELOCITY
from fuzzyarm.synthesis.error_model import ErrorModel

__all__ = ["INPUT_ROWS", "ReducedModel", "Variables", "blended", "expand", "inequality"]

INPUT_ROWS = np.arange(VELOCITY.start, VELOCITY.stop)  # b, of every form in `error_model`
ROUNDING = 1e-12  # rounding error of an exact zero or one after scaling


@dataclasses.dataclass(frozen=True)
class Variables:
    """Decision variables with any common leading axes, or, as a layout, their places in the decision vector.

    Attributes:
        P: (..., n, n), block diagonal and symmetric.
        M: (..., 2, n_e), K = M P⁻¹ on the first block.
        L: (..., 2, n_r), acts on the last n_r entries of w.
        Q: (..., 2, n), the slack Q_b.
        X: (..., 2, 2), the slack X_b.
        tau: (..., m), one multiplier for each uncertainty.
        gamma2: (...), γ² |weight|, of order one where γ² is not.
        g: (...), what bounds the gains, see `bound` of `conic.Problem`.
    """

    P: np.ndarray
    M: np.ndarray
    L: np.ndarray
    Q: np.ndarray
    X: np.ndarray
    tau: np.ndarray
    gamma2: np.ndarray
    g: np.ndarray

    def at(self, x: np.ndarray) -> Variables:
        """Return the values that decision vectors x (..., n_x) give to this layout; place -1 stands for zero."""
        padded = np.concatenate([x, np.zeros((*x.shape[:-1], 1))], axis=-1)
        return Variables(*(padded[..., getattr(self, field.name)] for field in dataclasses.fields(self)))


@dataclasses.dataclass(frozen=True)
class ReducedModel:
    """The error model split into rows a and b; the uncertainties are stacked, r rows in all.

    Attributes:
        system: the error model itself.
        S_a: (n, n - 2), columns a of the identity.
        S_b: (n, 2), columns b.
        N: (n - 2, n), rows a of A.
        D_a: (n - 2, n_w), rows a of D.
        A: (N, N_e, 2, n), rows b of A_ik.
        B: (2, 2), rows b of B.
        E: (N_e, 2, 2), the b, b part of E_k.
        D: (N_e, 2, n_w), rows b of D_k.
        H: (r, 2), columns b of H.
        Wx: (r, n).
        Wd: (r, 2), columns b of Wd.
        Ww: (r, n_w).
        owner: (r,), the uncertainty each row belongs to.
    """

    system: ErrorModel
    S_a: np.ndarray
    S_b: np.ndarray
    N: np.ndarray
    D_a: np.ndarray
    A: np.ndarray
    B: np.ndarray
    E: np.ndarray
    D: np.ndarray
    H: np.ndarray
    Wx: np.ndarray
    Wd: np.ndarray
    Ww: np.ndarray
    owner: np.ndarray

    @property
    def weight_norm(self) -> float:
        """|weight|, the spectral norm; 1 without w."""
        weight = self.system.disturbance_weight
        return float(np.linalg.norm(weight, ord=2)) if weight.size else 1.0

    @classmethod
    def of(cls, system: ErrorModel) -> ReducedModel:
        """Split an error model, usually a scaled one.

        Raises:
            ValueError: rows a differ between vertices, or have E other than the identity, input or uncertainty.
        """
        n, n_w = len(system.B), system.D[0].shape[1]
        b, a = INPUT_ROWS, np.setdiff1d(np.arange(n), INPUT_ROWS)
        A, E, D = np.array(system.A), np.array(system.E), np.array(system.D)
        stacked = {key: [getattr(u, key) for u in system.uncertainties] for key in ("H", "Wx", "Wd", "Ww")}
        H, Wx, Wd, Ww = (np.vstack([np.zeros((0, n_w if key == "Ww" else n)), *rows]) for key, rows in stacked.items())
        zeros = [
            E[:, a] - np.eye(n)[a], E[:, b][:, :, a], system.B[a], A[..., a, :] - A[0, 0, a], D[:, a] - D[0, a],
            H[:, a], Wd[:, a],
        ]  # fmt: skip
        if any(np.abs(part).max(initial=0.0) > ROUNDING for part in zeros):
            raise ValueError("rows other than those of q̇ of the error model must read ẋ = N x + D w at every vertex")
        sizes = [len(u.H) for u in system.uncertainties]
        return cls(
            system=system, S_a=np.eye(n)[:, a], S_b=np.eye(n)[:, b], N=A[0, 0, a], D_a=D[0, a],
            A=A[..., b, :], B=system.B[b], E=E[:, b][:, :, b], D=D[:, b], H=H[:, b], Wx=Wx, Wd=Wd[:, b], Ww=Ww,
            owner=np.repeat(np.arange(len(sizes)), sizes),
        )  # fmt: skip


def inequality(model: ReducedModel, i: np.ndarray, k: np.ndarray, alpha: float, v: Variables) -> np.ndarray:
    """Return the reduced inequality above at vertices A_ik, E_k, symmetric (..., s, s).

    Args:
        model: the split error model.
        i: vertices of A; leading axes broadcast with those of k and of the variables.
        k: vertices of E.
        alpha: decay rate.
        v: decision variables.
    """
    A, B, E, D = model.A[i, k], model.B, model.E[k], model.D[k]
    S_b, system, tau = model.S_b, model.system, v.tau[..., model.owner]
    x, x_b, w, z, f = consecutive(len(S_b), 2, D.shape[-1], len(system.C), len(model.H))
    coupling = A @ v.P - E @ v.Q + _t(v.X) @ S_b.T
    coupling[..., : v.M.shape[-1]] += B @ v.M
    drive = D + np.zeros((*coupling.shape[:-1], D.shape[-1]))
    drive[..., D.shape[-1] - v.L.shape[-1] :] += B @ v.L
    # Half of R: the other half is its transpose.
    R = np.zeros((*coupling.shape[:-2], f.stop, f.stop))
    R[..., x, x] = model.S_a @ model.N @ v.P + S_b @ v.Q + alpha * v.P
    R[..., x_b, x] = coupling
    R[..., x_b, x_b] = 0.5 * model.H.T @ (tau[..., np.newaxis] * model.H) - E @ v.X
    R[..., x, w], R[..., x_b, w] = model.S_a @ model.D_a, drive
    R[..., w, w] = -0.5 * v.gamma2[..., np.newaxis, np.newaxis] * (system.disturbance_weight / model.weight_norm)
    R[..., z, x], R[..., z, z] = system.C @ v.P, -0.5 * np.eye(len(system.C))
    R[..., f, x], R[..., f, x_b], R[..., f, w] = model.Wx @ v.P - model.Wd @ v.Q, -model.Wd @ v.X, model.Ww
    R[..., f, f] = -0.5 * tau[..., np.newaxis] * np.eye(len(model.owner))
    both: np.ndarray = R + _t(R)
    return both


def blended(model: ReducedModel, alpha: float, v: Variables) -> np.ndarray:
    """Return (R_ijk + R_jik)/2 (pairs, N_e, s, s) for all pairs i <= j and all k, the inequalities of a design.

    Args:
        model: the split error model.
        alpha: decay rate.
        v: P; M, L (N, N_e, ...); Q, X (pairs, ...); tau (pairs, N_e, m).
    """
    i, j = np.array(model.system.pairs).T[..., np.newaxis]
    k = np.arange(len(model.E))

    def R(vertex: np.ndarray, gain: np.ndarray) -> np.ndarray:
        one = dataclasses.replace(v, M=v.M[gain, k], L=v.L[gain, k], Q=v.Q[:, np.newaxis], X=v.X[:, np.newaxis])
        return inequality(model, vertex, k, alpha, one)

    mean: np.ndarray = 0.5 * (R(i, j) + R(j, i))
    return mean


def expand(model: ReducedModel, v: Variables, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the full Q and X (pairs, n, n): X = S_b X_b S_bᵀ + ε S_a S_aᵀ, Q = S_b Q_b + S_a (N P - ε S_aᵀ).

    After the congruence the a-rows of ẋ have -2εI and meet only w, through D_a. They cost D_aᵀ D_a / 2ε in the rows w,
    half of the margin of R < 0 in these rows if ε = |D_a (-R⁻¹)_ww D_aᵀ|; a larger ε would worsen the condition.

    Args:
        model: the split error model.
        v: variables of a design, Q and X (pairs, ...).
        R: (pairs, N_e, s, s) of `blended`, negative definite.
    """
    S_a, S_b = model.S_a, model.S_b
    w = consecutive(len(S_b), 2, model.D_a.shape[1])[2]
    cost = model.D_a @ np.linalg.inv(-R)[..., w, w] @ model.D_a.T
    epsilon = np.maximum(1.0, np.linalg.norm(cost, ord=2, axis=(-2, -1)).max(axis=1))[:, np.newaxis, np.newaxis]
    X = S_b @ v.X @ S_b.T + epsilon * (S_a @ S_a.T)
    Q = S_b @ v.Q + S_a @ (model.N @ v.P - epsilon * S_a.T)
    return Q, X


def _t(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
