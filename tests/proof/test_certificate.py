"""The certificate: the inequality means what it says, and a changed file does not pass."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.proof.certificate import certify
from fuzzyarm.synthesis import Specification, design


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


@pytest.fixture(scope="module")
def limited():
    """Return a controller that claims a bound of its fastest pole, too."""
    return design(Specification(gamma=1.2e-4, fastest_pole=180.0)).controller


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


@pytest.mark.slow
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
        for _ in range(2):
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
    h = 2e-4
    e = np.linalg.cholesky(controller.P) @ rng.normal(size=6)
    energy = [e @ np.linalg.solve(controller.P, e)]
    for step in range(1000):
        phase = 40.0 * h * step
        q, dq = np.array([3.0 * np.sin(phase), 3.0 * np.cos(0.7 * phase)]), 14.0 * np.array([np.cos(phase), -1.0])
        F, _ = closed_loop(controller, q, dq)
        middle = e + 0.5 * h * F @ e
        e = e + h * F @ middle
        energy.append(e @ np.linalg.solve(controller.P, e))
    time = h * np.arange(len(energy))
    assert np.all(np.array(energy) <= energy[0] * np.exp(-2.0 * controller.alpha * time) * (1.0 + 1e-9))


def test_the_error_stays_below_the_constant_that_is_stated_and_not_below_one(controller):
    """From an error of position alone the whole norm grows first: without its constant the bound would be false."""
    text = certify(controller).statement
    whole, of_position = (float(re.search(rf"<= (\S+) exp\(-20 t\) \|{x}\(0\)\|", text)[1]) for x in "xe")
    angles = np.linspace(0.0, np.pi, 20)
    errors = np.zeros((6, len(angles)))
    errors[:2] = np.cos(angles), np.sin(angles)
    F, h = closed_loop(controller, np.zeros(2), np.zeros(2))[0], 2e-4
    largest = np.zeros(2)
    for step in range(1, 500):
        errors = errors + h * F @ (errors + 0.5 * h * F @ errors)
        sizes = [np.linalg.norm(errors[:size], axis=0).max() for size in (6, 2)]
        largest = np.maximum(largest, np.multiply(sizes, np.exp(controller.alpha * h * step)))
    assert 10.0 < largest[0] < whole and largest[1] < of_position < 4.0
    root = np.sqrt(np.linalg.cond(controller.P))
    assert root <= whole < 1.001 * root


def test_shipped_controller_holds_with_room(controller):
    certificate = certify(controller)
    assert certificate.proven
    assert certificate.proof_margin > 1e-6
    N, N_e = 2, 2
    families = 1 if controller.fastest_pole is None else 2
    assert len(certificate.claims) == 1 + families * N_e * N * (N + 1) // 2


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


# The fastest pole ----------------------------------------------------------------------------------------------------


def growth_backwards(controller, beta):
    """Return the largest -V'/2V - β over all errors at random states of the box, its corners included."""
    p, rng, largest = controller.model.parameters, np.random.default_rng(5), -np.inf
    root = np.linalg.cholesky(controller.P)
    for _ in range(500):
        corner = rng.uniform(-1, 1, (2, 2)) if rng.random() < 0.5 else rng.choice([-1.0, 0.0, 1.0], (2, 2))
        F, _ = closed_loop(controller, corner[0] * p.joint_limit, corner[1] * p.velocity_limit)
        scaled = np.linalg.solve(root, F @ root)  # of the error in units in which V is its square
        largest = max(largest, -np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] - beta)
    return largest


def test_V_falls_no_faster_than_certified_on_the_nonlinear_rigid_arm(limited):
    assert growth_backwards(limited, limited.fastest_pole) < 0.0


def test_a_slower_fastest_pole_than_certified_is_refuted(limited):
    """The test above can fail, and the certificate fails with it: in Φ alone."""
    slower = dataclasses.replace(limited, fastest_pole=0.5 * limited.fastest_pole)
    assert growth_backwards(limited, slower.fastest_pole) > 0.0
    claims = certify(slower).claims
    assert {claim.name[:3] for claim in claims if not claim.proven} == {"Phi"}


def test_the_error_falls_no_faster_than_certified_along_a_swing_through_the_box(limited):
    rng, h = np.random.default_rng(6), 1e-4
    errors = np.linalg.cholesky(limited.P) @ rng.normal(size=(6, 50))
    energy = [np.sum(errors * np.linalg.solve(limited.P, errors), axis=0)]
    for step in range(500):
        phase = 40.0 * h * step
        q, dq = np.array([3.0 * np.sin(phase), 3.0 * np.cos(0.7 * phase)]), 14.0 * np.array([np.cos(phase), -1.0])
        F, _ = closed_loop(limited, q, dq)
        errors = errors + h * F @ (errors + 0.5 * h * F @ errors)
        energy.append(np.sum(errors * np.linalg.solve(limited.P, errors), axis=0))
    ratio = np.diff(np.log(energy), axis=0) / (2.0 * h)
    assert -limited.fastest_pole < ratio.min() < ratio.max() < -limited.alpha


def test_every_inequality_of_both_claims_is_proven(limited):
    certificate = certify(limited)
    assert certificate.proven and certificate.proof_margin > 1e-6
    names = [claim.name for claim in certificate.claims]
    assert names[0] == "P > 0" and len(set(names)) == len(names)
    assert [name.replace("Phi", "Psi") for name in names[7:]] == names[1:7]
    assert "root of V = x'P^-1 x decays no faster than exp(-180 t)" in certificate.statement
    assert "between -180 and -20 1/s" in certificate.statement


def test_gains_raised_out_of_the_region_fail_in_phi_alone(limited):
    """Ψ limits no gain: with M - ρ Sᵀ and its own slack moved along it still holds, at any ρ; Φ does not."""
    S = np.eye(6)[:, 2:4]
    largest = max(np.linalg.eigvalsh(E[2:, 2:])[-1] for E in limited.model.E_vertices)
    inverse = np.linalg.inv(limited.P)
    rho = 1e6 / np.abs(inverse[2:4, :2]).max()
    raised = dataclasses.replace(
        limited,
        gains=limited.gains - rho * S.T @ inverse,
        X=limited.X + rho * S @ S.T,
        Q=limited.Q - rho / largest * S @ S.T,
    )
    claims = certify(raised).claims
    assert {claim.name[:3] for claim in claims if not claim.proven} == {"Phi"}
    assert all(claim.proven for claim in claims[:7])
    assert not any(claim.proven for claim in claims[7:])
    assert growth_backwards(raised, limited.fastest_pole) > 0.0


@pytest.mark.parametrize("field", ["pole_Q", "pole_X", "pole_tau"])
def test_changed_slack_of_the_region_fails_in_phi_alone(limited, field):
    changed = np.array(getattr(limited, field))
    changed.flat[0] *= -1.0
    claims = certify(dataclasses.replace(limited, **{field: changed})).claims
    failed = [claim.name for claim in claims if not claim.proven]
    assert failed and all(name.startswith("Phi") for name in failed)
