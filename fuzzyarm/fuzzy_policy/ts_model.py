"""Takagi-Sugeno descriptor model of the rigid arm (paper sections 3, 5.1 and 6.1).

The rigid arm with motor torques u and disturbances d is E(z) ẋ = A(z) x + B u + B d for x = (q, q̇), affine in the
premises (6), where c1..c5 are constants of the arm (3), q12 = q1 + q2 and sinc x = sin x / x:

    z1 = cos q2,   z2 = -c4 sinc q1 - c5 sinc q12,   z3 = -c5 sinc q12,   z4 = c2 q̇2 sin q2,   z5 = -c2 q̇1 sin q2.

A *kept* premise is interpolated between its bounds (two rules each); a dropped one becomes norm-bounded
uncertainty around the middle of its range. All matrices are in SI units.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.common.checks import instance, shown
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import arm_constants, inertia_and_gravity
from fuzzyarm.envs.physics.parameters import ArmParameters

__all__ = [
    "DEFAULT_KEPT", "ERROR_STATES", "INTEGRAL", "NAMED_RULES", "PLANT", "PLANT_STATES", "POSITION", "PREMISES",
    "SCALAR_STATES", "VELOCITY", "TSModel", "Uncertainty", "premises", "rule_products",
]  # fmt: skip

# Slices of the parts of the states x = (q, q̇) and ē = (e, ė, x_I), in arrays and in the rows of matrices:
POSITION, VELOCITY, INTEGRAL = consecutive(JOINTS, JOINTS, JOINTS)
"""Angles, velocities and, with the integral, x_I = ∫ (q - q_d) dt; one entry per joint in each."""

PLANT = slice(POSITION.start, VELOCITY.stop)  # the error of the plant, (e, ė), in ē
PLANT_STATES: int = VELOCITY.stop  # size of x
ERROR_STATES: int = INTEGRAL.stop  # size of ē with the integral; without it the size is `PLANT_STATES`
SCALAR_STATES = 3  # entries of ē per joint with the integral: (e, ė, x_I)

PREMISES = ("z1", "z2", "z3", "z4", "z5")  # names of the premises, in the order of the paper
DEFAULT_KEPT = ("z1", "z3")  # premises kept by default: four rules

NAMED_RULES = {
    32: ("z1", "z2", "z3", "z4", "z5"),
    16: ("z1", "z2", "z3", "z4"),
    8: ("z1", "z2", "z3"),
    4: DEFAULT_KEPT,
    2: ("z3",),
    1: (),
}
"""Kept premises of the models named by their number of rules. 8, 4 and 2 are the paper's (section 6.1.2)."""

# sinc x = sin x / x has its minimum -0.21723362821122165740... where tan x = x (x = 4.4934...); rounded outwards.
_SINC_MINIMUM = Fraction("-0.2172336282112217")
# Bounds are widened by this share of their range, far more than the rounding error of a premise. A range of zero width
# (z2 and z3 without gravity) is widened by this number, because a weight is divided by the width.
_GUARD = Fraction(1, 10**12)


def _outwards(low: Fraction, high: Fraction, side: int) -> float:
    """Return the end `low` (side -1) or `high` (side 1) of a range, moved outwards by `_GUARD` and rounding."""
    target = (low if side < 0 else high) + side * _GUARD * (high - low or 1)
    rounded = float(target)
    return rounded if side * (Fraction(rounded) - target) >= 0 else math.nextafter(rounded, side * math.inf)


