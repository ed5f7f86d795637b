"""The claims of a controller file, proven again from its stored gains in exact rational arithmetic."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fuzzyarm.common.checks import instance
from fuzzyarm.fuzzy_policy.controller import POLE_ARRAYS, Controller
from fuzzyarm.proof import consistent_reference, theorems
from fuzzyarm.proof.definiteness import exact, is_positive_definite, smallest_eigenvalue, stated
from fuzzyarm.proof.statement import statement
from fuzzyarm.proof.vertices import TrackingVertices, error_vertices, tracking_vertices

__all__ = ["Certificate", "Claim", "certify", "claim", "inequality_name"]


@dataclasses.dataclass(frozen=True)
class Claim:
    """One matrix inequality and the outcome of its proof."""

    name: str  # the inequality, as in "Psi_1,2,1 + Psi_2,1,1 < 0"
    proven: bool  # whether it is proven in exact arithmetic
    # smallest eigenvalue of the matrix that has to be positive definite, scaled to unit diagonal, in floating point. It
    # tells how far the inequality is from failing and is no part of the proof.
    proof_margin: float


@dataclasses.dataclass(frozen=True)
class Certificate:
    """The outcome of `certify`."""

    claims: tuple[Claim, ...]  # every inequality
    statement: str  # what they prove together, in words

    @property
    def proven(self) -> bool:
        """Whether every inequality is proven."""
        return all(claim.proven for claim in self.claims)

    @property
    def proof_margin(self) -> float:
        """The smallest proof margin of all inequalities, a number without unit."""
        return min(claim.proof_margin for claim in self.claims)


def certify(controller: Controller, progress: Callable[[], None] | None = None) -> Certificate:
    """Prove P > 0 and every inequality of the controller's form, from the stored gains (M := K P).

    Those are Ψ of its theorem and, for a bound of the fastest pole, Φ of `consistent_reference`.
    The vertices are computed from the robot parameters; all arithmetic is exact and rational (`exact`). α, γ and the
    bound of the fastest pole are the decimal numbers that are printed (`stated`), every other float is what it is.
    `progress` is called after each inequality.
    """
    given = instance("controller", controller, Controller)
    shape: dict[str, bool] = {"common_multiplier": given.common_multiplier, "rationals": True}
    data = (
        error_vertices(given.model, given.integral, **shape)
        if given.weight is None
        else tracking_vertices(given.model, given.integral, given.weight, **shape)
    )
    P, Q, X, tau = exact(controller.P), exact(controller.Q), exact(controller.X), exact(controller.tau)
    gains, L = exact(controller.gains), exact(controller.feedforward_gains)
    alpha, gamma = stated(controller.alpha), stated(controller.gamma)
    M = gains @ P[: data.n_e, : data.n_e]

    def psi(i: int, j: int, k: int, position: int) -> np.ndarray:
        common = {"alpha": alpha, "gamma2": gamma * gamma, "P": P, "M": M[j, k], "Q": Q[position], "X": X[position]}
        if isinstance(data, TrackingVertices):
            return np.asarray(theorems.psi(data, i, k, **common, L=L[j, k], tau=tau[position, k]))
        return np.asarray(consistent_reference.psi(data, i, k, **common, tau=tau[position, k]))

    families = {"Psi": psi}
    if controller.fastest_pole is not None:
        fastest_pole = stated(controller.fastest_pole)
        pole_Q, pole_X, pole_tau = (exact(getattr(controller, name)) for name in POLE_ARRAYS)

        def phi(i: int, j: int, k: int, position: int) -> np.ndarray:
            slack = {"Q": pole_Q[position], "X": pole_X[position], "tau": pole_tau[position, k]}
            return np.asarray(consistent_reference.phi(data, i, k, fastest_pole=fastest_pole, P=P, M=M[j, k], **slack))

        families["Phi"] = phi

    claims = [claim("P > 0", P)]
    for letter, inequality in families.items():
        for position, (i, j) in enumerate(data.pairs):
            for k in range(len(data.E)):
                matrix = -inequality(i, j, k, position)
                if i != j:
                    matrix = matrix - inequality(j, i, k, position)
                claims.append(claim(inequality_name(letter, i, j, k), matrix))
                if progress:
                    progress()
    return Certificate(tuple(claims), statement(controller))


def inequality_name(letter: str, i: int, j: int, k: int) -> str:
    """Return the name of the inequality of vertices i <= j of A and k of E, all from 0, as in `Claim`."""
    first, second = f"{letter}_{i + 1},{j + 1},{k + 1}", f"{letter}_{j + 1},{i + 1},{k + 1}"
    return f"{first} < 0" if i == j else f"{first} + {second} < 0"


def claim(name: str, matrix: np.ndarray) -> Claim:
    """Return the claim that a matrix (s, s) of exact rational numbers is positive definite, and its outcome."""
    return Claim(name, is_positive_definite(matrix), smallest_eigenvalue(matrix))
