"""How stable the loop with a network is: the linear map over a control period, and a loss of its eigenvalues.

At a posture, in a condition of `fuzzyarm margins` (loop gain κ, lateness d, plant), the linear loop has the states
plant x, both observers (x̂, d̂)⁻, last ρ, h, and the torques that have not acted yet. With ν = C (x - x̂⁻) and what
would follow of each observer alone, u_o and u_q, see `estimate.policy`,

    z = S_ν ν + S_d d̂ + S_δ (u_q - u_o) + S_ρ ρ⁻,    (h⁺, ρ) by the slopes of the network,
    u = u_o + R ρ,    (x̂, d̂)⁺ = F (x̂, d̂) + E u for both,    x⁺ = A x + B κ u late by d.

A, B, F and E are those of the arms, see `eval.stability.local_loop`. The loss is Σ max(|λ| - λ_max, 0) over
the eigenvalues λ of this map.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import torch
from scipy.linalg import eig

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, mass_matrix
from fuzzyarm.eval.stability.linearisation import linearise
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import GainTables, sampled_arm
from fuzzyarm.learned_policy.estimate.policy import LearnedObserverPolicy
from fuzzyarm.learned_policy.estimate.signals import COARSE, FINE, QUICK_SHARE, TORQUES, UNEXPLAINED, UNEXPLAINED_PARTS
from fuzzyarm.rl_baselines.estimate.student import Student

__all__ = ["CONDITIONS", "Condition", "Loops", "Points", "eigenvalue_loss"]

_PLANT, _OBSERVER = 4 * JOINTS, 5 * JOINTS
_DEFECTIVE = 1e-8  # overlap of left and right eigenvectors below which a derivative is left out
_LATE = 2  # torques that have not acted yet
_MEASURED = np.r_[0:JOINTS, 2 * JOINTS : 3 * JOINTS]


class Points(NamedTuple):
    """Where loops are linearised.

    Attributes:
        loop: (points,) numbers of loops.
        z: (points, numbers of z).
        c: (points, numbers of c).
        h: (points, hidden).
    """

    loop: torch.Tensor
    z: torch.Tensor
    c: torch.Tensor
    h: torch.Tensor


class Condition(NamedTuple):
    """How the plant differs from the one that is known: κ, d [control periods], factor on stiffness, payload [kg]."""

    gain: float = 1.0
    delay: float = 0.0
    stiffness: float = 1.0
    payload: float = 0.0


CONDITIONS = (
    Condition(),
    Condition(gain=0.67),
    Condition(gain=1.5),
    Condition(delay=0.5),
    Condition(delay=1.0),
    Condition(stiffness=0.8),
    Condition(stiffness=1.2),
    Condition(payload=5.0),
)
"""Those of `fuzzyarm margins`."""
_ANGLES = tuple((0.6, q2) for q2 in (0.0, 0.7, 1.2, 1.6, 2.0, 2.6))  # rad


@dataclasses.dataclass(frozen=True, eq=False)
class Loops:
    """The linear loops without the network, one for each posture and condition.

    Attributes:
        base: (loops, m, m) the map without the network; m states with an empty place for h at the end.
        sees: (loops, z, m) the linear part of z at small signals: asinh ξ = ξ.
        acts: (loops, m, 2) what ρ adds.
        cosine: (loops,) of q_2.
        reference: (loops,) the largest |λ| without the network.
    """

    base: torch.Tensor
    sees: torch.Tensor
    acts: torch.Tensor
    cosine: np.ndarray
    reference: torch.Tensor

    @classmethod
    def of(cls, policy: LearnedObserverPolicy) -> Loops:
        """Linearise the observer of a policy."""
        rows = [_loop(policy, np.array(q), condition) for q in _ANGLES for condition in CONDITIONS]
        base, sees, acts = (torch.from_numpy(np.array(part)) for part in zip(*rows, strict=True))
        cosine = np.repeat([np.cos(q[1]) for q in _ANGLES], len(CONDITIONS))
        return cls(base, sees, acts, cosine, torch.linalg.eigvals(base).abs().amax(dim=1))

    def points(self, which: np.ndarray, z: torch.Tensor, c: torch.Tensor, h: torch.Tensor) -> Points:
        """Return points at visited z, c and h (points, ·), in the conditions of the loops `which` (points,).

        The loop of a point is that of the nearest posture. The network's numbers are dimensionless.
        """
        context, count = c.double(), len(CONDITIONS)
        c1, s1, c12, s12 = context[:, : 2 * JOINTS].T
        cosine = (c1 * c12 + s1 * s12).numpy()
        nearest = np.abs(cosine[:, np.newaxis] - self.cosine[::count]).argmin(axis=1)
        return Points(torch.from_numpy(nearest * count + which % count), z.double(), context, h.double())


def _loop(policy: LearnedObserverPolicy, q: np.ndarray, condition: Condition) -> tuple[np.ndarray, ...]:
    """Return `base`, `sees` and `acts` of a posture and a condition."""
    arm, period = policy.parameters, policy.control_period
    stiffer = (condition.stiffness * arm.stiffness[0], condition.stiffness * arm.stiffness[1])
    plant = dataclasses.replace(arm, stiffness=stiffer)
    # unit vectors of (x, observer, last ρ, past torques, ρ)
    size = _PLANT + 2 * _OBSERVER + JOINTS + _LATE * JOINTS
    unit = np.eye(size + JOINTS)
    parts = np.cumsum([_PLANT, _OBSERVER, _OBSERVER, JOINTS, _LATE * JOINTS])
    x, s, quick, last, past, rho = np.split(unit, parts.tolist())
    observer = ElasticObserverPolicy(arm, period)
    loop = linearise(observer, plant, q, period, Payload(condition.payload))
    known = linearise(observer, arm, q, period).plant
    # what a load of the links does in a control period
    inertia = np.array(mass_matrix(np.cos(q[1]), arm_constants(arm)))[[[0, 1], [1, 2]]]
    loaded = sampled_arm(arm, period, inertia)[0][:_PLANT, _PLANT:]

    def correct(estimate: np.ndarray, gains: GainTables) -> tuple[np.ndarray, np.ndarray]:
        corrected = estimate + _at(gains.observer, q) @ (x - estimate[:_PLANT])[_MEASURED]
        bent, load = corrected[:_PLANT].copy(), corrected[_PLANT:]
        bent[:JOINTS] += load / np.array(arm.stiffness)[:, None]
        return corrected, -load - _at(gains.feedback, q) @ bent

    innovation = (x - s[:_PLANT])[_MEASURED]
    (corrected, steady), (soon, hasty) = correct(s, policy.gains), correct(quick, policy.quick)
    load, own = corrected[_PLANT:], np.diag(TORQUES) @ rho + steady
    predict = np.vstack([np.hstack([known[:, :_PLANT], loaded]), np.eye(JOINTS, _OBSERVER, _PLANT)])
    told = np.vstack([known[:, _PLANT:] @ own, np.zeros((JOINTS, size + JOINTS))])
    torques = np.vstack([condition.gain * own, past])
    first = int(np.ceil(condition.delay)) * JOINTS
    if float(condition.delay).is_integer():
        moved = loop.plant @ np.vstack([x, torques[first : first + JOINTS]])
    else:
        moved = loop.half_plant @ np.vstack([x, torques[first : first + JOINTS]])
        moved = loop.half_plant @ np.vstack([moved, torques[first - JOINTS : first]])
    full = np.vstack([moved, predict @ corrected + told, predict @ soon + told, rho, torques[:-JOINTS]])
    sees = np.zeros((UNEXPLAINED, size))
    part = UNEXPLAINED_PARTS
    for where, row in (
        (part.fine, innovation / np.array(FINE)[:, None]),
        (part.coarse, innovation / np.array(FINE)[:, None]),
        (part.load, load / np.array(TORQUES)[:, None]),
        (part.quick, (hasty - steady) / (QUICK_SHARE * np.array(TORQUES)[:, None])),
        (part.residual, last),
    ):
        sees[where] = row[:, :size]
    return full[:, :size], sees, full[:, size:]


def _at(table: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return gains (rows, columns), interpolated from a table over cos q_2, at a posture (2,) [rad]."""
    place = 0.5 * (np.cos(q[1]) + 1.0) * (len(table) - 1)
    left = min(int(place), len(table) - 2)
    gain: np.ndarray = (left + 1 - place) * table[left] + (place - left) * table[left + 1]
    return gain


