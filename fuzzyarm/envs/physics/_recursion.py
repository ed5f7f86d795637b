"""The recursive algorithms of rigid-body dynamics in the frames of the links, on numbers of any kind.

Constant rotations and zeros of a robot are floats; its other numbers and its motion are `Folded`, which simplifies
exactly: 0 x to 0, 0 + x and 1 x to x, (-x) y to -(x y), x + (-y) to x - y, and -(x - y) to y - x. Link j turns about
the z axis of its frame: a vector x of frame j is A_j Z(q_j) x in frame j - 1, with A_j constant and Z the turn about z.

The mass of a link, the part of its first moment along z, and an inertia diag(I_yy, I_yy, 0) make a body that is
symmetric about the joint's axis: rotation about that axis involves only I_zz, which is 0 for this body. The body can
equally be fixed to the preceding link. `regrouped` moves it there, link by link from the tip to the base (Gautier and
Khalil, 1990), which leaves the base parameters: no masses, two first moments and five inertias per link.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

__all__ = [
    "NOTHING", "Body", "Chain", "Folded", "Inertia", "Vector", "joined", "moved", "rotated", "rotated_inertia",
    "solver", "transposed", "unfolded",
]  # fmt: skip

Vector = tuple[Any, Any, Any]  # coordinates in a frame
_Matrix = tuple[Vector, Vector, Vector]
_Turn = tuple[Any, Any]  # sine and cosine of a joint's angle
NOTHING = (0.0, 0.0, 0.0)  # a vector of zeros


class Inertia(NamedTuple):
    """The six independent entries of an inertia matrix (3, 3) [kg m²] about the origin of the link's frame."""

    xx: Any
    xy: Any
    xz: Any
    yy: Any
    yz: Any
    zz: Any


class Body(NamedTuple):
    """Mass m [kg], first moment h = m c [kg m] and inertia L [kg m²], in a frame and about its origin."""

    mass: Any
    moment: Vector
    inertia: Inertia


