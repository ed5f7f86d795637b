"""The certificate: what it states holds on the arm, and a changed file does not pass."""

import dataclasses
import re

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.proof.certificate import certify


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


def test_the_error_stays_below_the_constant_that_is_stated_and_not_below_one(controller):
    """From an error of position alone the whole norm grows first: without its constant the bound would be false."""
    text = certify(controller).statement
    whole, of_position = (float(re.search(rf"<= (\S+) exp\(-20 t\) \|{x}\(0\)\|", text)[1]) for x in "xe")
    angles = np.linspace(0.0, np.pi, 20)
    errors = np.zeros((6, len(angles)))
    errors[:2] = np.cos(angles), np.sin(angles)
    model, z = controller.model, premises(np.zeros(2), np.zeros(2), controller.model.parameters)
    gain = np.einsum("i,k,ikab->ab", *model.weights(z), controller.gains)
    F, h, largest = np.eye(6, k=-4), 2e-4, np.zeros(2)
    F[:4] = np.linalg.solve(model.E(z), model.A(z) @ np.eye(4, 6) + model.B @ gain)
    for step in range(1, 500):
        errors = errors + h * F @ (errors + 0.5 * h * F @ errors)
        sizes = [np.linalg.norm(errors[:size], axis=0).max() for size in (6, 2)]
        largest = np.maximum(largest, np.multiply(sizes, np.exp(controller.alpha * h * step)))
    assert 10.0 < largest[0] < whole and largest[1] < of_position < 4.0
    root = np.sqrt(np.linalg.cond(controller.P))
    assert root <= whole < 1.001 * root


SCALARS = {"alpha": 2.0, "gamma": 0.3, "fastest_pole": 0.5}


@pytest.mark.parametrize("field", [*SCALARS, "gains", "P", "Q", "X", "tau", "pole_Q", "pole_X", "pole_tau"])
def test_a_changed_value_fails_the_check(controller, field):
    changed = np.array(getattr(controller, field))
    if field in SCALARS:
        changed = float(SCALARS[field] * changed)
    else:
        changed.flat[0] *= -1.0
    claims = certify(dataclasses.replace(controller, **{field: changed})).claims
    failed = {claim.name[:3] for claim in claims if not claim.proven}
    assert failed == {"Phi"} if "pole" in field else failed & {"Psi", "P >"}


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
