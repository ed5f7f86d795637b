"""The inertia of a robot, or of its last links on a moving base, as an exact trigonometric polynomial of its angles.

The kinetic energy of links a + 1 to n, whose base is link a, is T = ½ yᵀ D(q) y. Here y holds the base's twist, the
velocity of its origin and its angular velocity in its own frame, and the joint rates q̇_(a+1) ... q̇_n; a base at rest
leaves only the rates, and D is the mass matrix M. In the frame of link i, with A_i(q_i) = rotation_i exp([u_i]× q_i),

    ω_i = A_iᵀ ω_(i-1) + u_i q̇_i,    v_i = A_iᵀ (v_(i-1) + ω_(i-1) × d_i),
    T = ½ Σ_i m_i |v_i + ω_i × c_i|² + ω_iᵀ I_i ω_i,

whose coefficients of y are multilinear in (cos q_k, sin q_k), so D is a polynomial of degree two in each such pair: a
combination of 1, cos q, sin q, cos 2q and sin 2q for each angle. Five points on the unit circle with rational
coordinates determine it, and all of this is computed in exact rationals from the robot's floats.

A robot at rest at its base has an inertia that its first angle does not change.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.proof.definiteness import exact

__all__ = [
    "BASIS",
    "TWIST",
    "inertia_at",
    "inertia_polynomial",
]  # fmt: skip


TWIST = 6
"""Numbers of a base's twist, linear before angular velocity."""

BASIS = 5
"""Functions of one angle: 1, cos q, sin q, cos 2q, sin 2q."""

_NODES = tuple((fmpq(c, 5), fmpq(s, 5)) for c, s in ((5, 0), (0, 5), (-5, 0), (0, -5), (3, 4)))


def inertia_at(
    robot: Robot, cosines: Sequence[fmpq], sines: Sequence[fmpq], *, first: int, last: int, tail: np.ndarray | None
) -> np.ndarray:
    """Return D of links `first` + 1 to `last` at exact cosines and sines of their angles.

    Args:
        robot: the robot, n joints.
        cosines: of the angles, `last` - `first` numbers.
        sines: likewise.
        first: a, number of the link that is the base; 0 for the robot's own base, which rests.
        last: links beyond this one are left out.
        tail: W (6 + m, 6 + m), a quadratic form of the last link's twist and m more rates that is added,
            ½ (v, ω, q̇)ᵀ W (v, ω, q̇); None for none.

    Returns:
        Exact rationals, (s, s) with s = b + `last` - `first` + m, and b = 6 rows for the twist of a moving base.
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
    """Return the coefficients of D in the basis of each angle that it may depend on; arguments as for `inertia_at`.

    Returns:
        Exact rationals (5, ..., 5, s, s): one axis for each of the angles `first` + 1 to `last`, without that of joint
        1, each in the order of `BASIS`.
    """
    fixed = 0 if first else 1
    angles = last - first - fixed
    values = []
    for nodes in itertools.product(_NODES, repeat=angles):
        cosines, sines = zip(*([(fmpq(1), fmpq(0))] * fixed), *nodes, strict=True)
        values.append(inertia_at(robot, cosines, sines, first=first, last=last, tail=tail))
    result = np.array(values, dtype=object).reshape((BASIS,) * angles + values[0].shape)
    for axis in range(angles):
        result = np.moveaxis(np.tensordot(_TO_BASIS, result, axes=(1, axis)), 0, axis)
    return np.asarray(result)


def _matrix(rows: Any) -> fmpq_mat:
    return fmpq_mat(len(rows), len(rows[0]), list(exact(rows).ravel()))


def _cross(vector: Sequence[float]) -> fmpq_mat:
    """Return [x]×, so that [x]× y = x × y."""
    x, y, z = exact(vector)
    return fmpq_mat(3, 3, [fmpq(0), -z, y, z, fmpq(0), -x, -y, x, fmpq(0)])


def _rotation(axis: Sequence[float], c: fmpq, s: fmpq) -> fmpq_mat:
    """Return exp([u]× q) = u uᵀ + c (I - u uᵀ) + s [u]× for c = cos q, s = sin q."""
    u = fmpq_mat(3, 1, list(exact(axis)))
    along, unit = u * u.transpose(), fmpq_mat(3, 3, [fmpq(int(i == j)) for i in range(3) for j in range(3)])
    return along + (unit - along) * c + _cross(axis) * s


def _to_basis() -> np.ndarray:
    """Return the matrix (5, 5) from the values at the nodes to the coefficients in the basis."""
    rows = [[fmpq(1), c, s, c * c - s * s, 2 * c * s] for c, s in _NODES]
    inverse = fmpq_mat(rows).inv()
    return np.array(inverse.tolist(), dtype=object)


_TO_BASIS = _to_basis()
