"""Units of the design problem, since interior-point solvers fail in SI units.

With x in units T, time in 1/σ, torques in U, disturbances in V, and the rows of E ẋ = A x + B u + B d in units 1/R, the
matrices of the arm are of order one. The decision variables are numbers of order one times the units

    P: T Tᵀ,   M: U Tᵀ,   L: U V⁻ᵀ,   Q: σ T Tᵀ,   X: T R⁻ᵀ,   τ_l: n_l²/σ,

with the unit n_l of uncertain term l, and the rows of Ψ are multiplied by `rows`: a congruence, which changes no
solution. P has a further unit c; see `DesignProblem`.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.ts_model import PLANT, VELOCITY, Uncertainty
from fuzzyarm.proof.vertices import REFERENCE_POLE, TrackingVertices, Vertices

__all__ = ["Scaling"]


@dataclasses.dataclass(frozen=True)
class Scaling:
    """The units of a design problem; see the docstring of the module."""

    time: float  # σ [rad/s], the pole of the paper's reference model
    state: np.ndarray  # T, (n,)
    row: np.ndarray  # R, (n,)
    torque: np.ndarray  # U, (2,) [N m]
    disturbance: np.ndarray  # V, (n_w,): of d in the consistent form, of (d, r) in the paper's
    output: np.ndarray  # of z, (n_z,): 1, or Q^(1/2) in the paper's form, where Ψ has -Q⁻¹
    uncertainty: np.ndarray  # n_l, (m,)
    terms: tuple[int, ...]  # rows of each uncertain term, (m,)

    @classmethod
    def of(cls, data: Vertices, parameters: ArmParameters) -> Scaling:
        """Return the units for an arm, based on the geometric mean of each joint's inertia and the mean inertia.

        The joint's inertia alone would favour equal bandwidths of both joints, the mean inertia alone equal stiffness.
        """
        arm, time = arm_constants(parameters), REFERENCE_POLE
        inertia = np.array(parameters.motor_inertia) + np.array([arm.c1, arm.c3])
        angle = 1.0 / np.sqrt(np.sqrt(inertia * inertia.mean()))
        error = np.concatenate([angle, angle * time, angle / time])[: data.n_e]
        torque, state, disturbance, output = time**2 / angle, error, time**2 / angle, np.ones(JOINTS)
        if isinstance(data, TrackingVertices):
            state = np.concatenate([error, error[PLANT]])
            disturbance = np.concatenate([torque, angle, angle * time, angle * time**2])
            output = 1.0 / np.sqrt(np.diag(data.Q_inverse))
        row = 1.0 / (state * time)
        row[VELOCITY] = angle / time**2
        balance = [_balance(term, data, state[PLANT], row[PLANT], time) for term in data.uncertainties]
        sizes = tuple(len(term.H) for term in data.uncertainties)
        return cls(time, state, row, torque, disturbance, output, np.array(balance), sizes)

    @property
    def rows(self) -> np.ndarray:
        """Factors (rows,) on the rows x, ẋ, w, z and uncertain terms of Ψ; those of d, in w, are in N m s^½."""
        root = np.sqrt(self.time)
        terms = np.repeat(root / self.uncertainty, self.terms)
        return np.concatenate([1.0 / (self.state * root), self.row * root, self.disturbance / root, self.output, terms])

    @property
    def stiffness(self) -> float:
        """The unit of joint 1's position gain, U_1/T_1 [N m/rad]."""
        return float(self.torque[0] / self.state[0])


def _balance(term: Uncertainty, data: Vertices, state: np.ndarray, row: np.ndarray, time: float) -> float:
    """Return the unit n_l of an uncertain term that gives n_l H R and W T/n_l (for E, σ W T/n_l) the same norm.

    T, R and σ are `state` (4,), `row` (4,) and `time`. If `data` has the paper's form, W also multiplies x_r.
    """
    reads = [term.W * state * (1.0 if term.on == "A" else time)]
    if isinstance(data, TrackingVertices):
        reads.append((term.W if term.on == "A" else term.W @ data.A_r) * state)
    size = max(np.linalg.norm(reads[0]), np.linalg.norm(reads[-1])) if term.on == "E" else np.linalg.norm(reads)
    return float(np.sqrt(size / np.linalg.norm(term.H * row)))
