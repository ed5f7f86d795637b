"""The certificate: the inequality means what it says, and a changed file does not pass."""

import dataclasses
import itertools

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.certificate import certify
from fuzzyarm.fuzzy_policy.ts_model import premises


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


def closed_loop(controller, q, dq):
    """Return Ē⁻¹(Ā + B̄K̄) and Ē⁻¹B̄ of the rigid arm at a state, from (5) itself: no vertex, no uncertainty block."""
    model = controller.model
    z = premises(q, dq, model.parameters)
    h, v = model.weights(z)
    gain = np.einsum("i,k,ikab->ab", h, v, controller.gains)
    n = gain.shape[1]
    E, A, B = np.eye(n), np.zeros((n, n)), np.zeros((n, 2))
    E[:4, :4], A[:4, :4], B[2:4] = model.E(z), model.A(z), np.eye(2)
    A[4:, :2] = np.eye(2)[: n - 4]
    return np.linalg.solve(E, A + B @ gain), np.linalg.solve(E, B)


def dissipation(controller, q, dq, e, d):
    """Return V' + zᵀz - γ² dᵀd + 2αV along the nonlinear rigid error dynamics."""
    F, G = closed_loop(controller, q, dq)
    y = np.linalg.solve(controller.P, e)
    rate = 2.0 * y @ (F @ e + G @ d)
    return rate + e[:2] @ e[:2] - controller.gamma**2 * d @ d + 2.0 * controller.alpha * e @ y


def worst_disturbance(controller, q, dq, e):
    """Return the d that maximises the dissipation, P⁻¹-gradient over γ²."""
    _, G = closed_loop(controller, q, dq)
    return G.T @ np.linalg.solve(controller.P, e) / controller.gamma**2


def test_dissipation_holds_on_the_nonlinear_rigid_arm(controller):
    """An independent formulation: random states, errors and disturbances, the worst one included."""
    rng = np.random.default_rng(0)
    p = controller.model.parameters
    root = np.linalg.cholesky(controller.P)
    for _ in range(3000):
        q = rng.uniform(-1, 1, 2) * p.joint_limit
        dq = rng.uniform(-1, 1, 2) * p.velocity_limit
        e = root @ rng.normal(size=len(root))
        worst = worst_disturbance(controller, q, dq, e)
        for d in (np.zeros(2), worst, worst + rng.normal(size=2) * np.linalg.norm(worst)):
            assert dissipation(controller, q, dq, e, d) < 0.0


def test_dissipation_holds_at_the_corners_of_the_box(controller):
    p = controller.model.parameters
    root = np.linalg.cholesky(controller.P)
    rng = np.random.default_rng(1)
    for signs in itertools.product((-1.0, -0.5, 0.0, 0.5, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0), (-1.0, 1.0), (-1.0, 1.0)):
        q, dq = np.array(signs[:2]) * p.joint_limit, np.array(signs[2:]) * p.velocity_limit
        for _ in range(5):
            e = root @ rng.normal(size=len(root))
            assert dissipation(controller, q, dq, e, worst_disturbance(controller, q, dq, e)) < 0.0


def test_a_faster_decay_than_certified_is_refuted(controller):
    """The test above can fail: with three times the certified α the same check finds a violation."""
    faster = dataclasses.replace(controller, alpha=3.0 * controller.alpha)
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(controller.P)
    values = [
        dissipation(faster, rng.uniform(-3, 3, 2), np.zeros(2), root @ rng.normal(size=6), np.zeros(2))
        for _ in range(300)
    ]
    assert max(values) > 0.0
    assert not certify(faster).proven


def test_the_lyapunov_function_decays_at_the_certified_rate(controller):
    """Integrated error dynamics on the moving rigid arm, premises along a swing through the whole box."""
    rng = np.random.default_rng(3)
    h = 1e-4
    e = np.linalg.cholesky(controller.P) @ rng.normal(size=6)
    energy = [e @ np.linalg.solve(controller.P, e)]
    for step in range(2000):
        phase = 40.0 * h * step
        q, dq = np.array([3.0 * np.sin(phase), 3.0 * np.cos(0.7 * phase)]), 14.0 * np.array([np.cos(phase), -1.0])
        F, _ = closed_loop(controller, q, dq)
        middle = e + 0.5 * h * F @ e
        e = e + h * F @ middle
        energy.append(e @ np.linalg.solve(controller.P, e))
    time = h * np.arange(len(energy))
    assert np.all(np.array(energy) <= energy[0] * np.exp(-2.0 * controller.alpha * time) * (1.0 + 1e-9))


def test_shipped_controller_holds_with_room(controller):
    certificate = certify(controller)
    assert certificate.proven
    assert certificate.margin > 1e-6
    N, N_e = 2, 2
    assert len(certificate.claims) == 1 + N_e * N * (N + 1) // 2


@pytest.mark.parametrize("field", ["gains", "P", "Q", "X", "tau", "alpha", "gamma"])
def test_a_changed_value_fails_the_check(controller, field):
    value = getattr(controller, field)
    if field == "alpha":
        changed = 2.0 * value
    elif field == "gamma":
        changed = 0.3 * value
    else:
        changed = np.array(value)
        changed.flat[0] *= -1.0
    assert not certify(dataclasses.replace(controller, **{field: changed})).proven


def test_statement_names_what_is_proven_and_what_is_not(controller):
    text = certify(controller).statement
    for part in ("rigid arm in continuous time", "exp(-20 t)", "rad/(N m)", "z2, z4, z5"):
        assert part in text
    for part in ("elastic joints", "sampling", "torque limits", "leaves the box"):
        assert part in text.split("Not covered:")[1]
