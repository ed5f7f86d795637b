"""Designs on the equations of the arm alone: V' + z'z - γ² w'w + 2αV < 0 at random states, inputs and premises.

Design and proof evaluate the same text of each inequality, so a wrong sign in it would pass both. Nothing here knows
an inequality, a vertex or a multiplier: V = xᵀ P⁻¹ x, the gains and their weights meet the descriptor equations
E(z) ẋ = A(z) x + B (u + d) of the arm, written down once more, and the torque of the nonlinear arm.
"""

import dataclasses
import functools

import numpy as np
import pytest
from slow_twins import slow_but
from support.shipped import CONTROLLERS

from fuzzyarm.envs.physics.dynamics import arm_constants, mass_matrix, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.synthesis import Specification, design

ARM = ArmParameters()
C = arm_constants(ARM)
POLE = 62.0  # rad/s, of the reference model (8)
FORMS = {
    "consistent": {"gamma": 1.4e-4},
    "without integral": {"integral": False},
    "with a fastest pole": {"gamma": 1.7e-4, "fastest_pole": 150.0},
    "paper": {"form": "paper", "gamma": 1000.0},
    "paper, free L": {"form": "paper", "gamma": 1000.0, "feedforward": None, "common_multiplier": True},
}


@functools.cache
def designed(rules, form):
    if form == "shipped":
        return Controller.load(CONTROLLERS[f"fuzzy-{rules}"])
    return design(Specification(NAMED_RULES[rules], **FORMS[form])).controller


def E(z):
    """(5): inertias, rotors included, as a function of z1 = cos q2."""
    whole = np.eye(4)
    whole[2:, 2:] = [[C.c1 + 2.0 * C.c2 * z[0], C.c3 + C.c2 * z[0]], [C.c3 + C.c2 * z[0], C.c3]]
    whole[2:, 2:] += np.diag(ARM.motor_inertia)
    return whole


def A(z):
    """(5): gravity by z2 and z3, Coriolis torques by z4 and z5, viscous friction."""
    f = ARM.viscous_friction
    return np.array(
        [[0, 0, 1, 0], [0, 0, 0, 1], [z[1], z[2], 2.0 * z[3] - f[0], z[3]], [z[2], z[2], z[4], -f[1]]], dtype=float
    )


def bounds():
    """Return what z1..z5 may be in the box of the joints (25): |q| <= π and the largest speeds."""
    low_sinc, (fast1, fast2) = -0.2172336282112217, ARM.velocity_limit
    high = np.array([1.0, -C.c5 * low_sinc, -C.c5 * low_sinc, C.c2 * fast2, C.c2 * fast1])
    return np.stack([[-1.0, -C.c4 - C.c5, -C.c5, *-high[3:]], high], axis=1)


def weights(controller, z):
    """Return h and v: products of the ratios of the kept premises, the first one fastest, the minimum first."""
    ratio, h, v = (z - bounds()[:, 0]) / np.diff(bounds(), axis=1)[:, 0], np.ones(1), np.ones(1)
    for name in controller.model.kept:
        x = ratio[int(name[1]) - 1]
        if name == "z1":
            v = np.array([1.0 - x, x])
        else:
            h = np.concatenate([h * (1.0 - x), h * x])
    return h, v


def premises_at(q, dq):
    first, both = np.sinc(q[0] / np.pi), np.sinc((q[0] + q[1]) / np.pi)
    turning = C.c2 * np.sin(q[1])
    return np.array([np.cos(q[1]), -C.c4 * first - C.c5 * both, -C.c5 * both, turning * dq[1], -turning * dq[0]])


