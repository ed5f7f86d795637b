"""The feedforward residual of the consistent form along a reference, bounded at every instant.

The feedforward sets dropped premises to the middle of their ranges. Its residual is ρ = Σ f_i r_i S_i y_i with
|f_i| <= 1, r_i half the range of premise i, S_i its slope, and y_i = (q_d, q̇_d) for a premise of A, (q̇_d, q̈_d) for a
premise of E. For any state in the box, with w_ij the row q̇_j of r_i S_i,

    |ρ_j(t)| <= ρ̄_j(t) = Σ_i |g_ij(t)|,      g_ij(t) = w_ij · y_i(t).

The largest ρ̄_j over all instants is bounded in ball arithmetic (FLINT's `arb`). On an
interval I of time with midpoint m, by the mean value theorem,

    g_ij(I) ⊂ g_ij(m) + g'_ij(I) (I - m).

The derivatives of q_d are the coefficients of its power series (`arb_series`) about m and about the ball I, composed of
the time law, the path and the inverse kinematics. The intervals with
the largest bounds are halved until these are close to attained values. If that takes too long, the bound is looser but
equally valid.
"""

import heapq
import math
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_series

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference
from fuzzyarm.fuzzy_policy.ts_model import POSITION, VELOCITY, TSModel
from fuzzyarm.proof.definiteness import exact, rational

__all__ = ["Residual", "feedforward_residual", "largest_motion"]

_ORDER = 4  # coefficients of a power series: q, q̇, q̈ and the derivative of q̈
_TOLERANCE = 1e-4  # relative distance from an attained value at which a bound is close enough
_FIRST, MOST_HALVED = 32, 2000  # number of intervals at the beginning; largest number of halvings
_SHORTEST_HALF = 2.0**-40  # half the length below which an interval is not halved again: its ends are still exact


class Residual(NamedTuple):
    """The largest feedforward residual along a reference, for any state in the box."""

    sampled: np.ndarray  # largest ρ̄ (2,) [N m] at `reference.CHECKED_INSTANTS` instants
    bound: np.ndarray | None  # bound on ρ̄ at every instant, (2,) [N m]; None if no bound was found

    @property
    def statement(self) -> str:
        """One sentence that states the residual along the paper's circle."""
        torques = self.sampled if self.bound is None else self.bound
        largest = f"({', '.join(at_most(torque, 3) for torque in torques)}) N m"
        place = "along the paper's circle, for any state in the box"
        if self.bound is not None:
            return f"The feedforward residual in d is at most {largest} {place}."
        return (
            f"The feedforward residual in d reaches {largest} {place}: sampled at {CHECKED_INSTANTS} instants, not "
            "bounded between them."
        )


def feedforward_residual(model: TSModel, reference: JointReference) -> Residual:
    """Return the feedforward residual of a T-S model along a reference: its largest samples and a proven bound."""
    motion = reference.sample(np.linspace(0.0, reference.duration, CHECKED_INSTANTS))
    x_r, dx_r = np.hstack([motion.q, motion.dq]), np.hstack([motion.dq, motion.ddq])
    total = np.zeros((len(x_r), JOINTS))
    for u in model.uncertainties:
        total += np.abs((x_r if u.on == "A" else dx_r) @ (u.H.T @ u.W).T)[:, VELOCITY]
    sampled = np.asarray(total.max(axis=0))
    rows = [
        (0 if u.on == "A" else 1, [[arb(w) for w in row] for row in (exact(u.H).T @ exact(u.W))[VELOCITY]])
        for u in model.polytope_in(rational).uncertainties
    ]
    bound = _Bound(rows, reference, sampled).largest()
    return Residual(sampled, bound if np.isfinite(bound).all() else None)


def largest_motion(reference: JointReference) -> np.ndarray | None:
    """Return bounds (4,) on |q_d| [rad], then |q̇_d| [rad/s], at every instant of a reference; None if not found.

    The search is the same as for the residual, with a single signal for each joint: g = q_d or g = q̇_d.
    """
    motion, unit = reference.sample(np.linspace(0.0, reference.duration, CHECKED_INSTANTS)), np.eye(2 * JOINTS)
    bounds = [
        _Bound([(0, [[*map(arb, row)] for row in unit[of].tolist()])], reference, np.abs(part).max(axis=0)).largest()
        for part, of in ((motion.q, POSITION), (motion.dq, VELOCITY))
    ]
    return np.concatenate(bounds) if np.isfinite(bounds).all() else None