def eigenvalue_loss(student: Student, loops: Loops, points: Points, largest: float) -> tuple[torch.Tensor, float]:
    """Return the mean over points of Σ max(|λ| - λ_max, 0), with λ_max = `largest`, and the largest |λ|.

    Where the observer alone has a larger |λ|, its own is allowed, and 0.001 more. All are numbers without a unit.
    """
    which, z = points.loop, points.z
    slopes = student.slopes(z, points.c, points.h)
    size, hidden, count = loops.base.shape[-1], points.h.shape[1], len(which)
    sees = loops.sees[which].clone()
    fine, coarse = UNEXPLAINED_PARTS.fine, UNEXPLAINED_PARTS.coarse
    # the slopes of asinh ξ and of asinh(ξ s/S) ξ²/(1 + ξ²) by ξ = ν/s
    xi, ratio = torch.sinh(z[:, fine]), torch.tensor(FINE, dtype=torch.float64) / torch.tensor(COARSE)
    share, scaled = xi * xi / (1.0 + xi * xi), ratio * xi
    bent = ratio * share * torch.rsqrt(1.0 + scaled**2) + torch.asinh(scaled) * 2.0 * xi / (1.0 + xi * xi) ** 2
    sees[:, fine] *= torch.rsqrt(1.0 + xi * xi)[:, :, None]
    sees[:, UNEXPLAINED_PARTS.quick] /= torch.cosh(z[:, UNEXPLAINED_PARTS.quick])[:, :, None]
    sees[:, coarse] *= bent[:, :, None]
    acts = loops.acts[which]
    rho = torch.cat([slopes.rho_z @ sees, slopes.rho_h], dim=2)
    top = torch.cat([loops.base[which], torch.zeros(count, size, hidden, dtype=torch.float64)], dim=2) + acts @ rho
    full = torch.cat([top, torch.cat([slopes.h_z @ sees, slopes.h_h], dim=2)], dim=1)
    allowed = torch.clamp(loops.reference[which] + 1e-3, min=largest).numpy()
    excess, slope, radius = _excess(full.detach().numpy(), allowed)
    product = (full * torch.from_numpy(slope)).sum() / count
    return product - product.detach() + excess / count, float(radius.max())


def _excess(matrices: np.ndarray, allowed: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return Σ max(|λ| - allowed, 0), its derivatives by the matrices (points, m, m), and max |λ| (points,).

    A simple eigenvalue with right and left vectors v and w moves by wᴴ dM v/(wᴴ v).
    """
    total, slope, radius = 0.0, np.zeros_like(matrices), np.zeros(len(matrices))
    for point, (matrix, bound) in enumerate(zip(matrices, allowed, strict=True)):
        radius[point] = np.abs(np.linalg.eigvals(matrix)).max()
        if radius[point] <= bound:
            continue
        values, left, right = eig(matrix, left=True)
        for number in np.flatnonzero(np.abs(values) > bound):
            value, w, v = values[number], left[:, number].conj(), right[:, number]
            overlap = w @ v
            if abs(overlap) > _DEFECTIVE:
                total += abs(value) - bound
                slope[point] += np.real(np.conj(value) / abs(value) * np.outer(w, v) / overlap)
    return total, slope, radius
