"""What a controller file claims, recomputed from its stored gains."""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.inequality import error_model, psi

# Eigenvalues are taken of matrices scaled to unit diagonal; rounding moves them by less than about 1e-13.
REQUIRED_MARGIN = 1e-9


@dataclasses.dataclass(frozen=True)
class Certificate:
    """The outcome of `certify`: the margin of every inequality, and what follows.

    Attributes:
        margins: name of the inequality -> smallest eigenvalue of its negative, scaled to unit diagonal (of P: of
            itself); positive means it holds.
        statement: what the inequalities prove, and what they do not, in words.
    """

    margins: dict[str, float]
    statement: str

    @property
    def margin(self) -> float:
        """The smallest margin."""
        return min(self.margins.values())

    @property
    def holds(self) -> bool:
        """Whether every margin is above `REQUIRED_MARGIN`, far above the rounding of the check itself."""
        return self.margin > REQUIRED_MARGIN


def certify(controller: Controller) -> Certificate:
    """Form every inequality of `inequality.psi` from the stored gains (M := K P) and return the margins.

    The eigenvalues are computed in double precision: far beyond what a solver's status says, short of a proof in
    exact arithmetic.
    """
    system = error_model(controller.model, controller.integral)
    margins = {"P": _margin(controller.P)}
    for position, (i, j) in enumerate(system.pairs):
        for k in range(len(system.E)):
            ordered = [(i, j)] if i == j else [(i, j), (j, i)]
            total = sum(
                psi(
                    system,
                    first,
                    k,
                    alpha=controller.alpha,
                    gamma2=controller.gamma**2,
                    P=controller.P,
                    M=controller.gains[second, k] @ controller.P,
                    Q=controller.Q[position],
                    X=controller.X[position],
                    tau=controller.tau[position, k],
                )
                for first, second in ordered
            )
            margins[f"Psi(i={i + 1}, j={j + 1}, k={k + 1})"] = _margin(-total)
    return Certificate(margins, statement(controller))


def statement(controller: Controller) -> str:
    """Return what the certificate proves and what it does not, with the numbers of this controller."""
    p = controller.model.parameters
    dropped = [u.premise for u in controller.model.uncertainties]
    residual = f", and the feedforward residual of the dropped premises {', '.join(dropped)}" if dropped else ""
    return (
        f"For the rigid arm in continuous time, as long as |q| <= ({p.joint_limit[0]:.6g}, {p.joint_limit[1]:.6g}) rad "
        f"and |dq/dt| <= ({p.velocity_limit[0]:g}, {p.velocity_limit[1]:g}) rad/s, and for every twice differentiable "
        f"reference: without disturbance the tracking error decays at least as exp(-{controller.alpha:g} t), and from "
        f"zero error the L2 gain from the disturbance torque d to the position error is at most "
        f"{controller.gamma:.3g} rad/(N m). d holds friction, tip forces and payload as joint torques{residual}. "
        "Not covered: the elastic joints, sampling and hold, measurement noise, torque limits, and any motion that "
        "leaves the box; those are measured, not proven."
    )


def _margin(matrix: np.ndarray) -> float:
    """Return the smallest eigenvalue of a symmetric matrix scaled to unit diagonal; -inf if that cannot be done."""
    diagonal = np.diag(matrix)
    if not (np.isfinite(matrix).all() and (diagonal > 0.0).all()):
        return -np.inf
    scale = 1.0 / np.sqrt(diagonal)
    scaled = scale[:, np.newaxis] * matrix * scale
    return float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
