"""The bounds on a robot's inertia that a scheduled controller claims, as matrices that must be positive definite.

*Inertia.* The inertia of a robot, or of its last links on a moving base, is an exact trigonometric polynomial of its
angles. The kinetic energy of links a + 1 to n, with link a as their base, is T = ½ yᵀ D(q) y. Here y contains the
base's twist, that is the velocity of its origin and its angular velocity in its frame, and the joint rates q̇_(a+1) ...
q̇_n; for a base at rest, y contains only the rates, and D is the mass matrix M. In the frame of link i, with
A_i(q_i) = rotation_i exp([u_i]× q_i),

    ω_i = A_iᵀ ω_(i-1) + u_i q̇_i,    v_i = A_iᵀ (v_(i-1) + ω_(i-1) × d_i),
    T = ½ Σ_i m_i |v_i + ω_i × c_i|² + ω_iᵀ I_i ω_i,

where v_i and ω_i are linear in y, with coefficients multilinear in (cos q_k, sin q_k). So D is a polynomial of degree
two in each such pair: a combination of 1, cos q, sin q, cos 2q and sin 2q for each angle. Five points on the unit
circle with rational coordinates determine it, all in exact rationals from the robot's floats. If the base of the robot
is at rest, the inertia does not depend on the first angle.

*Bounds.* With M̄(q) = M(q) + R, R the reflected rotor inertias, and the scheduled inertia M̂(q) = Σ_r h_r(q) S_r,

    M̂(q) < M̄(q) < κ M̂(q),      σ I < M̂(q),      -2 μ_k M̂(q) < ∂M̂/∂q_k < 2 μ_k M̂(q) for each kept angle q_k

for all angles of the box. M depends on too many angles for one cover, so the chain is split behind link a. The energy
of the links beyond link a is a quadratic form with the matrix D(q_(a+1) ... q_n) in the twist of link a and the rates
beyond. Constants with

    D_low < D(q_(a+1) ... q_n) < D_high

enclose M̄ between two matrices that depend only on q_2 ... q_a: M_low with D_low in place of D, and M_high with D_high.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.scheduled_controller import TWIST, Premise, ScheduledController
from fuzzyarm.proof.box_cover import BASIS, TrigMatrix
from fuzzyarm.proof.definiteness import exact, stated

__all__ = ["angle_ranges", "inertia_bounds", "inertia_polynomial", "plus", "scheduled_polynomial"]

_NODES = tuple((fmpq(c, 5), fmpq(s, 5)) for c, s in ((5, 0), (0, 5), (-5, 0), (0, -5), (3, 4)))
# The map from values at the nodes to coefficients in the basis, (5, 5).
_TO_BASIS = np.array(
    fmpq_mat([[fmpq(1), c, s, c * c - s * s, 2 * c * s] for c, s in _NODES]).inv().tolist(), dtype=object
)


def _inertia_at(
    robot: Robot, cosines: Sequence[fmpq], sines: Sequence[fmpq], *, first: int, last: int, tail: np.ndarray | None
) -> np.ndarray:
    """Return the inertia D (s, s) of links `first` + 1 to `last`, in exact rationals; s = b + `last` - `first` + m.

    Cosines and sines are those of the links' angles. Link `first` is the base: link 0 is at rest (b = 0), any other
    moves (b = 6), with its twist in the first 6 rows and columns of D. Links beyond `last` are left out (m = 0), or a
    `tail` W (6 + m, 6 + m) adds their energy ½ (v, ω, q̇)ᵀ W (v, ω, q̇), with the twist (v, ω) of link `last` and the
    rates q̇ of the m joints beyond it.
    """
    joints, moving = robot.joints[first:last], TWIST if first else 0
    size = moving + len(joints) + (0 if tail is None else len(tail) - TWIST)
    v, w, D = fmpq_mat(3, size), fmpq_mat(3, size), fmpq_mat(size, size)
    for k in range(moving):
        (v if k < moving // 2 else w)[k % 3, k] = 1
    for i, (joint, c, s) in enumerate(zip(joints, cosines, sines, strict=True)):
        turn = (_matrix(joint.rotation) * _rotation(joint.axis, c, s)).transpose()
        v, w = turn * (v - _cross(joint.position) * w), turn * w
        for row, entry in enumerate(exact(joint.axis)):
            w[row, moving + i] += entry
        link = joint.link
        center = v - _cross(link.center) * w
        mass, inertia = exact(link.mass).item(), _matrix(link.inertia)
        D += center.transpose() * center * mass + w.transpose() * inertia * w
    if tail is not None:
        beyond = np.zeros((len(tail) - TWIST, size), dtype=int)
        beyond[:, moving + len(joints) :] = np.eye(len(beyond), dtype=int)
        form = fmpq_mat([*v.tolist(), *w.tolist(), *exact(beyond).tolist()])
        D += form.transpose() * _matrix(tail) * form
    return np.array(D.tolist(), dtype=object)


def inertia_polynomial(robot: Robot, first: int, last: int, tail: np.ndarray | None = None) -> np.ndarray:
    """Return the coefficients of D, the inertia (s, s) of `_inertia_at`, in the angles' `BASIS`; `tail` as there.

    They are exact rationals (5, ..., 5, s, s), with one axis in the order of `BASIS` for each of the angles `first` + 1
    to `last` except the angle of joint 1.
    """
    fixed = 0 if first else 1
    angles = last - first - fixed
    values = []
    for nodes in itertools.product(_NODES, repeat=angles):
        cosines, sines = zip(*([(fmpq(1), fmpq(0))] * fixed), *nodes, strict=True)
        values.append(_inertia_at(robot, cosines, sines, first=first, last=last, tail=tail))
    result = np.array(values, dtype=object).reshape((BASIS,) * angles + values[0].shape)
    for axis in range(angles):
        result = np.moveaxis(np.tensordot(_TO_BASIS, result, axes=(1, axis)), 0, axis)
    return np.asarray(result)


def _matrix(rows: Any) -> fmpq_mat:
    return fmpq_mat(len(rows), len(rows[0]), list(exact(rows).ravel()))


def _cross(vector: Sequence[float]) -> fmpq_mat:
    """Return the matrix [x]× of a vector x, for which [x]× y = x × y."""
    x, y, z = exact(vector)
    return fmpq_mat(3, 3, [fmpq(0), -z, y, z, fmpq(0), -x, -y, x, fmpq(0)])


def _rotation(axis: Sequence[float], c: fmpq, s: fmpq) -> fmpq_mat:
    """Return exp([u]× q) = u uᵀ + c (I - u uᵀ) + s [u]× for c = cos q, s = sin q."""
    u = fmpq_mat(3, 1, list(exact(axis)))
    along, unit = u * u.transpose(), fmpq_mat(3, 3, [fmpq(int(i == j)) for i in range(3) for j in range(3)])
    return along + (unit - along) * c + _cross(axis) * s


def inertia_bounds(controller: ScheduledController) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield every bound claimed by a controller, in exact rationals from its robot and its stored values.

    Each bound is a name, the polynomial of a matrix that must be positive definite, and the ranges (d, 2) of its
    angles [rad].
    """
    robot, split = controller.robot, controller.split
    ranges = angle_ranges(robot)
    near, far = ranges[1:split], ranges[split:]
    low, high = exact(controller.distal_low), exact(controller.distal_high)
    n = len(robot)
    if split < n:
        distal = inertia_polynomial(robot, split, n)
        yield f"D - D_low > 0 beyond joint {split}", plus(distal, -low), far
        yield f"D_high - D > 0 beyond joint {split}", plus(-distal, high), far
        lowest, highest = (inertia_polynomial(robot, 0, split, tail) for tail in (low, high))
    else:
        lowest = highest = inertia_polynomial(robot, 0, n)
    rotors = exact(np.diag(robot.drive("motor_inertia")))
    scheduled = scheduled_polynomial(controller.premises, controller.inertia, split)
    kappa = stated(controller.kappa)
    yield "M + R - M_hat > 0", plus(lowest - scheduled, rotors), near
    yield "kappa M_hat - M - R > 0", plus(kappa * scheduled - highest, -rotors), near
    yield "M_hat - sigma I > 0", plus(scheduled, -stated(controller.floor) * exact(np.eye(n))), near
    for premise, rate in zip(controller.premises, controller.rates, strict=True):
        slope = TrigMatrix(scheduled).derivative(premise.joint - 1).exact
        for sign, mark in ((1, "-"), (-1, "+")):
            name = f"2 mu M_hat {mark} dM_hat/dq{premise.joint + 1} > 0"
            yield name, 2 * stated(rate) * scheduled - sign * slope, near


