"""Size of the design problem: by the paper's formula (Remark 4, Table 2), and counted from the inequalities.

The paper counts, with N vertices of A, N_e of E, n_x states, n_d disturbances and n_u inputs of the plant,

    N_var = 6 + n_x (1 + 3N² + N_e N² + n_d),        N_row = 6 n_x (1 + N N_e) + n_x N (8 n_x N + N_e n_u),

in the reading that reproduces all eight numbers of Table 2. This is not the size of the semidefinite program: with n,
n_e and n_r columns of P, M and L, ν free entries of P, n_w and n_z entries of w and z, m uncertain terms with r rows in
total and N(N + 1)/2 pairs i <= j, the program has

    variables:  ν + N N_e n_u (n_e + n_r) + N(N + 1)/2 (2n² + N_e m) + 1,
    rows:       n + N(N + 1)/2 N_e (2n + n_w + n_z + r).

The problem that is solved is smaller; `Design` states its size.
"""

import dataclasses

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.ts_model import PLANT_STATES
from fuzzyarm.proof.vertices import TrackingVertices, Vertices

__all__ = ["full_size", "paper_formula"]


@dataclasses.dataclass(frozen=True)
class _Size:
    """The size of a design problem: variables and rows."""

    variables: int  # scalar decision variables
    rows: int  # sum of the orders of all matrix inequalities


def paper_formula(N: int, N_e: int = 2, *, n_x: int = 4, n_d: int = 2, n_u: int = 2) -> _Size:
    """Return N_var and N_row of Remark 4; N is the number of rules, or half of that if z1 is kept."""
    return _Size(
        variables=6 + n_x * (1 + 3 * N**2 + N_e * N**2 + n_d),
        rows=6 * n_x * (1 + N * N_e) + n_x * N * (8 * n_x * N + N_e * n_u),
    )


def full_size(data: Vertices, *, gains_bounded: bool = False) -> _Size:
    """Return how many variables and rows P > 0 and Ψ_ijk + Ψ_jik < 0, for all i <= j and k, have with L free.

    With `gains_bounded`, [[gI, M_jk], [M_jkᵀ, P11]] >= 0 is added, and g replaces γ² as a variable.
    """
    paper, n_e, N_e, pairs = isinstance(data, TrackingVertices), data.n_e, len(data.E), len(data.pairs)
    blocks = (n_e, PLANT_STATES) if paper else (n_e,)
    n_r, n_z = (3 * JOINTS, PLANT_STATES) if paper else (0, JOINTS)
    n, vertices = sum(blocks), len(data.A) * N_e
    m, r = len(data.uncertainties), sum(len(term.H) for term in data.uncertainties)
    upper = sum(size * (size + 1) // 2 for size in blocks)
    return _Size(
        variables=upper + vertices * JOINTS * (n_e + n_r) + pairs * (2 * n * n + N_e * m) + 1,
        rows=n + pairs * N_e * (2 * n + JOINTS + n_r + n_z + r) + gains_bounded * vertices * (JOINTS + n_e),
    )
