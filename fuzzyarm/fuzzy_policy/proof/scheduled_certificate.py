"""The claims of a controller of the form "semidefinite", proven anew from its stored numbers.

The inequalities of `scalar_loop` are proven in exact rationals, the bounds of the inertia on covers of boxes, in
floating point with a bound of all rounding errors (`box_cover`) and, if asked for, again in balls (`proven_in_balls`).
Theorem, for the rigid arm in continuous time, while its angles and the speeds of its kept angles stay in the box:

    V' + 2αV + eᵀ M̂ e - γ² dᵀ M̂⁻¹ d <= 0,      V = (e, ė, x_I)ᵀ (X ⊗ M̂) (e, ė, x_I).

α, γ, κ, σ, β and μ are the decimal numbers that are printed, every other float is what it is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from flint import fmpq

from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.fuzzy_policy.proof.box_cover import cover, proven_in_balls
from fuzzyarm.fuzzy_policy.proof.certificate import Certificate, Claim, claim
from fuzzyarm.fuzzy_policy.proof.definiteness import exact, inverse, largest_growth, smallest_eigenvalue, stated
from fuzzyarm.fuzzy_policy.proof.inertia_bounds import Bound, bounds
from fuzzyarm.fuzzy_policy.proof.policy_certificate import NOT_COVERED, decay_words
from fuzzyarm.fuzzy_policy.proof.scalar_loop import decay, fastest
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController

__all__ = [
    "certify_scheduled",
    "euclidean_gain",
    "schedule_rate",
    "scheduled_statement",
]


def certify_scheduled(
    controller: ScheduledController, *, in_balls: bool = False, progress: Callable[[], None] | None = None
) -> Certificate:
    """Prove every claim of a controller; `Certificate.proven` says whether all of them hold.

    Args:
        controller: its claims are taken from its stored numbers, its inertia is computed from its robot.
        in_balls: whether to prove each box again in balls, which takes longer.
        progress: called after each claim.
    """
    claims = _loop_claims(controller)
    # The cheap claims come first: a file whose gains do not fit is refused at once.
    if all(one.proven for one in claims):
        for bound in bounds(controller):
            claims.append(_covered(bound, in_balls))
            if progress:
                progress()
            if not claims[-1].proven:
                break
    return Certificate(tuple(claims), scheduled_statement(controller))


def schedule_rate(controller: ScheduledController) -> fmpq:
    """Return μ = Σ μ_k |q̇_k| [1/s], a bound of half the rate of M̂ relative to M̂, in exact rationals."""
    pairs = zip(controller.rates.tolist(), controller.speeds.tolist(), strict=True)
    return sum((stated(rate) * stated(speed) for rate, speed in pairs), fmpq(0))


def euclidean_gain(controller: ScheduledController) -> fmpq:
    """Return γ/σ [rad/(N m)], a bound of the L2 gain from the torques d to the position error in Euclidean norms."""
    return stated(controller.gamma) / stated(controller.floor)


def _loop_claims(controller: ScheduledController) -> list[Claim]:
    X, k = exact(controller.lyapunov), exact(controller.feedback[np.newaxis])
    rate, gamma = stated(controller.alpha) + schedule_rate(controller), stated(controller.gamma)
    claims = [claim("X > 0", X)]
    P = inverse(X)
    if P is None:
        P = 0 * X  # of which nothing is proven
    m = k @ P
    for name, share in (("1/kappa", 1 / stated(controller.kappa)), ("1", fmpq(1))):
        matrix = -np.asarray(decay(share, rate=rate, gamma2=gamma * gamma, P=P, m=m))
        claims.append(claim(f"decay and gain at lambda = {name}", matrix))
        pole = stated(controller.fastest_pole)
        claims.append(claim(f"fastest pole at lambda = {name}", np.asarray(fastest(share, pole=pole, P=P, m=m))))
    return claims


def _covered(bound: Bound, in_balls: bool) -> Claim:
    outcome = cover(bound.matrix, bound.ranges)
    name = f"{bound.name}, {len(outcome.boxes)} boxes of {bound.matrix.angles} angles"
    if outcome.witness is not None:
        return Claim(f"{name}; not at {outcome.witness.round(4).tolist()} rad", False, _margin(bound, outcome.witness))
    proven = proven_in_balls(bound.matrix, outcome.boxes) if in_balls else True
    centers = outcome.boxes.mean(axis=2)
    return Claim(name + (", also in balls" if in_balls and proven else ""), proven, _margin(bound, centers))


def _margin(bound: Bound, angles: np.ndarray) -> float:
    matrices = bound.matrix.at(np.atleast_2d(angles))
    return min(smallest_eigenvalue(matrix) for matrix in matrices)


def scheduled_statement(controller: ScheduledController) -> str:
    """Return what the certificate proves and what it does not, with the numbers of this controller."""
    robot, kept = controller.robot, controller.premises
    ranges = ", ".join(
        f"[{at_most(low, 6)}, {at_least(high, 6)}]" for low, high in (joint.angle_range for joint in robot.joints)
    )
    speeds = ", ".join(
        f"|dq{premise.joint + 1}/dt| <= {at_least(speed, 6)} rad/s"
        for premise, speed in zip(kept, controller.speeds, strict=True)
    )
    alpha, beta = at_least(controller.alpha, 6), at_most(controller.fastest_pole, 6)
    euclid = euclidean_gain(controller)
    # V = xᵀ (X ⊗ M̂) x, where M̂ > σ I is a mean of the S_r, which are at most their largest sum of a row.
    heaviest = np.abs(controller.inertia).sum(axis=-1).max() / controller.floor
    growth = (heaviest * largest_growth(controller.lyapunov, size) for size in (len(controller.lyapunov), 1))
    return (
        f"For the rigid arm of {len(robot)} joints in continuous time, as long as it stays in the box, angles in "
        f"{ranges} rad{' and ' + speeds if speeds else ', at any speed'}, and for every twice differentiable "
        f"reference: without disturbance {decay_words(alpha, *growth)}; and the poles of the loop frozen at any "
        f"such state have real parts below -{alpha} 1/s and moduli of at most {beta} 1/s. From zero error the L2 "
        f"gain from the disturbance torque d to the position error is at most {at_most(controller.gamma, 3)} s^2 in "
        f"the norms of the scheduled inertia, and so at most {at_most(_up(euclid), 3)} rad/(N m). "
        f"d holds friction other than viscous, tip forces and payload as joint torques. {NOT_COVERED}"
    )


def _up(value: fmpq) -> float:
    """Return a float that is not below a rational number."""
    return float(np.nextafter(int(value.p) / int(value.q), np.inf))