def premises(q: np.ndarray, dq: np.ndarray, parameters: ArmParameters) -> np.ndarray:
    """Return the premises z1..z5 (..., 5) at angles q [rad] and velocities q̇ [rad/s] of shape (..., 2)."""
    arm = arm_constants(parameters)
    sinc1, sinc12 = np.sinc(q[..., 0] / np.pi), np.sinc((q[..., 0] + q[..., 1]) / np.pi)
    sin2 = np.sin(q[..., 1])
    gravity = -arm.c4 * sinc1 - arm.c5 * sinc12, -arm.c5 * sinc12
    coriolis = arm.c2 * dq[..., 1] * sin2, -arm.c2 * dq[..., 0] * sin2
    return np.stack([np.cos(q[..., 1]), *gravity, *coriolis], axis=-1)


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Hᵀ Δ W with ΔᵀΔ <= I, added to E_p or A_p: a dropped premise (section 5.1), or several with one multiplier."""

    premises: tuple[str, ...]  # the names; several where H and W are stacked, Δ = diag(f, ...)
    on: str  # the matrix it acts on, "E" (z1) or "A" (the others)
    H: np.ndarray  # (rows, 4)
    W: np.ndarray  # (rows, 4), the same at every vertex


@dataclasses.dataclass(frozen=True)
class _Polytope:
    """The vertex matrices and the dropped premises of a T-S model, all in one number type."""

    E: list[np.ndarray]  # N_e matrices E_pk, (4, 4)
    A: list[np.ndarray]  # N matrices A_pi, (4, 4)
    uncertainties: list[Uncertainty]  # the dropped premises


@dataclasses.dataclass(frozen=True)
class TSModel:
    """The T-S descriptor model with the premises `kept`, a subset of z1..z5 in any order.

    Vertices are ordered as in section 6.1.2, the minimum first and the first kept premise fastest:
    E_1 = E(z1min), A_1 = A(z2min, z3min), A_2 = A(z2max, z3min), ...
    """

    parameters: ArmParameters
    kept: tuple[str, ...] = DEFAULT_KEPT

    def __post_init__(self) -> None:
        instance("parameters", self.parameters, ArmParameters)
        kept = self.kept if isinstance(self.kept, tuple | list) else (self.kept,)
        unknown = [name for name in kept if not isinstance(name, str) or name not in PREMISES]
        if unknown or len(set(kept)) != len(kept):
            raise ValueError(
                f"kept = {shown(self.kept)} must contain names, each at most once; allowed names: {', '.join(PREMISES)}"
            )
        object.__setattr__(self, "kept", tuple(sorted(kept)))

    @property
    def rules(self) -> int:
        """Number of fuzzy rules, 2^k for k kept premises."""
        return 1 << len(self.kept)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Bounds (5, 2) of the premises in the box of angles and velocities (25), rounded outwards.

        They are computed in exact rational arithmetic; for joint limits up to π, sinc q1 lies in [0, 1] and sinc q12 in
        [-0.2172..., 1].
        """
        _, c2, _, c4, c5 = _constants(self.parameters, Fraction)
        dq1, dq2 = map(Fraction, self.parameters.velocity_limit)
        gravity = (-(c4 + c5), -c5 * _SINC_MINIMUM), (-c5, -c5 * _SINC_MINIMUM)
        exact = [(Fraction(-1), Fraction(1)), *gravity, (-c2 * dq2, c2 * dq2), (-c2 * dq1, c2 * dq1)]
        return np.array([[_outwards(low, high, -1), _outwards(low, high, 1)] for low, high in exact])

    @property
    def kept_in_E(self) -> list[int]:
        """Indices of the kept premises of E: [0] or []."""
        return [0] if "z1" in self.kept else []

    @property
    def kept_in_A(self) -> list[int]:
        """Indices of the kept premises of A, a subset of [1, 2, 3, 4]."""
        return [PREMISES.index(name) for name in self.kept if name != "z1"]

    def E(self, z: np.ndarray) -> np.ndarray:
        """Return the matrix E_p(z) (4, 4) of the paper's (5) for premises z (5,)."""
        base, slopes = _descriptor_terms(self.parameters)["E"]
        return np.asarray(base + z[0] * slopes[0])

    def A(self, z: np.ndarray) -> np.ndarray:
        """Return the matrix A_p(z) (4, 4) of the paper's (5) for premises z (5,)."""
        base, slopes = _descriptor_terms(self.parameters)["A"]
        return np.asarray(base + np.tensordot(z[1:], slopes[1:], axes=1))

    @property
    def B(self) -> np.ndarray:
        """Input matrix B_p = B_d (4, 2) of the paper's (5)."""
        return np.vstack([np.zeros((JOINTS, JOINTS)), np.eye(JOINTS)])

    @property
    def E_vertices(self) -> list[np.ndarray]:
        """The N_e vertex matrices E_pk (4, 4); dropped premises are at the middle of their range."""
        return self.polytope.E

    @property
    def A_vertices(self) -> list[np.ndarray]:
        """The N vertex matrices A_pi (4, 4); dropped premises are at the middle of their range."""
        return self.polytope.A

    @property
    def uncertainties(self) -> list[Uncertainty]:
        """The dropped premises, each as ΔE = Hᵀ f W or ΔA = Hᵀ f W with |f| <= 1 (section 5.1)."""
        return self.polytope.uncertainties

    @cached_property
    def polytope(self) -> _Polytope:
        """Vertices and uncertainties in floating point."""
        return self.polytope_in(float)

    def polytope_in(self, number: Callable[[float], Any]) -> _Polytope:
        """Return vertices and uncertainties with entries that `number` makes from floats; proofs need an exact type."""
        terms = _descriptor_terms(self.parameters, number)
        bounds = [(number(low), number(high)) for low, high in self.bounds.tolist()]
        middles = [(low + high) / 2 for low, high in bounds]

        def corners(side: str, kept: list[int]) -> list[np.ndarray]:
            base, slopes = terms[side]
            result = []
            for vertex in range(1 << len(kept)):
                z = list(middles)
                for position, index in enumerate(kept):
                    z[index] = bounds[index][(vertex >> position) & 1]
                result.append(sum((value * slope for value, slope in zip(z, slopes, strict=True)), base))
            return result

        uncertainties = []
        for index, name in enumerate(PREMISES):
            if name not in self.kept:
                side = "E" if index == 0 else "A"
                slope, (low, high) = terms[side][1][index], bounds[index]
                # H selects the rows on which the premise acts, and W consists of these rows; Hᵀ W is exactly the slope.
                rows = [row for row in range(PLANT_STATES) if any(entry != 0 for entry in slope[row])]
                H, W = np.eye(PLANT_STATES)[rows], (high - low) / 2 * slope[rows]
                uncertainties.append(Uncertainty((name,), side, H, W))
        return _Polytope(corners("E", self.kept_in_E), corners("A", self.kept_in_A), uncertainties)

    def weights(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the memberships h (N,) of A and v (N_e,) of E at premises z (5,): in [0, 1], each summing to one.

        ω = (z - z_min)/(z_max - z_min) is the weight of the *max* vertex. Outside the box (25) premises are clipped to
        their bounds: the weights stay convex, but the model is no longer exact.
        """
        low, high = self.bounds[:, 0], self.bounds[:, 1]
        omega = np.clip((z - low) / (high - low), 0.0, 1.0)
        return rule_products(omega[self.kept_in_A]), rule_products(omega[self.kept_in_E])


def _descriptor_terms(
    parameters: ArmParameters, number: Callable[[float], Any] = float
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return E(z) and A(z) by name: constant term (4, 4), factors (5, 4, 4) of z1..z5; `number` converts parameters."""
    c1, c2, c3, _, _ = _constants(parameters, number)
    motor1, motor2, viscous1, viscous2 = map(number, (*parameters.motor_inertia, *parameters.viscous_friction))
    one, two = number(1.0), number(2.0)

    def matrix(entries: dict[tuple[int, int], Any]) -> list[list[Any]]:
        return [[entries.get((row, column), number(0.0)) for column in range(4)] for row in range(4)]

    E = matrix({(0, 0): one, (1, 1): one, (2, 2): motor1 + c1, (2, 3): c3, (3, 2): c3, (3, 3): motor2 + c3})
    E1 = matrix({(2, 2): 2 * c2, (2, 3): c2, (3, 2): c2})
    A = matrix({(0, 2): one, (1, 3): one, (2, 2): -viscous1, (3, 3): -viscous2})
    A2, A3 = matrix({(2, 0): one}), matrix({(2, 1): one, (3, 0): one, (3, 1): one})
    A4, A5 = matrix({(2, 2): two, (2, 3): one}), matrix({(3, 2): one})
    return {
        "E": (np.array(E), np.array([E1, *[matrix({})] * 4])),
        "A": (np.array(A), np.array([matrix({}), A2, A3, A4, A5])),
    }


def _constants(parameters: ArmParameters, number: Callable[[float], Any]) -> tuple[Any, ...]:
    """Return the constants c1..c5 of the arm, (3) of the paper, from its parameters converted by `number`."""
    p = parameters
    length, mass, center, inertia = (tuple(map(number, pair)) for pair in (p.length, p.mass, p.mass_center, p.inertia))
    constants: tuple[Any, ...] = inertia_and_gravity(length, mass, center, inertia, number(p.gravity))
    return constants


def rule_products(omega: Iterable[Any], lanes: tuple[int, ...] = ()) -> np.ndarray:
    """Return the 2^k products (*lanes, 2^k) of k factors, one for each of the k arrays ω (*lanes): ω or 1 - ω.

    The first factor changes fastest from one product to the next; 1 - ω comes before ω.
    """
    weights = np.ones((*lanes, 1))
    for value in omega:
        ratio = np.asarray(value)[..., np.newaxis]
        weights = np.concatenate([weights * (1.0 - ratio), weights * ratio], axis=-1)
    return weights
