"""The claims of a controller of the form "semidefinite", proven again from its stored values.

*Scalar loop.* The loop has three states for any number of joints. In the coordinates ε = M̂^(1/2) e of the scheduled
inertia M̂, the error of each joint obeys the same loop, with λ an eigenvalue of M̂^(1/2) M̄⁻¹ M̂^(1/2), between 1/κ and 1:

    x' = (A - λ b k) x + λ b d,    x = (ε, ε', ∫ε),    A = [[0 1 0], [0 0 0], [1 0 0]],    b = (0, 1, 0)ᵀ.

V = xᵀ X x falls at least as fast as exp(-2αt), with an L2 gain γ from d to ε (the sum over all joints is V below), if
X > 0 and, with P = X⁻¹ and m = k P, in which both inequalities are linear,

    | He(A P - λ b m) + 2 (α + μ) P   λ b   P cᵀ |
    | ⋆                               -γ²   0    | < 0,     c = (1 0 0),
    | ⋆                               ⋆     -1   |

for λ = 1/κ and λ = 1, since the matrix is affine in λ; μ bounds the rate of M̂. If at both

    | βP            ⋆  |
    | A P - λ b m   βP | > 0,

then (A - λ b k)ᵀ X (A - λ b k) < β² X, and no pole of the loop frozen at a state has a modulus above β.

*Proof.* These inequalities are proven in exact rationals. The bounds on the inertia (`inertia_bounds`) are proven on
covers of boxes (`box_cover`) and, on request, again in balls (`proven_in_balls`).

*Theorem*, for the rigid arm in continuous time, while its angles and the speeds of its kept angles stay in the box:

    V' + 2αV + eᵀ M̂ e - γ² dᵀ M̂⁻¹ d <= 0,      V = (e, ė, x_I)ᵀ (X ⊗ M̂) (e, ė, x_I).

α, γ, κ, β, μ and σ, where σ I < M̂, have the printed decimal values; every other float has its exact binary value.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from flint import fmpq

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController
from fuzzyarm.fuzzy_policy.ts_model import SCALAR_STATES
from fuzzyarm.proof.block_matrix import Assembly, he, identity, symmetric
from fuzzyarm.proof.box_cover import TrigMatrix, cover, proven_in_balls
from fuzzyarm.proof.certificate import NOT_COVERED, PROVEN, Certificate, Claim, decay_words
from fuzzyarm.proof.definiteness import exact, inverse, largest_growth, smallest_eigenvalue, stated
from fuzzyarm.proof.inertia_bounds import inertia_bounds

__all__ = ["certify_scheduled", "decay", "fastest", "schedule_rate", "scheduled_statement"]


def _scalar_loop() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A (3, 3), b (3, 1) and c (1, 3) of the scalar loop x' = (A - λ b k) x + λ b d, ε = c x, in integers."""
    unit = identity(SCALAR_STATES)
    return np.array([unit[1], 0 * unit[0], unit[0]]), unit[:, 1:2], unit[:1]


def decay(share: Any, *, rate: Any, gamma2: Any, P: Any, m: Any, put: Assembly = symmetric) -> Any:
    """Return the matrix of decay and gain, (5, 5), which must be negative definite.

    `share` is λ, `rate` is α + μ [1/s], `gamma2` is γ² [s⁴], P is (3, 3), and m = k P is (1, 3) with the
    feedback k; `put` assembles a matrix from block rows.
    """
    A, b, c = _scalar_loop()
    state = he(A @ P - b @ (share * m)) + 2 * rate * P
    return put([[state], [share * b.T, -gamma2 * identity(1)], [c @ P, 0, -identity(1)]])


def fastest(share: Any, *, pole: Any, P: Any, m: Any, put: Assembly = symmetric) -> Any:
    """Return the matrix (6, 6) that bounds poles by β = `pole` [1/s] if positive definite; others as for `decay`."""
    A, b, _ = _scalar_loop()
    return put([[pole * P], [A @ P - b @ (share * m), pole * P]])


def certify_scheduled(
    controller: ScheduledController, *, in_balls: bool = False, progress: Callable[[], None] | None = None
) -> Certificate:
    """Prove every claim of a controller; `Certificate.proven` says whether all of them hold.

    The inertia is computed from the controller's robot. With `in_balls`, each box is also proven in ball arithmetic,
    which takes longer. `progress` is called after each claim.
    """
    claims = _loop_claims(controller)
    # The cheap claims come first: a file with gains that do not fit is refused at once.
    if all(one.proven for one in claims):
        for name, polynomial, ranges in inertia_bounds(controller):
            claims.append(_inertia_claim(name, polynomial, ranges, in_balls))
            if progress:
                progress()
            if not claims[-1].proven:
                break
    found = Certificate(tuple(claims), scheduled_statement(controller))
    if found.proven:
        PROVEN.add(controller.digest)
    return found


