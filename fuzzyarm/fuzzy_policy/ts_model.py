"""Takagi-Sugeno descriptor model of the rigid arm (paper sections 3, 5.1 and 6.1).

The rigid arm is E(z) ẋ = A(z) x + B u + B d with x = (q, q̇), affine in the five premises (6):

    z1 = cos q2,   z2 = -c4 sinc q1 - c5 sinc q12,   z3 = -c5 sinc q12,   z4 = c2 q̇2 sin q2,   z5 = -c2 q̇1 sin q2.

A *kept* premise is interpolated between its bounds (two rules each); a dropped one becomes norm-bounded
uncertainty around the middle of its range. All matrices are in SI units.
"""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction
from functools import cached_property

import numpy as np

from fuzzyarm.envs.dynamics import arm_constants
from fuzzyarm.envs.parameters import ArmParameters

PREMISES = ("z1", "z2", "z3", "z4", "z5")
NAMED_RULES = {
    32: ("z1", "z2", "z3", "z4", "z5"),
    16: ("z1", "z2", "z3", "z4"),
    8: ("z1", "z2", "z3"),
    4: ("z1", "z3"),
    2: ("z3",),
    1: (),
}
"""Kept premises of the models named by their number of rules. 8, 4 and 2 are the paper's (section 6.1.2)."""

# sinc x = sin x / x has its minimum -0.21723362821122165740... where tan x = x (x = 4.4934...); rounded outwards.
SINC_MINIMUM = Fraction("-0.2172336282112217")
# Bounds are widened by this share of their range, far above the rounding of a premise evaluated in floating point.
GUARD = Fraction(1, 10**12)


def premise_bounds(parameters: ArmParameters) -> np.ndarray:
    """Return bounds (5, 2) of the premises over the joint box (25), rounded outwards.

    The bounds are computed in exact rational arithmetic from the given floats; with |q1| <= π, sinc q1 lies in
    [0, 1] and sinc q12 in [-0.2172..., 1]. They are valid for any box with joint limits up to π.
    """
    f = Fraction
    length1, (m1, m2), (r1, r2), g = (
        f(parameters.length[0]),
        map(f, parameters.mass),
        map(f, parameters.mass_center),
        f(parameters.gravity),
    )
    c2, c4, c5 = m2 * length1 * r2, m1 * g * r1 + m2 * g * length1, m2 * g * r2
    dq1, dq2 = map(f, parameters.velocity_limit)
    exact = [
        (f(-1), f(1)),
        (-(c4 + c5), -c5 * SINC_MINIMUM),
        (-c5, -c5 * SINC_MINIMUM),
        (-c2 * dq2, c2 * dq2),
        (-c2 * dq1, c2 * dq1),
    ]
    return np.array([[_outwards(low, high, -1), _outwards(low, high, 1)] for low, high in exact])


def _outwards(low: Fraction, high: Fraction, side: int) -> float:
    """Return the float beyond `low` (side -1) or `high` (side 1), widened by the guard."""
    target = (low if side < 0 else high) + side * GUARD * (high - low)
    rounded = float(target)
    return rounded if side * (Fraction(rounded) - target) >= 0 else math.nextafter(rounded, side * math.inf)


def premises(q: np.ndarray, dq: np.ndarray, parameters: ArmParameters) -> np.ndarray:
    """Return the premises (..., 5) of (6) at angles q [rad] and velocities q̇ [rad/s] of shape (..., 2)."""
    arm = arm_constants(parameters)
    sinc1, sinc12 = np.sinc(q[..., 0] / np.pi), np.sinc((q[..., 0] + q[..., 1]) / np.pi)
    sin2 = np.sin(q[..., 1])
    return np.stack(
        [
            np.cos(q[..., 1]),
            -arm.c4 * sinc1 - arm.c5 * sinc12,
            -arm.c5 * sinc12,
            arm.c2 * dq[..., 1] * sin2,
            -arm.c2 * dq[..., 0] * sin2,
        ],
        axis=-1,
    )


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """One dropped premise as Hᵀ f W with |f| <= 1: on E (z1) or on A (the others). H and W are (rows, 4)."""

    premise: str
    on: str
    H: np.ndarray
    W: np.ndarray


