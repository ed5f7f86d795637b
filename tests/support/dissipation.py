"""The dissipation inequality of a controller's claim, from the equations of the arm alone.

Design and proof evaluate the same text of each inequality, so a wrong sign in it would pass both. Nothing here is
shared with either: no vertex, no uncertain term, no slack and no rational number. The gains and their weights meet the
descriptor equations (5), E(z) x' = A(z) x + B (u + d), which are written down once more.
"""

from __future__ import annotations

import itertools

import numpy as np

from fuzzyarm import ArmParameters, Controller
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController

REFERENCE_POLE = 62.0  # rad/s, double pole of (8)
LOWEST_SINC = -0.2172336282112217


def excess(controller: Controller, count: int = 150) -> float:
    """Return the largest V' + z'z - γ²w'w + 2αV of any error and disturbance with V = 1 [1/s]: a true claim has < 0.

    V = x'P⁻¹x, and the disturbance is the worst one. A claimed fastest pole has to hold as well, V' + 2βV > 0.
    """
    try:
        found = [rates(controller, z) for z in premises(controller.model.parameters, count)]
    except np.linalg.LinAlgError:  # P is not positive definite
        return np.inf
    highest, lowest = np.array(found).T
    beyond_pole = -np.inf if controller.fastest_pole is None else -lowest.min() - 2.0 * controller.fastest_pole
    return float(max(highest.max(), beyond_pole))


def rates(controller: Controller, z: np.ndarray) -> tuple[float, float]:
    """Return the largest V' + z'z - γ²w'w + 2αV, and the smallest V' without w, at V = 1 [1/s]."""
    F, G = _loop(controller, z)
    R = np.linalg.cholesky(controller.P)
    weight = np.zeros(len(F))
    weight[: 2 if controller.weight is None else 4] = 1.0 if controller.weight is None else controller.weight
    inner, entry = np.linalg.solve(R, F @ R), np.linalg.solve(R, G) / controller.gamma
    rate = inner + inner.T
    form = rate + 2.0 * controller.alpha * np.eye(len(R)) + R.T @ np.diag(weight) @ R + entry @ entry.T
    return np.linalg.eigvalsh(form)[-1], np.linalg.eigvalsh(rate)[0]


def premises(arm: ArmParameters, count: int) -> np.ndarray:
    """Return z at states of the box, also where a premise is extreme, anywhere within its bounds, and at corners."""
    (low, high), rng, ends = _bounds(arm), np.random.default_rng(0), (-1.0, 1.0)
    shares = itertools.product((0.0, 0.5, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0), ends, ends)
    limits = np.array([*arm.joint_limit, *arm.velocity_limit])
    drawn = rng.uniform(-1.0, 1.0, (count, 4))
    reached = [premises_at(arm, *np.split(share * limits, 2)) for share in (*shares, *drawn)]
    corners = np.where(rng.random((count, 5)) < 0.5, low, high)
    return np.concatenate([reached, rng.uniform(low, high, (count, 5)), corners])


def _constants(arm: ArmParameters) -> tuple[float, ...]:
    """Return c1 to c3 [kg m²], c4 and c5 [N m]."""
    (L1, _), (m1, m2), (r1, r2) = arm.length, arm.mass, arm.mass_center
    c2, c3 = m2 * L1 * r2, m2 * r2**2 + arm.inertia[1]
    c1 = m1 * r1**2 + arm.inertia[0] + m2 * L1**2 + c3
    return c1, c2, c3, arm.gravity * (m1 * r1 + m2 * L1), arm.gravity * m2 * r2