def angle_ranges(robot: Robot) -> np.ndarray:
    """Return the ranges (n, 2) of the angles [rad]; a full turn or more becomes slightly more than [-π, π]."""
    ranges = np.array([joint.angle_range for joint in robot.joints])
    whole = ranges[:, 1] - ranges[:, 0] >= 2.0 * np.pi - 1e-9
    return np.where(whole[:, np.newaxis], np.array([-3.141593, 3.141593]), ranges)


def scheduled_polynomial(premises: Sequence[Premise], inertia: np.ndarray, split: int) -> np.ndarray:
    """Return M̂ = Σ h_r S_r, S_r = `inertia` (N, n, n), in the `BASIS` of angles 2 to `split`: (5, ..., 5, n, n)."""
    angles, vertices = split - 1, exact(inertia)
    total: np.ndarray = np.full((BASIS,) * angles + vertices.shape[1:], fmpq(0), dtype=object)
    for rule, S in enumerate(vertices):
        weight = np.array(fmpq(1), dtype=object).reshape((1,) * angles)
        for position, premise in enumerate(premises):
            weight = weight * _membership(premise, (rule >> position) & 1, angles)
        total[tuple(slice(size) for size in weight.shape)] += weight[..., np.newaxis, np.newaxis] * S
    return total


def _membership(premise: Premise, at_maximum: int, angles: int) -> np.ndarray:
    """Return (1 + z)/2 if `at_maximum`, else (1 - z)/2, as coefficients: the axis of z's angle has size 5, others 1."""
    values = np.full(BASIS, fmpq(0), dtype=object)
    values[0], values[premise.place] = fmpq(1, 2), fmpq(1 if at_maximum else -1, 2)
    return values.reshape([BASIS if axis == premise.joint - 1 else 1 for axis in range(angles)])


def plus(polynomial: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """Return a polynomial (5, ..., 5, s, s) plus a constant (s, s)."""
    result, place = polynomial.copy(), (0,) * (polynomial.ndim - 2)
    result[place] = result[place] + constant
    return result