@dataclasses.dataclass(frozen=True)
class TSModel:
    """The T-S descriptor model with the premises `kept`, a subset of z1..z5 in any order.

    Vertices are ordered as in section 6.1.2, the minimum first and the first kept premise fastest:
    E_1 = E(z1min), A_1 = A(z2min, z3min), A_2 = A(z2max, z3min), ...
    """

    parameters: ArmParameters
    kept: tuple[str, ...] = NAMED_RULES[4]

    def __post_init__(self) -> None:
        """Check and sort the kept premises."""
        unknown = [name for name in self.kept if name not in PREMISES]
        if unknown or len(set(self.kept)) != len(self.kept):
            raise ValueError(f"kept premises {self.kept}: choose different ones from {', '.join(PREMISES)}")
        object.__setattr__(self, "kept", tuple(sorted(self.kept)))

    @property
    def rules(self) -> int:
        """Number of fuzzy rules, two to the number of kept premises."""
        return 1 << len(self.kept)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Bounds (5, 2) of the premises, see `premise_bounds`."""
        return premise_bounds(self.parameters)

    @property
    def kept_in_E(self) -> list[int]:
        """Indices of the kept premises of E: [0] or []."""
        return [0] if "z1" in self.kept else []

    @property
    def kept_in_A(self) -> list[int]:
        """Indices of the kept premises of A, a subset of [1, 2, 3, 4]."""
        return [PREMISES.index(name) for name in self.kept if name != "z1"]

    def E(self, z: np.ndarray) -> np.ndarray:
        """Return E_p(z) of (5), (4, 4), for premises z (5,)."""
        base, slope = self._E_terms()
        vertex: np.ndarray = base + z[0] * slope
        return vertex

    def A(self, z: np.ndarray) -> np.ndarray:
        """Return A_p(z) of (5), (4, 4), for premises z (5,)."""
        base, slopes = self._A_terms()
        vertex: np.ndarray = base + np.tensordot(z[1:], slopes, axes=1)
        return vertex

    @property
    def B(self) -> np.ndarray:
        """Input matrix B_p = B_d (4, 2) of (5)."""
        return np.vstack([np.zeros((2, 2)), np.eye(2)])

    @cached_property
    def E_vertices(self) -> list[np.ndarray]:
        """The N_e matrices E_pk; dropped premises stand at the middle of their range."""
        return [self.E(z) for z in self._corners(self.kept_in_E)]

    @cached_property
    def A_vertices(self) -> list[np.ndarray]:
        """The N matrices A_pi, likewise."""
        return [self.A(z) for z in self._corners(self.kept_in_A)]

    @cached_property
    def uncertainties(self) -> list[Uncertainty]:
        """The dropped premises, ΔE = Hᵀ f W or ΔA = Hᵀ f W with |f| <= 1 (section 5.1)."""
        radius = 0.5 * (self.bounds[:, 1] - self.bounds[:, 0])
        slopes = [self._E_terms()[1], *self._A_terms()[1]]
        result = []
        for index, name in enumerate(PREMISES):
            if name in self.kept:
                continue
            # H picks the dynamic rows the premise acts on, W holds those rows: Hᵀ W is the slope, exactly.
            rows = np.flatnonzero(slopes[index].any(axis=1))
            result.append(
                Uncertainty(name, "E" if index == 0 else "A", np.eye(4)[rows], radius[index] * slopes[index][rows])
            )
        return result

    def weights(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the memberships h (N,) and v (N_e,) at premises z (5,): in [0, 1], each summing to one.

        ω = (z - z_min)/(z_max - z_min) is the weight of the *max* vertex. Outside the box (25) premises are held at
        their bounds: the weights stay convex, the model is then no longer exact.
        """
        low, high = self.bounds[:, 0], self.bounds[:, 1]
        omega = np.clip((z - low) / (high - low), 0.0, 1.0)
        return _products(omega[self.kept_in_A]), _products(omega[self.kept_in_E])

    def _corners(self, kept: list[int]) -> np.ndarray:
        """Return premise vectors (2^len(kept), 5): every corner of the kept ones, the others at mid-range."""
        corners = np.repeat(self.bounds.mean(axis=1)[np.newaxis], 2 ** len(kept), axis=0)
        for position, index in enumerate(kept):
            bit = (np.arange(len(corners)) >> position) & 1
            corners[:, index] = self.bounds[index][bit]
        return corners

    def _E_terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Return E_p(z) as (base, slope over z1)."""
        p, arm = self.parameters, arm_constants(self.parameters)
        base, slope = np.eye(4), np.zeros((4, 4))
        base[2:, 2:] = [[p.motor_inertia[0] + arm.c1, arm.c3], [arm.c3, p.motor_inertia[1] + arm.c3]]
        slope[2:, 2:] = arm.c2 * np.array([[2.0, 1.0], [1.0, 0.0]])
        return base, slope

    def _A_terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Return A_p(z) as (base, slopes (4, 4, 4) over z2..z5)."""
        base, slopes = np.zeros((4, 4)), np.zeros((4, 4, 4))
        base[:2, 2:] = np.eye(2)
        base[2:, 2:] = -np.diag(self.parameters.viscous_friction)
        slopes[0, 2, 0] = 1.0
        slopes[1, 2, 1] = slopes[1, 3, 0] = slopes[1, 3, 1] = 1.0
        slopes[2, 2, 2], slopes[2, 2, 3] = 2.0, 1.0
        slopes[3, 3, 2] = 1.0
        return base, slopes


def _products(omega: np.ndarray) -> np.ndarray:
    """Return the 2^len(ω) products of ω or 1 - ω, the first factor fastest, the minimum (1 - ω) first."""
    weights = np.ones(1)
    for value in omega:
        weights = np.concatenate([weights * (1.0 - value), weights * value])
    return weights
