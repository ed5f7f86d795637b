"""An ellipsoid of errors that a motion never leaves, and that lies in the box of the certificate.

The certificate states V' + 2αV < γ² wᵀw while the arm is in the box. Let ρ_i be the room between the reference and the
limits of the box, |x_i,d| + ρ_i <= limit_i, and let x_i² <= p_i V. If

    r p_i <= ρ_i²  for every entry x_i that the box limits,      γ² W² <= 2αr,

then {V <= r} lies in the box at every instant, and V' < 0 on its border while |w| <= W: an arm that starts in this set
stays in the box. The comparisons are exact, with the printed decimals (`_is_invariant`).

*Consistent form.* V = xᵀ P⁻¹ x, and p_i = P_ii is the smallest possible (Cauchy-Schwarz). The reference is the paper's
circle; its |q_d| and |q̇_d| are bounded in balls at every instant (`_residual`). w contains the feedforward residual in
addition to the other disturbances d; the bound on the residual is subtracted from W.

*Semidefinite form.* V = xᵀ (X ⊗ M̂) x with M̂ > σ I gives p_i = (X⁻¹)_ii / σ, and γ²/σ in place of γ². The reference is
any reference that leaves half of the box as room.

*Paper's form.* w = (d, r) contains the reference itself, r = (q_d, q̇_d, q̈_d), so that W must exceed the norm of r.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from flint import arb, fmpq

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController
from fuzzyarm.fuzzy_policy.ts_model import PLANT_STATES
from fuzzyarm.proof._residual import feedforward_residual, largest_motion
from fuzzyarm.proof.definiteness import exact, inverse, largest_of_inverse, rational, stated

__all__ = ["Bounds", "InvariantSet", "invariant_set"]

_DIGITS = 4  # digits of the printed numbers


class Bounds(NamedTuple):
    """The bounds on V, x and w, in exact rationals."""

    spread: Any  # p_i, a sequence: x_i² <= p_i V
    room: Any  # ρ_i, a sequence: from the reference to the limit of x_i [rad or rad/s]
    alpha: Any  # α [1/s]
    gamma2: Any  # γ²
    residual: Any = fmpq(0)  # largest part of |w| that is not d


class InvariantSet(NamedTuple):
    """The set {V <= level}, which no motion leaves while |d| <= disturbance; without such a set, all numbers are 0."""

    level: float  # r
    disturbance: float  # largest |d| [N m] at every instant
    start: float  # |e(0)| [rad] up to which an initial state with only a position error is in the set
    statement: str  # in words


def _is_invariant(level: float, disturbance: float, bounds: Bounds) -> bool:
    """Return whether {V <= level} is proven to lie in the box, and to be invariant while |d| <= disturbance."""
    r, W = stated(level), stated(disturbance) + bounds.residual
    inside = (room > 0 and r * p <= room * room for p, room in zip(bounds.spread, bounds.room, strict=True))
    return bool(r > 0 and disturbance >= 0.0 and bounds.gamma2 * W * W <= 2 * bounds.alpha * r and all(inside))


def invariant_set(controller: Controller | ScheduledController) -> InvariantSet:
    """Return the largest invariant set of a proven controller on its reference; `statement` explains a missing set."""
    if isinstance(controller, ScheduledController):
        return _of_scheduled(controller)
    try:
        circle = JointReference(parameters=controller.model.parameters)
    except ValueError as error:
        return _none(f"this arm does not follow the paper's circle, {error}")
    return (_of_paper if controller.form == "paper" else _of_consistent)(controller, circle)


def _largest(bounds: Bounds) -> tuple[float, float]:
    """Return the proven level of the largest invariant set, and the largest |d| for it, rounded down.

    Without such a set, return 0 and the largest |w| for which a set {V <= r} would be in the box.
    """
    if min(bounds.room) <= 0:
        return 0.0, 0.0
    widest = min(room * room / p for p, room in zip(bounds.spread, bounds.room, strict=True))
    level = _rounded_down(_float(widest), lambda r: _is_invariant(r, 0.0, bounds._replace(residual=0)))
    W = math.sqrt(2.0 * _float(bounds.alpha) * level / _float(bounds.gamma2))
    disturbance = _rounded_down(W - _float(bounds.residual), lambda d: _is_invariant(level, d, bounds))
    return (level, disturbance) if disturbance > 0.0 else (0.0, W)


def _of_consistent(controller: Controller, circle: JointReference) -> InvariantSet:
    motion, residual = largest_motion(circle), feedforward_residual(controller.model, circle).bound
    if motion is None or residual is None:
        return _none("for this arm, no bounds between the sampled instants are known along the paper's circle")
    # This exceeds the norm by far more than the rounding error of the computation.
    missed = at_most(float(np.hypot(*residual)) * (1.0 + 1e-12), 3)
    bounds = _bounds(controller, motion)._replace(residual=stated(float(missed)))
    level, d = _largest(bounds)
    if level == 0.0:
        return _none(
            f"along the paper's circle, the box has room for |w| <= {at_most(d * 1.01, 2)} N m, of which the "
            f"feedforward residual may take {missed} N m"
        )
    apart = f" beside the feedforward residual of at most {missed} N m" if residual.any() else ""
    return _found(level, d, largest_of_inverse(controller.P, JOINTS), "along the paper's circle", "x'P^-1 x", apart)


def _of_paper(controller: Controller, circle: JointReference) -> InvariantSet:
    """Return an `InvariantSet` of zeros, whose statement says why the paper's form has no such set on the circle."""
    _, W = _largest(_bounds(controller, np.zeros(PLANT_STATES)))
    r = np.hstack(circle.sample(np.linspace(0.0, circle.duration, CHECKED_INSTANTS)))
    attained = float(np.linalg.norm(r, axis=1).max()) * (1.0 - 1e-9)
    if attained < W:
        return _none("in the paper's form, V includes the state of the reference model, which has no bound here")
    return _none(
        f"with gamma = {at_most(controller.gamma, 3)}, staying in the box takes |w| <= {at_most(W * 1.01, 2)}, but "
        f"w = (d, r), and the reference alone reaches |r| = {at_least(attained, 3)} along the paper's circle (SI units)"
    )


