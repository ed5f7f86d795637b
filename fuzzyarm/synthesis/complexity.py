"""Size of the design problem: by the paper's formula (Remark 4, Table 2), as a theorem states it, and as solved.

The paper counts, with N vertices of A, N_e of E, n_x states, n_d disturbances and n_u inputs of the plant,

    N_var = 6 + n_x (1 + 3N² + N_e N² + n_d),        N_row = 6 n_x (1 + N N_e) + n_x N (8 n_x N + N_e n_u),

the reading that reproduces all eight numbers of Table 2. That is a formula, not the size of the semidefinite program.
For the error model (n, N, N_e; n_e, n_r columns of M, L; m uncertainties of r rows in all) with N(N + 1)/2 pairs i <= j
one counts instead

    variables:  |P| + N N_e n_u (n_e + n_r) + N(N + 1)/2 (s + N_e m) + 1,
    rows:       p + N(N + 1)/2 N_e (n + n' + n_w + n_z + r),

with s = 2n², n' = n, p = n for the full inequality and s = 2n + 4, n' = 2, p = n_e for the reduced one (`reduced`).
"""

from __future__ import annotations

import dataclasses

from fuzzyarm.synthesis.error_model import ErrorModel
from fuzzyarm.synthesis.reduced import INPUT_ROWS

__all__ = ["Size", "full_size", "paper_formula", "reduced_size"]


@dataclasses.dataclass(frozen=True)
class Size:
    """The size of a design problem.

    Attributes:
        variables: scalar decision variables.
        rows: sum of the orders of all matrix inequalities.
    """

    variables: int
    rows: int


def paper_formula(N: int, N_e: int = 2, *, n_x: int = 4, n_d: int = 2, n_u: int = 2) -> Size:
    """Return N_var and N_row of Remark 4.

    Args:
        N: vertices of A, half the number of rules where z1 is kept.
        N_e: vertices of E.
        n_x: states of the plant.
        n_d: disturbances.
        n_u: inputs.
    """
    return Size(
        variables=6 + n_x * (1 + 3 * N**2 + N_e * N**2 + n_d),
        rows=6 * n_x * (1 + N * N_e) + n_x * N * (8 * n_x * N + N_e * n_u),
    )


def full_size(system: ErrorModel, *, gains_bounded: bool = False) -> Size:
    """Return the size of P > 0 and Ψ_ijk + Ψ_jik < 0 for all i <= j and k, as Theorems 1 and 2 state them.

    Args:
        system: the error model, scaled or not.
        gains_bounded: whether the gains are bounded too, see `conic.Problem`; the variable is then that bound, not γ².
    """
    n = len(system.B)
    return _size(system, slack=2 * n * n, derivative_rows=n, rows_of_P=n, gains_bounded=gains_bounded)


def reduced_size(system: ErrorModel, *, gains_bounded: bool = False) -> Size:
    """Return the size of the same problem as `conic.program` writes it; P_22 > 0 follows from A_r and is left out."""
    n, b = len(system.B), len(INPUT_ROWS)
    return _size(
        system, slack=b * n + b * b, derivative_rows=b, rows_of_P=system.blocks[0], gains_bounded=gains_bounded
    )


def _size(system: ErrorModel, *, slack: int, derivative_rows: int, rows_of_P: int, gains_bounded: bool) -> Size:
    """Return the counts above."""
    n, n_u = system.B.shape
    vertices, pairs, N_e = len(system.A) * len(system.E), len(system.pairs), len(system.E)
    n_e, m = system.blocks[0], len(system.uncertainties)
    n_r = len(system.feedforward) if system.given_L is None else 0
    n_w, n_z, r = system.D[0].shape[1], len(system.C), sum(len(u.H) for u in system.uncertainties)
    upper = sum(size * (size + 1) // 2 for size in system.blocks)
    bounds = vertices * (n_u + n_e) if gains_bounded else 0
    return Size(
        variables=upper + vertices * n_u * (n_e + n_r) + pairs * (slack + N_e * m) + 1,
        rows=rows_of_P + pairs * N_e * (n + derivative_rows + n_w + n_z + r) + bounds,
    )