def closed_loop(controller, z):
    """Return F and G of ẋ = F x + G w: x = (e, x_I), w = d; in the paper's form x = (e, x_I, x_r), w = (d, r)."""
    h, v = weights(controller, z)
    K, n_e = np.einsum("i,k,ikab->ab", h, v, controller.gains), controller.gains.shape[-1]
    inverse, B = np.linalg.inv(E(z)), np.eye(4)[:, 2:]
    plant = inverse @ (A(z) @ np.eye(4, n_e) + B @ K)
    C_p = np.eye(n_e - 4, n_e)
    if controller.form == "consistent":  # what d holds of the reference is another matter
        return np.vstack([plant, C_p]), np.vstack([inverse @ B, np.zeros((n_e - 4, 2))])
    one, none, L = np.eye(2), np.zeros((2, 2)), np.einsum("i,k,ikab->ab", h, v, controller.feedforward)
    A_r = np.block([[none, one], [-(POLE**2) * one, -2.0 * POLE * one]])
    B_r = np.block([[none, none, none], [POLE**2 * one, 2.0 * POLE * one, one]])
    n = n_e + 4
    F, G = np.zeros((n, n)), np.zeros((n, 8))
    F[:4, :n_e], F[4:n_e, :n_e], F[n_e:, n_e:] = plant, C_p, A_r
    F[:4, n_e:] = inverse @ A(z) - A_r  # e = x_p - x_r, and E ẋ_p = A x_p + B (u + d)
    G[:4, :2], G[:4, 2:], G[n_e:, 2:] = inverse @ B, inverse @ B @ L - B_r, B_r
    return F, G


def largest(controller, z):
    """Return the largest V' + z'z - γ² w'w + 2αV, and V' + 2βV's smallest without w, over x of V = 1 and any w."""
    F, G = closed_loop(controller, z)
    X = np.linalg.inv(controller.P)
    weight = np.zeros(len(F))
    weight[: 2 if controller.weight is None else 4] = 1.0 if controller.weight is None else controller.weight
    root = np.linalg.cholesky(controller.P)
    rate = X @ F + F.T @ X
    # w = Gᵀ X x / γ² is the worst.
    whole = rate + np.diag(weight) + 2.0 * controller.alpha * X + X @ G @ G.T @ X / controller.gamma**2
    slowest = np.linalg.eigvalsh(root.T @ rate @ root)[0]
    return np.linalg.eigvalsh(root.T @ whole @ root)[-1], slowest


def draw(rng, count):
    """Return premises: at states of the box, anywhere within their bounds, and at the corners."""
    low, high = bounds().T
    states = [
        premises_at(*rng.uniform(-1.0, 1.0, (2, 2)) * [ARM.joint_limit, ARM.velocity_limit]) for _ in range(count)
    ]
    inside = rng.uniform(low, high, (count, 5))
    corners = np.where(rng.random((count, 5)) < 0.5, low, high)
    return np.concatenate([states, inside, corners])


every_design = pytest.mark.parametrize(
    "which",
    slow_but(
        [(1, "consistent"), (4, "shipped"), (4, "paper, free L"), (1, "paper")],
        [
            (rules, form)
            for rules in (1, 2, 4, 8)
            for form in ("shipped", *FORMS)
            if "z1" in NAMED_RULES[rules] or "pole" not in form
        ],
    ),
    ids=str,
)


@every_design
def test_v_decays_and_the_disturbance_is_attenuated_as_claimed_and_not_much_more(which):
    """Four times the decay rate, or a tenth of γ, is refuted at some premises: the inequalities are nearly tight."""
    controller = designed(*which)

    def worst(claimed):
        return max(largest(claimed, z)[0] for z in draw(np.random.default_rng(0), 150))

    assert worst(controller) < 0.0 < worst(dataclasses.replace(controller, gamma=0.1 * controller.gamma))
    if controller.fastest_pole is None:
        assert worst(dataclasses.replace(controller, alpha=4.0 * controller.alpha)) > 0.0
        return
    slowest = min(largest(controller, z)[1] for z in draw(np.random.default_rng(2), 150))
    assert -2.0 * controller.fastest_pole < slowest < -4.0 * controller.alpha


def test_the_equations_are_those_of_the_nonlinear_arm():
    """E(z) ẋ - A(z) x is the torque of the plant at any state of the box."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        q, dq = rng.uniform(-1.0, 1.0, (2, 2)) * [ARM.joint_limit, ARM.velocity_limit]
        ddq, z = rng.normal(size=2), premises_at(q, dq)
        m11, m12, m22 = mass_matrix(np.cos(q[1]), C)
        inertia = np.array([[m11, m12], [m12, m22]]) + np.diag(ARM.motor_inertia)
        torque = inertia @ ddq + rigid_inverse_dynamics(q, dq, np.zeros(2), C) + np.array(ARM.viscous_friction) * dq
        found = E(z) @ np.r_[dq, ddq] - A(z) @ np.r_[q, dq]
        np.testing.assert_allclose(found, np.r_[0.0, 0.0, torque], rtol=1e-9, atol=1e-9)