class _Bound:
    """The search for the largest ρ̄_j (see the module) over intervals of t/T with exact ends, T the duration."""

    def __init__(self, rows: list[tuple[int, list[list[arb]]]], reference: JointReference, sampled: np.ndarray) -> None:
        self.reference, self.rows = reference, rows  # rows: for each y, its order and w_ij of both joints
        self.duration = arb(float(reference.duration))
        self.attained = [arb(value) for value in sampled.tolist()]  # only decides when to stop

    def largest(self) -> np.ndarray:
        """Return a bound (2,) on each joint's largest ρ̄_j, in the unit of the signals g; inf if none was found."""
        size = 1.0 / _FIRST
        heap = [self._entry((k + 0.5) * size, 0.5 * size) for k in range(_FIRST)]
        heapq.heapify(heap)
        for _ in range(MOST_HALVED):
            excess, middle, half, _ = heap[0]
            if -excess <= 1.0 + _TOLERANCE or half < _SHORTEST_HALF:
                break
            heapq.heapreplace(heap, self._entry(middle - 0.5 * half, 0.5 * half))
            heapq.heappush(heap, self._entry(middle + 0.5 * half, 0.5 * half))
        return np.asarray(np.max([bound for *_, bound in heap], axis=0))

    def _entry(self, middle: float, half: float) -> tuple[float, float, float, tuple[float, ...]]:
        """Return the heap entry of middle ± half: -(largest ratio of bound to attained value), middle, half, bounds."""
        try:
            start, ball = self._motion(_time_law(middle, 0.0)), self._motion(_time_law(middle, half))
        except (ValueError, ZeroDivisionError):  # the motion cannot be enclosed
            return -math.inf, middle, half, (math.inf,) * JOINTS
        values, bounds = zip(*(self._residual(joint, start, ball, half) for joint in range(JOINTS)), strict=True)
        self.attained = [old.max(value.lower()) for old, value in zip(self.attained, values, strict=True)]
        upper, least = tuple(map(_rounded_up, bounds)), max(1e-9 * float(max(self.attained)), 1e-300)
        excess = max(bound / max(float(value), least) for bound, value in zip(upper, self.attained, strict=True))
        return -excess, middle, half, upper

    def _residual(self, joint: int, start: list[list[arb]], ball: list[list[arb]], half: float) -> tuple[arb, arb]:
        """Return ρ̄_j at an instant (motion `start`), and a bound on it for t within ± `half` T (motion `ball`)."""
        value, bound, reach = arb(0), arb(0), arb(0, half) * self.duration
        for order, rows in self.rows:
            # y = (q, q̇) or (q̇, q̈): the derivatives `order` and `order + 1` of both joints
            g, slope = (
                sum((w * y for w, y in zip(rows[joint], [*motion[n], *motion[n + 1]], strict=True)), arb(0))
                for motion, n in ((start, order), (ball, order + 1))
            )
            value += abs(g)
            bound += (g + slope * reach).abs_upper()
        return value, bound

    def _motion(self, s: arb_series) -> list[list[arb]]:
        """Return the time derivatives of order 0 to 3 of (q_1, q_2), with the path parameter s as a series in t/T."""
        path: Any = self.reference.path  # a `Circle`
        psi = arb(path.start_angle) + 2 * arb.pi() * arb(path.turns) * s
        away = arb(path.radius) * psi.cos(), arb(path.radius) * psi.sin()
        point = [arb(center) + part for center, part in zip(path.center, away, strict=True)]
        angles = _joint_angles(point, self.reference.parameters.length, int(self.reference.elbow_sign))
        result = [
            [math.factorial(order) * angle[order] / self.duration**order for angle in angles] for order in range(_ORDER)
        ]
        if not all(value.is_finite() for row in result for value in row):
            raise ValueError("the motion cannot be enclosed: the time interval is too long")
        return result


def _time_law(middle: float, half: float) -> arb_series:
    """Return s(x) = 10 x³ - 15 x⁴ + 6 x⁵ about the ball middle ± half in [0, 1] as a power series."""

    def s(x: arb) -> arb:
        return x**3 * (10 - 15 * x + 6 * x**2)

    x = arb(middle, half)
    both = s(arb(middle - half)).union(s(arb(middle + half)))  # s grows from 0 to 1
    coefficients = [both, 30 * (x * (1 - x)) ** 2, 30 * x * (1 - x) * (1 - 2 * x), 10 - 60 * x * (1 - x)]
    return arb_series(coefficients, prec=_ORDER)


def _joint_angles(point: list[arb_series], length: tuple[float, float], elbow_sign: int) -> list[arb_series]:
    """Return q_1 and q_2 for a tip `point`, as series; nan, ValueError or ZeroDivisionError if balls are too wide."""
    (x, y), (l1, l2) = point, map(arb, length)
    r2 = x * x + y * y
    outer, inner = (l1 + l2) ** 2 - r2, r2 - (l1 - l2) ** 2
    q2 = 2 * elbow_sign * (outer / inner).sqrt().atan()
    cos2, sin2 = (r2 - l1**2 - l2**2) / (2 * l1 * l2), elbow_sign * (outer * inner).sqrt() / (2 * l1 * l2)
    x0, y0 = l1 + l2 * cos2, l2 * sin2
    across, along = y * x0 - x * y0, x * x0 + y * y0
    # q1 is the angle of (along, across); rotated by the middle of q1, it is far from the branch cut of atan.
    turn = math.atan2(float(across[0].mid()), float(along[0].mid()))
    cos, sin = arb(turn).cos(), arb(turn).sin()
    across, along = across * cos - along * sin, along * cos + across * sin
    q1 = arb(turn) + (across / along).atan()
    if not (along[0] > 0 and abs(q1[0]) <= arb.pi()):
        raise ValueError("q1 cannot be enclosed: the time interval is too long, or q1 may cross ±π")
    return [q1, q2]


def _rounded_up(value: arb) -> float:
    """Return a float that is not below any point of a ball; inf if the ball is not finite."""
    if value.is_zero():
        return 0.0
    if not value.is_finite():
        return math.inf
    return math.nextafter(float(value.upper()), math.inf)
