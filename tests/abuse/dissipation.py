"""The dissipation inequality of a controller's claim at states of its arm, from the equations of the arm alone.

Nothing here is shared with the proof: no vertex, no uncertain term, no slack and no rational number.
"""

from __future__ import annotations

import itertools

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController

__all__ = ["excess", "scheduled_excess"]

REFERENCE_POLE = 62.0  # rad/s, double pole of (8)


def excess(controller: Controller, count: int = 400) -> float:
    """Return the largest V' + z'z - γ²w'w + 2αV of any error and disturbance with V = 1 [1/s]: a true claim has < 0.

    V = x'P⁻¹x. The states of the arm are random ones of the box, its corners, and those at which a premise is extreme;
    the disturbance is the worst one. A claimed fastest pole has to hold as well, V' + 2βV > 0.
    """
    try:
        R = np.linalg.cholesky(controller.P)
    except np.linalg.LinAlgError:
        return np.inf
    worst = -np.inf
    for q, dq in _states(controller.model.parameters, count):
        F, G, weight = _loop(controller, q, dq)
        inner, entry = np.linalg.solve(R, F @ R), np.linalg.solve(R, G) / controller.gamma
        rate = inner + inner.T
        form = rate + 2.0 * controller.alpha * np.eye(len(R)) + R.T @ weight @ R + entry @ entry.T
        worst = max(worst, float(np.linalg.eigvalsh(form)[-1]))
        if controller.fastest_pole is not None:
            worst = max(worst, -float(np.linalg.eigvalsh(rate)[0]) - 2.0 * controller.fastest_pole)
    return worst


def _states(arm: ArmParameters, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    limits = np.array([*arm.joint_limit, *arm.velocity_limit])
    shares = [
        np.array(one)
        for one in itertools.product((0.0, 0.5, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0), (-1.0, 1.0), (-1.0, 1.0))
    ]
    shares += list(np.random.default_rng(0).uniform(-1.0, 1.0, (count, 4)))
    return [(x[:2], x[2:]) for x in (share * limits for share in shares)]


def _premises(arm: ArmParameters, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return E and A of (5), (4, 4) each, E x' = A x + B (u + d)."""
    (L1, _), (m1, m2), (r1, r2) = arm.length, arm.mass, arm.mass_center
    c2, c3 = m2 * L1 * r2, m2 * r2**2 + arm.inertia[1]
    c1 = m1 * r1**2 + arm.inertia[0] + m2 * L1**2 + c3
    c4, c5 = arm.gravity * (m1 * r1 + m2 * L1), arm.gravity * m2 * r2
    sinc1, sinc12, cos2, sin2 = np.sinc(q[0] / np.pi), np.sinc((q[0] + q[1]) / np.pi), np.cos(q[1]), np.sin(q[1])
    E, A = np.eye(4), np.zeros((4, 4))
    E[2:, 2:] = [[c1 + 2.0 * c2 * cos2, c3 + c2 * cos2], [c3 + c2 * cos2, c3]]
    E[2:, 2:] += np.diag(arm.motor_inertia)
    A[:2, 2:] = np.eye(2)
    A[2:, :2] = [[-c4 * sinc1 - c5 * sinc12, -c5 * sinc12], [-c5 * sinc12, -c5 * sinc12]]
    A[2:, 2:] = [[2.0 * c2 * dq[1] * sin2, c2 * dq[1] * sin2], [-c2 * dq[0] * sin2, 0.0]]
    A[2:, 2:] -= np.diag(arm.viscous_friction)
    return E, A


def _loop(controller: Controller, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return F, G of x' = F x + G w and the weight of z'z; x = (e, x_I), in the paper's form (e, x_I, x_r)."""
    arm = controller.model.parameters
    E, A = _premises(arm, q, dq)
    c2, c5 = arm.mass[1] * arm.length[0] * arm.mass_center[1], arm.gravity * arm.mass[1] * arm.mass_center[1]
    z = np.array([np.cos(q[1]), A[2, 0], A[3, 0], c2 * dq[1] * np.sin(q[1]), -c2 * dq[0] * np.sin(q[1])])
    assert abs(z[2] + c5 * np.sinc((q[0] + q[1]) / np.pi)) < 1e-9 * c5
    h, v = controller.model.weights(z)
    K, n_e = np.einsum("j,k,jkab->ab", h, v, controller.gains), controller.gains.shape[-1]
    B = np.vstack([np.zeros((2, 2)), np.eye(2)])
    F = np.zeros((n_e, n_e))
    F[:4, :4], F[4:, :2] = np.linalg.solve(E, A), np.eye(2)[: n_e - 4]
    F[:4] += np.linalg.solve(E, B @ K)
    G = np.vstack([np.linalg.solve(E, B), np.zeros((n_e - 4, 2))])
    if controller.form == "consistent":
        weight = np.zeros((n_e, n_e))
        weight[:2, :2] = np.eye(2)
        return F, G, weight
    L, p = np.einsum("j,k,jkab->ab", h, v, controller.feedforward), REFERENCE_POLE
    A_r = np.block([[np.zeros((2, 2)), np.eye(2)], [-(p**2) * np.eye(2), -2.0 * p * np.eye(2)]])
    B_r = np.vstack([np.zeros((2, 6)), np.hstack([p**2 * np.eye(2), 2.0 * p * np.eye(2), np.eye(2)])])
    aside = np.zeros((n_e - 4, 4))
    top = np.hstack([F, np.vstack([np.linalg.solve(E, A) - A_r, aside])])
    F = np.vstack([top, np.hstack([np.zeros((4, n_e)), A_r])])
    of_r = np.vstack([np.linalg.solve(E, B @ L) - B_r, np.zeros((n_e - 4, 6)), B_r])
    G = np.hstack([np.vstack([G, np.zeros((4, 2))]), of_r])
    weight = np.zeros((n_e + 4, n_e + 4))
    weight[:4, :4] = np.diag(controller.weight)
    return F, G, weight


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
