"""The fuzzy policy: parallel distributed compensation, (12) of the paper, from a controller file.

    u = K_hv e + H_hv x_I + L_hv r,   r = (q_d, q̇_d, q̈_d),   e = (q_a - q_d, q̇_a - q̇_d).

For a twice differentiable reference the reference model (8) is the identity, x_r = (q_d, q̇_d). In the consistent form
L_ik r = -A_pi (q_d, q̇_d) + E_pk q̈_d, with rows 3 and 4 of A_pi and E_pk, and columns 3 and 4 of E_pk. This cancels
A_ph x_r - E_pv ẋ_r exactly for the kept premises.
"""

import functools
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import JOINTS, Observation
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.elementwise import sinc, sine_cosine
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy
from fuzzyarm.fuzzy_policy.ts_model import ERROR_STATES
from fuzzyarm.numbers.functions import maximum, minimum

__all__ = ["FuzzyPolicy"]


class FuzzyPolicy(LawPolicy):
    """The fuzzy law of a `Controller` as a policy; see the module's docstring."""

    integral_at: int | None = 0

    def __init__(self, controller: Controller, control_period: float = 1e-3) -> None:
        super().__init__(controller.model.parameters, control_period)
        self.controller = controller

    @functools.cached_property
    def control_law(self) -> Law:
        """The fuzzy law; its memory is x_I."""
        model, n_e = self.controller.model, self.controller.gains.shape[-1]
        arm = arm_constants(model.parameters)
        # Without the integral the gain H is zero, so that one law serves both cases.
        gains = np.zeros((*self.controller.gains.shape[:-1], ERROR_STATES))
        gains[..., :n_e] = self.controller.gains
        rules = np.concatenate([gains, self.controller.feedforward_gains], axis=-1)
        low, high = (tuple(map(float, bound)) for bound in model.bounds.T)
        by_rule = tuple(
            tuple(tuple(map(float, joint)) for joint in rule) for rule in rules.reshape(-1, *rules.shape[-2:])
        )
        constants = by_rule, low, high, (arm.c2, arm.c4, arm.c5), self.control_period
        return Law(_law_of(tuple(map(int, model.kept_in_A)), gains.shape[1]), (0.0,) * JOINTS, constants)


@functools.cache
def _law_of(kept_in_A: tuple[int, ...], of_E: int) -> Any:
    """Return the fuzzy law of controllers with the premises `kept_in_A` in A, and `of_E` vertices of E.

    Its constants are the gains [K H | L] of each rule and joint, the bounds of the premises, c2 [kg m²], c4 and c5
    [N m] of (3) in the paper, and T [s].
    """
    blending = {*kept_in_A, *range(of_E - 1)}  # z1 alone blends E

    def fuzzy(x_I: Any, seen: Observation, constants: Any) -> tuple[Any, Any]:
        rules, low, high, of_arm, period = constants
        e = [a - b for a, b in zip(seen.q_motor, seen.q_reference, strict=True)]
        de = [a - b for a, b in zip(seen.dq_motor, seen.dq_reference, strict=True)]
        (q, dq), (c2, c4, c5) = seen[:2], of_arm
        sinc12, (sin2, cos2) = sinc(q.joint1 + q.joint2), sine_cosine(q.joint2)
        gravity = -c4 * sinc(q.joint1) - c5 * sinc12
        premises = cos2, gravity, -c5 * sinc12, c2 * dq.joint2 * sin2, -c2 * dq.joint1 * sin2
        # 0 at the lower bound of a premise, 1 at the upper one, clipped beyond
        omega = {k: minimum(maximum((premises[k] - low[k]) / (high[k] - low[k]), 0.0), 1.0) for k in blending}
        error, wanted = (*e, *de, *x_I), (*seen.q_reference, *seen.dq_reference, *seen.ddq_reference)
        torque = [0.0] * JOINTS
        for number, rule in enumerate(rules):
            i, k = divmod(number, of_E)
            h = 1.0
            for position, premise in enumerate(kept_in_A):
                h = h * (omega[premise] if (i >> position) & 1 else 1.0 - omega[premise])
            h = h * ((omega[0] if k else 1.0 - omega[0]) if of_E > 1 else 1.0)
            for joint, gains in enumerate(rule):
                back, forward = gains[: len(error)], gains[len(error) :]
                for K, x, L, r in zip(back, error, forward, wanted, strict=True):
                    torque[joint] = torque[joint] + h * (K * x + L * r)
        return tuple(x + period * a for x, a in zip(x_I, e, strict=True)), tuple(torque)

    return fuzzy
