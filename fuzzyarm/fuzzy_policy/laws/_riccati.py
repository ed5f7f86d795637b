"""The discrete Riccati equation and the matrix exponential, computed with the same bits on every processor.

    P = Q + Aᵀ P (I + G P)⁻¹ A

All results are computed with +, -, * and / in a fixed order, see `fuzzyarm.numbers.linear`. Matrices may have leading
axes, one matrix for each of several postures.

The equation is solved by doubling (Chu, Fan, Lin and Wang, International Journal of Control 77, 2004), which preserves
its structure: for the arms of this package the gains have relative errors of about 1e-13.
"""

import numpy as np

from fuzzyarm.numbers.linear import product, solved

__all__ = ["exponential", "riccati"]

_DOUBLINGS = 30  # at most, which gives the 2^30-th power of the closed loop
_FORGOTTEN = 1e-30  # largest entry of a power of the closed loop that counts as zero
_RESIDUAL = 1e-8  # largest residual of the equation for P_ij, relative to √(P_ii P_jj)
_TERMS = 14  # of the Taylor series of the exponential, for a matrix with a norm of at most 1/2


def exponential(matrix: np.ndarray) -> np.ndarray:
    """Return the exponential (..., n, n), by a Taylor series of E(y) = exp(y) - 1, and E(2y) = 2 E(y) + E(y)²."""
    halvings = max(0, 1 + int(np.frexp(np.abs(matrix).sum(axis=-2).max())[1]))
    small = matrix * 0.5**halvings
    less_one = np.zeros_like(matrix)
    for k in range(_TERMS, 0, -1):
        less_one = (small + product(small, less_one)) / k
    for _ in range(halvings):
        less_one = 2.0 * less_one + product(less_one, less_one)
    return np.asarray(less_one + np.eye(matrix.shape[-1]))


def riccati(A: np.ndarray, G: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return the stabilising P = Q + Aᵀ P (I + G P)⁻¹ A, all (..., n, n), for symmetric G and Q >= 0.

    With A_0 = A, G_0 = G, P_0 = Q and W = (I + G_k P_k)⁻¹,

        A_(k+1) = A_k W A_k,    G_(k+1) = G_k + A_k W G_k A_kᵀ,    P_(k+1) = P_k + A_kᵀ P_k W A_k.

    A_k goes to zero like the 2^k-th power of the closed loop. P is nan where A_k does not go to zero, or where the
    equation does not hold at the end.
    """
    n, power, grown, P = A.shape[-1], A, G, Q
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            both = solved(np.eye(n) + product(grown, P), np.concatenate([power, grown], axis=-1))
            of_power, of_grown, transposed = both[..., :n], both[..., n:], np.swapaxes(power, -1, -2)
            grown = grown + product(product(power, of_grown), transposed)
            P = P + product(product(transposed, P), of_power)
            power = product(power, of_power)
            if not np.any(np.abs(power) > _FORGOTTEN):
                break
        again = Q + product(product(np.swapaxes(A, -1, -2), P), solved(np.eye(n) + product(G, P), A))
        size = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
        holds = np.abs(again - P) <= _RESIDUAL * size[..., np.newaxis] * size[..., np.newaxis, :]
        forgotten = np.abs(power) <= _FORGOTTEN
    return np.where((holds & forgotten).all(axis=(-1, -2), keepdims=True), P, np.nan)
