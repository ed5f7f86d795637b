"""The claims of a controller file, proven again from its stored gains in exact rational arithmetic."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.common.checks import instance
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.controller import POLE_ARRAYS, Controller
from fuzzyarm.proof._theorems import error_phi, error_psi, tracking_psi
from fuzzyarm.proof.definiteness import exact, is_positive_definite, largest_growth, smallest_eigenvalue, stated
from fuzzyarm.proof.vertices import TrackingVertices, error_vertices, tracking_vertices

__all__ = ["NOT_COVERED", "PROVEN", "Certificate", "Claim", "certify", "controller_statement", "decay_words"]

# The limits that every certificate states.
NOT_COVERED = (
    "Not covered: the elastic joints, sampling and hold, measurement noise, torque limits, and any motion that leaves "
    "the box; those are measured, not proven."
)
_ERROR = "the tracking error x = (e, de/dt, integral of e if it is fed back) in rad and s"
_OF_THE_TIP = (
    " For the tip of the elastic, sampled arm, fuzzyarm prove can prove a bound along one motion and for a set of "
    "plants."
)


@dataclasses.dataclass(frozen=True)
class Claim:
    """One matrix inequality and the outcome of its proof."""

    name: str  # the inequality, as in "Psi_1,2,1 + Psi_2,1,1 < 0"
    proven: bool  # whether it is proven in exact arithmetic
    # smallest eigenvalue of the matrix that must be positive definite, scaled to unit diagonal, in floating point. It
    # shows how far the inequality is from failing and is not a part of the proof.
    proof_margin: float

    @classmethod
    def of(cls, name: str, matrix: np.ndarray) -> Claim:
        """Return the claim that a matrix (s, s) of exact rational numbers is positive definite, and its outcome."""
        return cls(name, is_positive_definite(matrix), smallest_eigenvalue(matrix))


@dataclasses.dataclass(frozen=True)
class Certificate:
    """The outcome of the proof of a controller's inequalities."""

    claims: tuple[Claim, ...]  # every inequality
    statement: str  # their joint meaning in words

    @property
    def proven(self) -> bool:
        """Whether every inequality is proven."""
        return all(claim.proven for claim in self.claims)

    @property
    def proof_margin(self) -> float:
        """The smallest `Claim.proof_margin` of all inequalities, a number without a unit."""
        return min(claim.proof_margin for claim in self.claims)


PROVEN: set[str] = set()
"""Digests of the controllers that this process has proven; a change of any stored number changes the digest."""


def certify(controller: Controller, progress: Callable[[], None] | None = None) -> Certificate:
    """Prove P > 0 and every inequality of the controller's form, from the stored gains (M := K P).

    The inequalities are Ψ of its theorem and, with a bound on the fastest pole, Φ (`_theorems`).
    The vertices are computed from the robot parameters; all arithmetic is exact and rational (`exact`). α, γ and the
    bound on the fastest pole have the printed decimal values (`stated`), every other float its exact binary value.
    `progress` is called after each inequality.
    """
    given = instance("controller", controller, Controller)
    shape: dict[str, bool] = {"common_multiplier": given.common_multiplier, "rationals": True}
    data = (
        error_vertices(given.model, given.integral, **shape)
        if given.weight is None
        else tracking_vertices(given.model, given.integral, given.weight, **shape)
    )
    P, gains, L = exact(controller.P), exact(controller.gains), exact(controller.feedforward_gains)
    alpha, gamma, pole = stated(controller.alpha), stated(controller.gamma), controller.fastest_pole
    M = gains @ P[: data.n_e, : data.n_e]
    slack = {"Psi": ("Q", "X", "tau")} | ({} if pole is None else {"Phi": POLE_ARRAYS})
    arrays = {letter: [exact(getattr(controller, name)) for name in names] for letter, names in slack.items()}

    def inequality(letter: str, i: int, j: int, k: int, position: int) -> np.ndarray:
        Q, X, tau = arrays[letter]
        given: dict[str, Any] = {"P": P, "M": M[j, k], "Q": Q[position], "X": X[position], "tau": tau[position, k]}
        if letter == "Phi" and pole is not None:
            return np.asarray(error_phi(data, i, k, fastest_pole=stated(pole), **given))
        given |= {"alpha": alpha, "gamma2": gamma * gamma}
        if isinstance(data, TrackingVertices):
            return np.asarray(tracking_psi(data, i, k, L=L[j, k], **given))
        return np.asarray(error_psi(data, i, k, **given))

    claims = [Claim.of("P > 0", P)]
    for letter in arrays:
        for position, (i, j) in enumerate(data.pairs):
            for k in range(len(data.E)):
                matrix = -inequality(letter, i, j, k, position)
                if i != j:
                    matrix = matrix - inequality(letter, j, i, k, position)
                claims.append(Claim.of(_inequality_name(letter, i, j, k), matrix))
                if progress:
                    progress()
    found = Certificate(tuple(claims), controller_statement(controller))
    if found.proven:
        PROVEN.add(controller.digest)
    return found