def _bounds(controller: Controller, motion: np.ndarray) -> Bounds:
    arm, gamma = controller.model.parameters, stated(controller.gamma)
    room = exact([*arm.joint_limit, *arm.velocity_limit]) - exact(motion)
    return Bounds(exact(np.diag(controller.P)[:PLANT_STATES]), room, stated(controller.alpha), gamma * gamma)


def _of_scheduled(controller: ScheduledController) -> InvariantSet:
    floor, gamma, X = stated(controller.floor), stated(controller.gamma), exact(controller.lyapunov)
    inner = inverse(X)
    if inner is None:
        return _none("X is singular")
    quarter = min(rational(high) - rational(low) for low, high in (j.angle_range for j in controller.robot.joints)) / 4
    speeds = [stated(speed) / 2 for speed in controller.speeds.tolist()]
    spread = [inner[0, 0] / floor, *[inner[1, 1] / floor] * len(speeds)]
    level, d = _largest(Bounds(spread, [quarter, *speeds], stated(controller.alpha), gamma * gamma / floor))
    # M̂ is a mean of the S_r, and each S_r is at most its largest absolute row sum times I.
    heaviest = max(sum(map(abs, row)) for row in exact(controller.inertia).reshape(-1, len(controller.robot)))
    slow = " and at most half the speeds of the box" if speeds else ""
    where = f"for every reference in the middle half of each range of angles{slow}"
    return _found(level, d, _float(X[0, 0] * heaviest), where, "x'(X (x) M)x, with the scheduled inertia M,", "")


def _found(level: float, d: float, steepest: float, where: str, V: str, apart: str) -> InvariantSet:
    """Return the set {V <= level}, which is invariant while the disturbance torque is at most `d` [N m].

    If only e is nonzero, V <= `steepest` |e|². The statement says `where` the set is invariant, the formula of `V`, and
    what acts `apart` from this torque.
    """
    start = float(at_least(math.sqrt(level / steepest) * (1.0 - 1e-12), _DIGITS))
    words = (
        f"From a set of initial states it does stay in the box, {where}, while |d| <= {at_least(d, 3)} N m at every "
        f"instant{apart}: V = {V} never rises above {at_least(level, _DIGITS)} (SI units) if it is initially at or "
        f"below it, and this ellipsoid lies in the box. It contains every state with |e| <= {at_least(start, 3)} rad "
        "in which only e is nonzero."
    )
    return InvariantSet(level, d, start, words)


def _none(why: str) -> InvariantSet:
    return InvariantSet(0.0, 0.0, 0.0, f"No set from which it stays in the box is proven: {why}.")


def _rounded_down(value: float, proof: Callable[[float], bool]) -> float:
    """Return a decimal at or slightly below `value` that `proof` accepts; 0 if there is no such decimal."""
    tried = (float(at_least(value * share, _DIGITS)) for share in (1.0, 0.999) if 0.0 < value < math.inf)
    return next((one for one in tried if proof(one)), 0.0)


def _float(value: fmpq) -> float:
    return float(arb(value))
