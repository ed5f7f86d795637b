"""The sheet of a fuzzy law: premises, memberships, vertices and gains of a controller file."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.export.sheet import Quantity
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.states import INTEGRAL, PLANT
from fuzzyarm.fuzzy_policy.ts_model import PREMISES

__all__ = ["fuzzy_law"]


def fuzzy_law(controller: Controller) -> tuple[str, tuple[str, ...], tuple[Quantity, ...]]:
    """Return a fuzzy law in words, its equations from the errors to u, and its numbers."""
    model = controller.model
    in_A = ", ".join(PREMISES[index] for index in model.kept_in_A) or "none"
    in_E = ", ".join(PREMISES[index] for index in model.kept_in_E) or "none"
    integral = " + H_ik x_I" if controller.integral else ""
    equations = (
        "r = (q_d, dq_d, ddq_d)",
        "z1 = cos q2,   z2 = -c4 sinc(q1) - c5 sinc(q1 + q2),   z3 = -c5 sinc(q1 + q2)",
        "z4 = c2 dq2 sin q2,   z5 = -c2 dq1 sin q2,   sinc(x) = sin(x)/x, 1 at 0, with the measured q, dq",
        "w_k = min(max((z_k - zmin_k)/(zmax_k - zmin_k), 0), 1)",
        f"h_i = product over the kept premises of A ({in_A}) of w_k (bit of i-1 is 1: maximum) or 1 - w_k (0: minimum)",
        f"v_k likewise for E ({in_E}); the first premise is the lowest bit; an empty product is 1",
        f"u = sum over i, k of h_i v_k (K_ik (e, de){integral} + L_ik r)",
    )
    c = arm_constants(model.parameters)
    gains, low, high = controller.gains, model.bounds[:, 0], model.bounds[:, 1]
    quantities = [
        Quantity("c2, c4, c5", "kg m^2, N m, N m", "of the premises", np.array([c.c2, c.c4, c.c5])),
        Quantity("zmin", "as z", "smallest values of z1 to z5 in the box", low),
        Quantity("zmax", "as z", "largest values", high),
        Quantity("K", "N m/rad (2), N m s/rad (2)", "feedback of (e, de): (i, k, torque, entry)", gains[..., PLANT]),
    ]
    if controller.integral:
        quantities.append(Quantity("H", "N m/(rad s)", "feedback of x_I: (i, k, torque, entry)", gains[..., INTEGRAL]))
    return (
        f"fuzzy law of {model.rules} rules, {controller.form} form",
        equations,
        (
            *quantities,
            Quantity(
                "L",
                "N m/rad (2), N m s/rad (2), kg m^2 (2)",
                "feedforward of r: (i, k, torque, entry)",
                controller.feedforward_gains + 0.0,  # no -0
            ),
            Quantity("A", "SI", "vertices of the model, for information: (i, row, column)", np.array(model.A_vertices)),
            Quantity("E", "SI", "likewise: (k, row, column)", np.array(model.E_vertices)),
        ),
    )