class Chain(NamedTuple):
    """The frames, links and tip of a robot whose joints turn about z; `turns` are sine and cosine of each angle.

    All methods except `regrouped` need `turns`; `mass_matrix` and `torques` need bodies of mass 0, see `regrouped`.
    """

    rotations: Sequence[Sequence[Sequence[Any]]]  # A_j
    positions: Sequence[Vector]  # d_j [m]
    tip: Vector  # in the last frame [m]
    bodies: Sequence[Body]  # the links
    turns: Sequence[_Turn] = ()  # of each joint

    def regrouped(self) -> list[Body]:
        """Return a body of mass 0 for each link, such that the equations of motion are the same; see the module."""
        left: list[Body] = []
        rest = list(self.bodies)
        for j in reversed(range(len(rest))):
            mass, (hx, hy, hz), inertia = rest[j]
            own = Inertia(inertia.xx - inertia.yy, inertia.xy, inertia.xz, 0.0, inertia.yz, inertia.zz)
            left.insert(0, Body(0.0, (hx, hy, 0.0), own))
            if j > 0:
                symmetric = Body(mass, (0.0, 0.0, hz), Inertia(inertia.yy, 0.0, 0.0, inertia.yy, 0.0, 0.0))
                rest[j - 1] = joined(rest[j - 1], moved(symmetric, self.rotations[j], self.positions[j]))
        return left

    def mass_matrix(self) -> list[list[Any]]:
        """Return the lower triangle of M(q) [kg m²] by composite rigid bodies: row i has columns 0 to i.

        If the links from j on, as one rigid body, are accelerated about axis j, this requires the force f = z × h at
        the origin of frame j and the moment n = L z. Each axis i <= j carries the z component of the moment about its
        own origin; h and L are as in `Body`.
        """
        rows: list[list[Any]] = []
        whole = self.bodies[-1]
        for j in reversed(range(1, len(self.bodies))):
            turned = Body(0.0, _turned(self.turns[j], whole.moment), _turned_inertia(self.turns[j], whole.inertia))
            (hx, hy, _), inertia = turned.moment, turned.inertia
            force, moment = self._moved_force(j, (-hy, hx, 0.0), (inertia.xz, inertia.yz, inertia.zz))
            row = [moment[2], inertia.zz]
            for i in reversed(range(1, j)):
                force, moment = self._passed_on(i, force, moment)
                row.insert(0, moment[2])
            rows.insert(0, row)
            whole = joined(self.bodies[j - 1], moved(turned, self.rotations[j], self.positions[j]))
        return [[whole.inertia.zz], *rows]

    def torques(
        self, rates: Sequence[Any], accelerations: Sequence[Any], gravity: Vector, force: Vector = NOTHING
    ) -> list[Any]:
        """Return M(q) q̈ + C(q, q̇) q̇ + g(q) - J(q)ᵀ F [N m] by recursive Newton-Euler; masses are 0, see `regrouped`.

        Outwards, with U = [α]× + [ω]×², from ω, α, U and a of the frame before; for the base, ω = α = 0 and a = -g:

            ω_j = Rᵀ ω + q̇_j z,    α_j = Rᵀ α + (Rᵀ ω) × q̇_j z + q̈_j z,    a_j = Rᵀ (a + U d_j),    R = A_j Z(q_j).

        Inwards, with h and L of `Body`: f_j = U h, n_j = L α + ω × L ω + h × a at origin j, plus the wrench of j + 1.

        Gravity g [m/s²] is in the base frame, the tip force F [N] in the last frame.
        """
        turning, rising, origin = NOTHING, NOTHING, tuple(-g for g in gravity)
        motion: _Matrix = (NOTHING, NOTHING, NOTHING)
        forces, moments = [], []
        for j, body in enumerate(self.bodies):
            origin = self._back(j, _sum(origin, rotated(motion, self.positions[j])))
            turning, rising = (self._back(j, vector) for vector in (turning, rising))
            x, y, z = rising
            rising = (x + turning[1] * rates[j], y - turning[0] * rates[j], z + accelerations[j])
            turning = (turning[0], turning[1], turning[2] + rates[j])
            square = _square(turning)
            motion = _motion(square, rising)
            forces.append(rotated(motion, body.moment))
            moments.append(_sum(_euler(body.inertia, square, motion, rising), _cross(body.moment, origin)))
        total = _difference(forces[-1], force)
        moment = _difference(moments[-1], _cross(self.tip, force))
        torques = [moment[2]]
        for j in reversed(range(1, len(self.bodies))):
            total, moment = self._passed_on(j, total, moment)
            total, moment = _sum(forces[j - 1], total), _sum(moments[j - 1], moment)
            torques.insert(0, moment[2])
        return torques

    def in_last_frame(self, vector: Vector) -> Vector:
        """Transform a vector from the base frame to the frame of the last link."""
        for j in range(len(self.turns)):
            vector = self._back(j, vector)
        return vector

    def tip_point(self) -> Vector:
        """Return the position of the tip [m] in the base frame."""
        point = self.tip
        for j in reversed(range(len(self.turns))):
            point = _sum(self.positions[j], rotated(self.rotations[j], _turned(self.turns[j], point)))
        return point

    def tip_velocity(self, rates: Sequence[Any]) -> Vector:
        """Return the velocity of the tip [m/s] in the base frame."""
        point, velocity = self.tip, NOTHING
        for j in reversed(range(len(self.turns))):
            velocity = (velocity[0] - rates[j] * point[1], velocity[1] + rates[j] * point[0], velocity[2])
            velocity = rotated(self.rotations[j], _turned(self.turns[j], velocity))
            point = _sum(self.positions[j], rotated(self.rotations[j], _turned(self.turns[j], point)))
        return velocity

    def _passed_on(self, j: int, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        """Transform a force, and its moment about the origin of frame j, to frame j - 1 and its origin."""
        return self._moved_force(j, _turned(self.turns[j], force), _turned(self.turns[j], moment))

    def _moved_force(self, j: int, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        force, moment = rotated(self.rotations[j], force), rotated(self.rotations[j], moment)
        return force, _sum(moment, _cross(self.positions[j], force))

    def _back(self, j: int, vector: Vector) -> Vector:
        """Transform a vector from frame j - 1 to frame j: Zᵀ Aᵀ x."""
        sine, cosine = self.turns[j]
        x, y, z = rotated(transposed(self.rotations[j]), vector)
        return cosine * x + sine * y, cosine * y - sine * x, z


def solver(matrix: Sequence[Sequence[Any]]) -> Callable[[Sequence[Any]], list[Any]]:
    """Return the function that solves M x = b, from the lower triangle of M = Lᵀ D L, which is factorised once.

    L is unit lower triangular, D diagonal, and the last entry of D is the last entry of M.
    """
    rest = [list(row) for row in matrix]
    inverse: list[Any] = [0.0] * len(rest)
    below: list[list[Any]] = [[] for _ in rest]
    for k in reversed(range(len(rest))):
        inverse[k] = 1.0 / rest[k][k]
        below[k] = [entry * inverse[k] for entry in rest[k][:k]]
        for i in range(k):
            for j in range(i + 1):
                rest[i][j] = rest[i][j] - below[k][i] * rest[k][j]

    def solution(right: Sequence[Any]) -> list[Any]:
        x = list(right)
        for k in reversed(range(len(x))):
            for i in range(k):
                x[i] = x[i] - below[k][i] * x[k]
        x = [value * factor for value, factor in zip(x, inverse, strict=True)]
        for k in range(len(x)):
            for i in range(k):
                x[k] = x[k] - below[k][i] * x[i]
        return x

    return solution


def _square(turning: Vector) -> Inertia:
    x, y, z = turning
    return Inertia(x * x, x * y, x * z, y * y, y * z, z * z)


def _motion(square: Inertia, rising: Vector) -> _Matrix:
    """Return U = [α]× + [ω]×² from `square` = ω ωᵀ of an angular velocity ω, and `rising` = α, its derivative."""
    (xx, xy, xz, yy, yz, zz), (ax, ay, az) = square, rising
    return (-(yy + zz), xy - az, xz + ay), (xy + az, -(xx + zz), yz - ax), (xz - ay, yz + ax, -(xx + yy))


def _euler(inertia: Inertia, square: Inertia, motion: _Matrix, rising: Vector) -> Vector:
    """Return L α + ω × L ω [N m] for an inertia L, with `square` = ω ωᵀ, `motion` = U of `_motion`, `rising` = α."""
    (ax, ay, az), L, U, w = rising, inertia, motion, square
    return (
        L.xx * ax - L.xy * U[2][0] + L.xz * U[1][0] + L.yz * (w.yy - w.zz) + (L.zz - L.yy) * w.yz,
        L.yy * ay + L.xy * U[2][1] - L.yz * U[0][1] + L.xz * (w.zz - w.xx) + (L.xx - L.zz) * w.xz,
        L.zz * az - L.xz * U[1][2] + L.yz * U[0][2] + L.xy * (w.xx - w.yy) + (L.yy - L.xx) * w.xy,
    )


def joined(first: Body, second: Body) -> Body:
    """Return two bodies as one rigid body; all three are given in the same frame."""
    inertia = Inertia(*(a + b for a, b in zip(first.inertia, second.inertia, strict=True)))
    return Body(first.mass + second.mass, _sum(first.moment, second.moment), inertia)


def moved(body: Body, rotation: Sequence[Sequence[Any]], position: Vector) -> Body:
    """Express a body in another frame, in which `rotation` and `position` [m] give the body's present frame."""
    d, k, m = position, rotated(rotation, body.moment), body.mass
    e = rotated_inertia(rotation, body.inertia)
    moment = (k[0] + m * d[0], k[1] + m * d[1], k[2] + m * d[2])
    x, y, z = (d[i] * (m * d[i]) + 2.0 * (d[i] * k[i]) for i in range(len(d)))
    xy, xz, yz = (d[i] * (m * d[j]) + d[i] * k[j] + k[i] * d[j] for i, j in ((0, 1), (0, 2), (1, 2)))
    return Body(m, moment, Inertia(e.xx + (y + z), e.xy - xy, e.xz - xz, e.yy + (x + z), e.yz - yz, e.zz + (x + y)))


def rotated_inertia(rotation: Sequence[Sequence[Any]], inertia: Inertia) -> Inertia:
    """Return A L Aᵀ, with A the rotation and L the inertia."""
    columns = [(inertia.xx, inertia.xy, inertia.xz), (inertia.xy, inertia.yy, inertia.yz)]
    columns.append((inertia.xz, inertia.yz, inertia.zz))
    half = [rotated(rotation, column) for column in columns]  # columns of A L
    rows = [rotated(rotation, tuple(column[i] for column in half)) for i in range(len(half))]  # rows of A L Aᵀ
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = rows
    return Inertia(xx, xy, xz, yy, yz, zz)


def _turned_inertia(turn: _Turn, inertia: Inertia) -> Inertia:
    """Return Z L Zᵀ, with Z the rotation about z and L the inertia."""
    (sine, cosine), L = turn, inertia
    first, second = cosine * L.xx - sine * L.xy, cosine * L.xy - sine * L.yy
    xx, xy = cosine * first - sine * second, sine * first + cosine * second
    xz, yz = cosine * L.xz - sine * L.yz, sine * L.xz + cosine * L.yz
    return Inertia(xx, xy, xz, (L.xx + L.yy) - xx, yz, L.zz)


def _turned(turn: _Turn, vector: Vector) -> Vector:
    (sine, cosine), (x, y, z) = turn, vector
    return cosine * x - sine * y, sine * x + cosine * y, z


def transposed(rotation: Sequence[Sequence[Any]]) -> tuple[tuple[float, ...], ...]:
    """Return the transpose of a rotation matrix."""
    return tuple(zip(*rotation, strict=True))


def rotated(rotation: Sequence[Sequence[Any]], vector: Vector) -> Vector:
    """Return the vector A x, with A the rotation and x the vector."""
    x, y, z = ((row[0] * vector[0] + row[1] * vector[1]) + row[2] * vector[2] for row in rotation)
    return x, y, z


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _difference(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


class Folded:
    """A number that is unknown while a program is recorded, or its negative; operators simplify, see the module."""

    __slots__ = ("negative", "value")

    def __init__(self, value: Any, negative: bool = False) -> None:
        self.value, self.negative = value, negative

    def __neg__(self) -> Folded:
        return Folded(self.value, not self.negative)

    def __add__(self, other: Any) -> Folded:
        if not isinstance(other, Folded):
            return self if other == 0.0 else Folded(unfolded(self) + other)
        if self.negative == other.negative:
            return Folded(self.value + other.value, self.negative)
        return Folded(other.value - self.value if self.negative else self.value - other.value)

    def __sub__(self, other: Any) -> Folded:
        return self.__add__(-other)

    def __rsub__(self, other: float) -> Folded:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Folded):
            return Folded(self.value * other.value, self.negative != other.negative)
        if other in (0.0, 1.0, -1.0):
            return 0.0 if other == 0.0 else Folded(self.value, self.negative != (other < 0.0))
        return Folded(self.value * other, self.negative)

    def __rtruediv__(self, other: float) -> Folded:
        return Folded(other / self.value, self.negative)

    __radd__, __rmul__ = __add__, __mul__


def unfolded(number: Any) -> Any:
    """Return the number for which a `Folded` stands; a float is returned unchanged."""
    if isinstance(number, Folded):
        return -number.value if number.negative else number.value
    return number
