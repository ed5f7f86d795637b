"""The certificate: the inequality means what it says, and a changed file does not pass."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.proof.certificate import certify


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


def dissipation(controller, alpha):
    """Return the largest V' + zᵀz - γ² dᵀd + 2αV of the nonlinear rigid error dynamics, over V, for the worst d."""
    p, rng, largest = controller.model.parameters, np.random.default_rng(1), -np.inf
    root, X, z = np.linalg.cholesky(controller.P), np.linalg.inv(controller.P), np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    box = itertools.product((-1.0, -0.5, 0.0, 0.5, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0), (-1.0, 1.0), (-1.0, 1.0))
    for at in (*map(np.array, box), *rng.uniform(-1.0, 1.0, (200, 4))):
        F, G = closed_loop(controller, at[:2] * p.joint_limit, at[2:] * p.velocity_limit)
        whole = X @ F + F.T @ X + z + 2.0 * alpha * X + X @ G @ G.T @ X / controller.gamma**2
        largest = max(largest, np.linalg.eigvalsh(root.T @ whole @ root)[-1])
    return largest


def test_dissipation_holds_in_the_box_and_a_faster_decay_is_refuted(controller):
    assert dissipation(controller, controller.alpha) < 0.0 < dissipation(controller, 2.0 * controller.alpha)


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


@pytest.mark.parametrize("field", ["gains", "P", "Q", "X", "tau", "alpha", "gamma", "pole_Q", "pole_X", "pole_tau"])
def test_a_changed_value_fails_the_check(controller, field):
    changed = np.array(getattr(controller, field))
    if field in ("alpha", "gamma"):
        changed = float(changed * {"alpha": 2.0, "gamma": 0.3}[field])
    else:
        changed.flat[0] *= -1.0
    claims = certify(dataclasses.replace(controller, **{field: changed})).claims
    failed = {claim.name[:3] for claim in claims if not claim.proven}
    assert failed == {"Phi"} if "pole" in field else failed & {"Psi", "P >"}


# The fastest pole ----------------------------------------------------------------------------------------------------


def fastest(controller):
    """Return the largest -V'/2V over all errors at random states of the box, its corners included."""
    p, rng, largest = controller.model.parameters, np.random.default_rng(5), -np.inf
    root = np.linalg.cholesky(controller.P)
    for _ in range(500):
        corner = rng.uniform(-1, 1, (2, 2)) if rng.random() < 0.5 else rng.choice([-1.0, 0.0, 1.0], (2, 2))
        F, _ = closed_loop(controller, corner[0] * p.joint_limit, corner[1] * p.velocity_limit)
        scaled = np.linalg.solve(root, F @ root)  # of the error in units in which V is its square
        largest = max(largest, -np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
    return largest


def test_a_slower_fastest_pole_than_certified_is_refuted(controller):
    """By the nonlinear rigid arm, and by the certificate: in Φ alone."""
    slower = dataclasses.replace(controller, fastest_pole=0.5 * controller.fastest_pole)
    assert slower.fastest_pole < fastest(controller) < controller.fastest_pole
    claims = certify(slower).claims
    assert {claim.name[:3] for claim in claims if not claim.proven} == {"Phi"}


def test_every_inequality_of_both_claims_is_proven(controller):
    certificate = certify(controller)
    assert certificate.proven and certificate.proof_margin > 1e-6
    names = [claim.name for claim in certificate.claims]
    assert len(names) == 13 and names[0] == "P > 0" and len(set(names)) == len(names)
    assert [name.replace("Phi", "Psi") for name in names[7:]] == names[1:7]
    proven, _, missing = certificate.statement.partition("Not covered:")
    for part in ("rigid arm in continuous time", "exp(-20 t)", "than exp(-200 t)", "between -200 and -20 1/s"):
        assert part in proven
    for part in ("elastic joints", "sampling", "torque limits", "leaves the box"):
        assert part in missing


def test_gains_raised_out_of_the_region_fail_in_phi_alone(controller):
    """Ψ limits no gain: with M - ρ Sᵀ and its own slack moved along it still holds, at any ρ; Φ does not."""
    S = np.eye(6)[:, 2:4]
    largest = max(np.linalg.eigvalsh(E[2:, 2:])[-1] for E in controller.model.E_vertices)
    inverse = np.linalg.inv(controller.P)
    rho = 1e6 / np.abs(inverse[2:4, :2]).max()
    raised = dataclasses.replace(
        controller,
        gains=controller.gains - rho * S.T @ inverse,
        X=controller.X + rho * S @ S.T,
        Q=controller.Q - rho / largest * S @ S.T,
    )
    claims = certify(raised).claims
    assert {claim.name[:3] for claim in claims if not claim.proven} == {"Phi"}
    assert all(claim.proven for claim in claims[:7])
    assert not any(claim.proven for claim in claims[7:])
    assert fastest(raised) > controller.fastest_pole
