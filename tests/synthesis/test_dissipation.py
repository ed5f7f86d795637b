"""Designs on the equations of the arm alone: V' + z'z - γ² w'w + 2αV < 0 at states, premises and the worst inputs."""

import dataclasses
import functools

import numpy as np
import pytest
from slow_twins import slow_but
from support.dissipation import descriptor, excess, premises, premises_at, rates
from support.shipped import CONTROLLERS

from fuzzyarm.envs.physics.dynamics import arm_constants, mass_matrix, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.synthesis import Specification, design

ARM = ArmParameters()
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


FAST = [(1, "consistent"), (4, "shipped"), (4, "paper, free L"), (1, "paper")]
DESIGNS = [
    (rules, form)
    for rules in (1, 2, 4, 8)
    for form in ("shipped", *FORMS)
    if "z1" in NAMED_RULES[rules] or "pole" not in form
]


@pytest.mark.parametrize("which", slow_but(FAST, DESIGNS), ids=str)
def test_v_decays_and_the_disturbance_is_attenuated_as_claimed_and_not_much_more(which):
    """Four times the decay rate, or a tenth of γ, is refuted at some premises: the inequalities are nearly tight."""
    controller = designed(*which)
    assert excess(controller) < 0.0 < excess(dataclasses.replace(controller, gamma=0.1 * controller.gamma))
    if controller.fastest_pole is None:
        assert excess(dataclasses.replace(controller, alpha=4.0 * controller.alpha)) > 0.0
        return
    slowest = min(rates(controller, z)[1] for z in premises(ARM, 150))
    assert -2.0 * controller.fastest_pole < slowest < -4.0 * controller.alpha


def test_the_equations_are_those_of_the_nonlinear_arm():
    """E(z) ẋ - A(z) x is the torque of the plant at any state of the box."""
    rng, constants = np.random.default_rng(3), arm_constants(ARM)
    for _ in range(50):
        q, dq = rng.uniform(-1.0, 1.0, (2, 2)) * [ARM.joint_limit, ARM.velocity_limit]
        ddq, (E, A) = rng.normal(size=2), descriptor(ARM, premises_at(ARM, q, dq))
        m11, m12, m22 = mass_matrix(np.cos(q[1]), constants)
        inertia = np.array([[m11, m12], [m12, m22]]) + np.diag(ARM.motor_inertia)
        passive = rigid_inverse_dynamics(q, dq, np.zeros(2), constants) + np.array(ARM.viscous_friction) * dq
        found = E @ np.r_[dq, ddq] - A @ np.r_[q, dq]
        np.testing.assert_allclose(found, np.r_[0.0, 0.0, inertia @ ddq + passive], rtol=1e-9, atol=1e-9)