def premises_at(arm: ArmParameters, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Return z1 to z5 at a state."""
    _, c2, _, c4, c5 = _constants(arm)
    first, both, turning = np.sinc(q[0] / np.pi), np.sinc((q[0] + q[1]) / np.pi), c2 * np.sin(q[1])
    return np.array([np.cos(q[1]), -c4 * first - c5 * both, -c5 * both, turning * dq[1], -turning * dq[0]])


def _bounds(arm: ArmParameters) -> np.ndarray:
    """Return the smallest and largest z in the box of the joints (25): |q| <= π and the largest speeds."""
    _, c2, _, c4, c5 = _constants(arm)
    high = np.array([1.0, -c5 * LOWEST_SINC, -c5 * LOWEST_SINC, c2 * arm.velocity_limit[1], c2 * arm.velocity_limit[0]])
    return np.stack([[-1.0, -c4 - c5, -c5, *-high[3:]], high])


def descriptor(arm: ArmParameters, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return E and A of (5): inertias by z1, gravity by z2 and z3, Coriolis torques by z4 and z5, viscous friction."""
    c1, c2, c3, *_ = _constants(arm)
    E, A = np.eye(4), np.zeros((4, 4))
    E[2:, 2:] = [[c1 + 2.0 * c2 * z[0], c3 + c2 * z[0]], [c3 + c2 * z[0], c3]]
    E[2:, 2:] += np.diag(arm.motor_inertia)
    A[:2, 2:] = np.eye(2)
    A[2:] = [[z[1], z[2], 2.0 * z[3], z[3]], [z[2], z[2], z[4], 0.0]]
    A[2:, 2:] -= np.diag(arm.viscous_friction)
    return E, A


def _weights(controller: Controller, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return h and v: products of the ratios of the kept premises, the first one fastest, the minimum first."""
    low, high = _bounds(controller.model.parameters)
    ratio, h, v = (z - low) / (high - low), np.ones(1), np.ones(1)
    for name in controller.model.kept:
        x = ratio[int(name[1]) - 1]
        if name == "z1":
            v = np.array([1.0 - x, x])
        else:
            h = np.concatenate([h * (1.0 - x), h * x])
    return h, v


def _loop(controller: Controller, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return F and G of x' = F x + G w: x = (e, x_I), w = d; in the paper's form x = (e, x_I, x_r), w = (d, r)."""
    (h, v), (E, A) = _weights(controller, z), descriptor(controller.model.parameters, z)
    K, n_e = np.einsum("j,k,jkab->ab", h, v, controller.gains), controller.gains.shape[-1]
    inverse, B = np.linalg.inv(E), np.eye(4)[:, 2:]
    plant, integral = inverse @ (A @ np.eye(4, n_e) + B @ K), np.eye(n_e - 4, n_e)
    if controller.form == "consistent":  # what d holds of the reference is another matter
        return np.vstack([plant, integral]), np.vstack([inverse @ B, np.zeros((n_e - 4, 2))])
    one, none, p = np.eye(2), np.zeros((2, 2)), REFERENCE_POLE
    L = np.einsum("j,k,jkab->ab", h, v, controller.feedforward)
    A_r = np.block([[none, one], [-(p**2) * one, -2.0 * p * one]])
    B_r = np.block([[none, none, none], [p**2 * one, 2.0 * p * one, one]])
    F, G = np.zeros((n_e + 4, n_e + 4)), np.zeros((n_e + 4, 8))
    F[:4, :n_e], F[4:n_e, :n_e], F[n_e:, n_e:] = plant, integral, A_r
    F[:4, n_e:] = inverse @ A - A_r  # e = x_p - x_r, and E x_p' = A x_p + B (u + d)
    G[:4, :2], G[:4, 2:], G[n_e:, 2:] = inverse @ B, inverse @ B @ L - B_r, B_r
    return F, G


def scheduled_excess(controller: ScheduledController, count: int = 300) -> float:
    """Return the largest V' + e'M̂e - γ²d'M̂⁻¹d + 2αV with V = 1 [1/s], V = x'(X ⊗ M̂)x, x = (e, e', ∫e).

    The derivative of M̂ is a difference quotient at the speed limits, the inertia that of the simulation.
    """
    robot, n, step, worst = controller.robot, len(controller.robot), 1e-6, -np.inf
    low, high = np.array([joint.angle_range for joint in robot.joints]).T
    k, unit = controller.feedback, np.eye(n)
    for q in np.random.default_rng(0).uniform(low, high, (count, n)):
        inertia, scheduled = mass_matrix(robot, q) + np.diag(robot.drive("motor_inertia")), controller.inertia_at(q)
        share, entry = np.linalg.solve(inertia, scheduled), np.linalg.inv(inertia)
        F = np.block([[0 * unit, unit, 0 * unit], [-gain * share for gain in k], [unit, 0 * unit, 0 * unit]])
        G = np.vstack([0 * unit, entry, 0 * unit])
        W, weight = np.kron(controller.lyapunov, scheduled), np.zeros((3 * n, 3 * n))
        weight[:n, :n] = scheduled
        try:
            R = np.linalg.cholesky(W)
        except np.linalg.LinAlgError:
            return np.inf
        worst = max(worst, float(np.abs(np.linalg.eigvals(F)).max()) - controller.fastest_pole)
        for signs in itertools.product((-1.0, 1.0), repeat=len(controller.premises)):
            ahead = q.copy()
            for premise, speed, sign in zip(controller.premises, controller.speeds, signs, strict=True):
                ahead[premise.joint] += step * sign * speed
            turning = np.kron(controller.lyapunov, (controller.inertia_at(ahead) - scheduled) / step)
            pushed = W @ G @ scheduled @ G.T @ W / controller.gamma**2
            form = F.T @ W + W @ F + turning + weight + pushed + 2.0 * controller.alpha * W
            inverse = np.linalg.inv(R)
            worst = max(worst, float(np.linalg.eigvalsh(inverse @ form @ inverse.T)[-1]))
    return worst