def schedule_rate(controller: ScheduledController) -> fmpq:
    """Return μ = Σ μ_k |q̇_k| [1/s], a bound on half the relative rate of change of M̂, as an exact rational."""
    pairs = zip(controller.rates.tolist(), controller.speeds.tolist(), strict=True)
    return sum((stated(rate) * stated(speed) for rate, speed in pairs), fmpq(0))


def _loop_claims(controller: ScheduledController) -> list[Claim]:
    X, k = exact(controller.lyapunov), exact(controller.feedback[np.newaxis])
    rate, gamma = stated(controller.alpha) + schedule_rate(controller), stated(controller.gamma)
    claims, P = [Claim.of("X > 0", X)], inverse(X)
    if P is None:
        P = 0 * X  # no claim about this P is proven
    m, pole = k @ P, stated(controller.fastest_pole)
    for name, share in (("1/kappa", 1 / stated(controller.kappa)), ("1", fmpq(1))):
        matrix = -np.asarray(decay(share, rate=rate, gamma2=gamma * gamma, P=P, m=m))
        claims.append(Claim.of(f"decay and gain at lambda = {name}", matrix))
        claims.append(Claim.of(f"fastest pole at lambda = {name}", np.asarray(fastest(share, pole=pole, P=P, m=m))))
    return claims


def _inertia_claim(name: str, polynomial: np.ndarray, ranges: np.ndarray, in_balls: bool) -> Claim:
    matrix, needed = TrigMatrix(polynomial).needed()
    boxes, witness = cover(matrix, ranges[needed])
    name = f"{name}, {len(boxes)} boxes of {matrix.angles} angles"
    where = boxes.mean(axis=2) if witness is None else witness[np.newaxis]
    margin = min(map(smallest_eigenvalue, matrix.at(where)))
    if witness is not None:
        return Claim(f"{name}; not at {witness.round(4).tolist()} rad", False, margin)
    proven = proven_in_balls(matrix, boxes) if in_balls else True
    return Claim(name + (", also in balls" if in_balls and proven else ""), proven, margin)


def scheduled_statement(controller: ScheduledController) -> str:
    """Return a statement of what the certificate proves and what it does not, with the values of this controller."""
    robot, kept = controller.robot, controller.premises
    ranges = ", ".join(
        f"[{at_most(low, 6)}, {at_least(high, 6)}]" for low, high in (joint.angle_range for joint in robot.joints)
    )
    speeds = ", ".join(
        f"|dq{premise.joint + 1}/dt| <= {at_least(speed, 6)} rad/s"
        for premise, speed in zip(kept, controller.speeds, strict=True)
    )
    alpha, beta = at_least(controller.alpha, 6), at_most(controller.fastest_pole, 6)
    # γ/σ [rad/(N m)], rounded up, bounds the L2 gain from the torques d to the position error in Euclidean norms.
    euclid = stated(controller.gamma) / stated(controller.floor)
    gain = float(np.nextafter(int(euclid.p) / int(euclid.q), np.inf))
    # V = xᵀ (X ⊗ M̂) x, where M̂ > σ I is a mean of the S_r; each S_r is at most its largest absolute row sum times I.
    heaviest = np.abs(controller.inertia).sum(axis=-1).max() / controller.floor
    growth = (heaviest * largest_growth(controller.lyapunov, size) for size in (len(controller.lyapunov), 1))
    return (
        f"For the rigid arm of {len(robot)} joints in continuous time, as long as it stays in the box, angles in "
        f"{ranges} rad{' and ' + speeds if speeds else ', at any speed'}, and for every twice differentiable "
        f"reference: without disturbance {decay_words(alpha, *growth)}; and the poles of the loop frozen at any "
        f"such state have real parts below -{alpha} 1/s and moduli of at most {beta} 1/s. From zero error the L2 "
        f"gain from the disturbance torque d to the position error is at most {at_most(controller.gamma, 3)} s^2 in "
        f"the norms of the scheduled inertia, and so at most {at_most(gain, 3)} rad/(N m). "
        f"d holds friction other than viscous, tip forces and payload as joint torques. {NOT_COVERED}"
    )
