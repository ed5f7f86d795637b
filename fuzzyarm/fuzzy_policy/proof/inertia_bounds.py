"""The bounds of a robot's inertia that a scheduled controller claims, as matrices that must be positive definite.

With M̄(q) = M(q) + R, R the reflected rotor inertias, and the scheduled inertia M̂(q) = Σ_r h_r(q) S_r,

    M̂(q) < M̄(q) < κ M̂(q),      σ I < M̂(q),      -2 μ_k M̂(q) < ∂M̂/∂q_k < 2 μ_k M̂(q) for each kept angle q_k

for all angles of the box. M depends on too many angles for one cover, so the chain is split behind link a. The energy
of the links beyond it is a quadratic form D(q_(a+1) ... q_n) of that link's twist and the rates beyond, see
`kinetic_energy`; constants with

    D_low < D(q_(a+1) ... q_n) < D_high

make of M̄ two matrices of the angles q_2 ... q_a alone, between which it lies: M_low has D_low in place of D, and M_high
has D_high. Both steps are matrices of few angles. Nothing of this is sampled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from flint import fmpq

from fuzzyarm.fuzzy_policy.proof.box_cover import widened
from fuzzyarm.fuzzy_policy.proof.definiteness import exact, stated
from fuzzyarm.fuzzy_policy.proof.kinetic_energy import BASIS, inertia_polynomial
from fuzzyarm.fuzzy_policy.proof.trigonometric import TrigMatrix
from fuzzyarm.fuzzy_policy.scheduled import Premise, ScheduledController

__all__ = ["Bound", "angle_ranges", "bounds", "scheduled_polynomial"]


@dataclasses.dataclass(frozen=True)
class Bound:
    """A matrix that a controller claims to be positive definite in a box.

    Attributes:
        name: the claim.
        matrix: of the angles that it depends on.
        ranges: lowest and highest of these angles, (d, 2) [rad].
    """

    name: str
    matrix: TrigMatrix
    ranges: np.ndarray


def bounds(controller: ScheduledController) -> Iterator[Bound]:
    """Yield every bound that a controller claims, formed in exact rationals from its robot and its stored numbers."""
    robot, split = controller.robot, controller.split
    near, far = angle_ranges(controller)
    low, high = exact(controller.distal_low), exact(controller.distal_high)
    n = len(robot)
    if split < n:
        distal = inertia_polynomial(robot, split, n)
        place = (0,) * (n - split)
        yield _bound(f"D - D_low > 0 beyond joint {split}", _plus(distal, -low, place), far)
        yield _bound(f"D_high - D > 0 beyond joint {split}", _plus(-distal, high, place), far)
        lowest, highest = (inertia_polynomial(robot, 0, split, tail) for tail in (low, high))
    else:
        lowest = highest = inertia_polynomial(robot, 0, n)
    rotors, nowhere = exact(np.diag(robot.drive("motor_inertia"))), (0,) * (split - 1)
    scheduled = scheduled_polynomial(controller.premises, controller.inertia, split)
    kappa = stated(controller.kappa)
    yield _bound("M + R - M_hat > 0", _plus(lowest - scheduled, rotors, nowhere), near)
    yield _bound("kappa M_hat - M - R > 0", _plus(kappa * scheduled - highest, -rotors, nowhere), near)
    yield _bound("M_hat - sigma I > 0", _plus(scheduled, -stated(controller.floor) * exact(np.eye(n)), nowhere), near)
    for premise, rate in zip(controller.premises, controller.rates, strict=True):
        slope = TrigMatrix(scheduled).derivative(premise.joint - 1).exact
        for sign, mark in ((1, "-"), (-1, "+")):
            name = f"2 mu M_hat {mark} dM_hat/dq{premise.joint + 1} > 0"
            yield _bound(name, 2 * stated(rate) * scheduled - sign * slope, near)


def angle_ranges(controller: ScheduledController) -> tuple[np.ndarray, np.ndarray]:
    """Return the ranges (a - 1, 2) and (n - a, 2) of the angles 2 to a and a + 1 to n [rad]."""
    ranges = widened(np.array([joint.angle_range for joint in controller.robot.joints]))
    return ranges[1 : controller.split], ranges[controller.split :]


def scheduled_polynomial(premises: Sequence[Premise], inertia: np.ndarray, split: int) -> np.ndarray:
    """Return the coefficients of M̂, exact rationals (5, ..., 5, n, n) with an axis for each of the angles 2 to a.

    Args:
        premises: the kept ones.
        inertia: S_r, (N, n, n).
        split: a.
    """
    angles, vertices = split - 1, exact(inertia)
    total: np.ndarray = np.full((BASIS,) * angles + vertices.shape[1:], fmpq(0), dtype=object)
    for rule, S in enumerate(vertices):
        weight = np.array(fmpq(1), dtype=object).reshape((1,) * angles)
        for position, premise in enumerate(premises):
            weight = weight * _membership(premise, (rule >> position) & 1, angles)
        total[tuple(slice(size) for size in weight.shape)] += weight[..., np.newaxis, np.newaxis] * S
    return total


def _membership(premise: Premise, at_maximum: int, angles: int) -> np.ndarray:
    """Return (1 ± z)/2 as coefficients, an axis of 5 for the premise's angle and of 1 for the others."""
    values = np.full(BASIS, fmpq(0), dtype=object)
    values[0], values[premise.place] = fmpq(1, 2), fmpq(1 if at_maximum else -1, 2)
    return values.reshape([BASIS if axis == premise.joint - 1 else 1 for axis in range(angles)])


def _plus(polynomial: np.ndarray, constant: np.ndarray, place: tuple[int, ...]) -> np.ndarray:
    result = polynomial.copy()
    result[place] = result[place] + constant
    return result


def _bound(name: str, polynomial: np.ndarray, ranges: np.ndarray) -> Bound:
    whole = TrigMatrix(polynomial)
    return Bound(name, whole.of_needed(), ranges[whole.needed()])