def _inequality_name(letter: str, i: int, j: int, k: int) -> str:
    """Return the name, as in `Claim`, of the inequality for vertices i <= j of A and k of E, counted from 0."""
    first, second = f"{letter}_{i + 1},{j + 1},{k + 1}", f"{letter}_{j + 1},{i + 1},{k + 1}"
    return f"{first} < 0" if i == j else f"{first} + {second} < 0"


def controller_statement(controller: Controller) -> str:
    """Return a statement of what the certificate proves and what it does not, with the values of this controller."""
    p, model = controller.model.parameters, controller.model
    # The proof also covers a smaller box, a smaller decay rate, a wider strip of poles and a larger gain.
    angles, speeds = (", ".join(at_least(x, 6) for x in limit) for limit in (p.joint_limit, p.velocity_limit))
    alpha, gamma, strip = at_least(controller.alpha, 6), at_most(controller.gamma, 3), ""
    box = (
        f"For the rigid arm in continuous time, as long as it stays in the box |q| <= ({angles}) rad, |dq/dt| <= "
        f"({speeds}) rad/s, and for every twice differentiable reference: "
    )
    if controller.form == "paper":
        both = decay_words(alpha, largest_growth(controller.P, len(controller.P)), x="x = (error, x_r)")
        claim = (
            "with V over error and reference model, dV/dt + e'Qe - gamma^2 w'w + 2 alpha V < 0, w = (d, r): where w "
            f"vanishes {both}, and from zero initial conditions the L2 gain from w to Q^(1/2) e is at most {gamma}. "
            "d is friction, tip forces and payload as joint torques. "
        )
        return box + claim + NOT_COVERED + _OF_THE_TIP
    dropped = [name for u in model.uncertainties for name in u.premises]
    residual = f", and the feedforward residual of the dropped premises {', '.join(dropped)}" if dropped else ""
    if controller.fastest_pole is not None:
        beta = at_most(controller.fastest_pole, 6)
        strip = (
            f"; the root of V = x'P^-1 x decays no faster than exp(-{beta} t), so that the poles of the loop frozen at "
            f"any such state have real parts between -{beta} and -{alpha} 1/s"
        )
    growth = (largest_growth(controller.P, size) for size in (len(controller.P), JOINTS))
    claim = (
        f"without disturbance {decay_words(alpha, *growth)}{strip}; and from zero error the L2 gain from the "
        f"disturbance torque d to the position error is at most {gamma} rad/(N m). d "
        f"holds friction, tip forces and payload as joint torques{residual}. "
    )
    return box + claim + NOT_COVERED + _OF_THE_TIP


def decay_words(alpha: str, *growth: float, x: str = _ERROR) -> str:
    """Return a sentence saying that the errors, named `x`, decay as exp(-αt), α [1/s].

    `growth` is c² in |x(t)| <= c exp(-αt) |x(0)| and, optionally, c² in the same bound for e if only e(0) is nonzero.
    """
    c = [at_most(math.sqrt(one) * (1.0 + 1e-12), 4) if math.isfinite(one) else "C" for one in growth]
    words = f"{x} decays at least as exp(-{alpha} t) up to a constant, |x(t)| <= {c[0]} exp(-{alpha} t) |x(0)|"
    return words + f", and |e(t)| <= {c[-1]} exp(-{alpha} t) |e(0)| if only e is nonzero initially" * (len(c) > 1)
