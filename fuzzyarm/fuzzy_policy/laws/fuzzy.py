"""The fuzzy policy: parallel distributed compensation (12) of a controller file.

    u = K_hv e + H_hv x_I + L_hv r,   r = (q_d, q̇_d, q̈_d),   e = (q_a - q_d, q̇_a - q̇_d).

For a twice differentiable reference the reference model (8) is the identity, x_r = (q_d, q̇_d). In the consistent form
L_ik r = -A_pi[3:4, :] (q_d, q̇_d) + E_pk[3:4, 3:4] q̈_d, which cancels A_ph x_r - E_pv ẋ_r exactly for the kept premises.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.elementwise import select, sine_cosine
from fuzzyarm.envs.physics.records import (
    BLOCK,
    PerJoint,
    in_block,
    in_columns,
    in_list,
    joint_by_joint,
    places,
    reader,
    record_type,
    size,
    writer,
)
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.fuzzy_policy.blocks import into_block, out_of_block
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw, spread_of
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.proof.policy_certificate import PolicyCertificate, controller_certificate
from fuzzyarm.fuzzy_policy.states import ERROR_STATES
from fuzzyarm.fuzzy_policy.ts_model import PREMISES

__all__ = ["FuzzyPolicy"]


class FuzzyPolicy(Policy):
    """The law of a controller file as a policy; it is in the module's docstring.

    Attributes:
        controller: the content of the file.
    """

    integral_at: int | None = 0

    def __init__(self, controller: Controller, control_period: float = 1e-3) -> None:
        """Lay the controller out for the compiled law, at a control period T [s]."""
        super().__init__(controller.model.parameters, control_period)
        self.controller = controller
        model, n_e = controller.model, controller.gains.shape[-1]
        arm = arm_constants(model.parameters)
        # Without the integral its gain is zero, so that one law serves both.
        gains = np.zeros((*controller.gains.shape[:-1], ERROR_STATES))
        gains[..., :n_e] = controller.gains
        rules = np.concatenate([gains, controller.feedforward_gains], axis=-1)
        self._arguments = (
            rules.reshape(-1, size(Rule)),
            gains.shape[1],
            np.array(model.kept_in_A, dtype=np.int64),
            model.bounds.T.ravel(),
            *(arm.c2, arm.c4, arm.c5),  # not the whole record, which takes as long to hand over as the law itself
            self.control_period,
        )

    def certificate(self, reference: Reference) -> PolicyCertificate:
        """Return what is proven of the controller, which is the same for every reference."""
        return controller_certificate(self.controller)

    def compiled(self) -> CompiledLaw:
        """Return the law for compiled loops."""
        return CompiledLaw("fuzzy", _ACT, self._arguments)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate (12), see `Policy`."""
        _fuzzy_law(observation, memory, torque, *self._arguments)


Wanted = record_type("Wanted", position=PerJoint, velocity=PerJoint, acceleration=PerJoint)
Error = record_type("Error", position=PerJoint, velocity=PerJoint, integral=PerJoint)
Weights = record_type("Weights", **dict.fromkeys(PREMISES, Any))
Bounds = record_type("Bounds", low=Weights, high=Weights)
Gains = record_type("Gains", back=Error, forward=Wanted)
Rule = record_type("Rule", torque1=Gains, torque2=Gains)
Block = record_type(
    "Block", q=PerJoint, dq=PerJoint, wanted=Wanted, x_I=PerJoint, error=Error, weights=Weights, h=Any, torque=PerJoint
)
"""What a block of lanes holds: observation, memory, ē, the weights ω of the premises, a rule's h, torque."""

_AT, _SIZE = places(Block), size(Block) * BLOCK
_H, _OMEGA = _AT.h * BLOCK, _AT.weights.z1 * BLOCK
_read_q, _read_dq, _read_x_I, _read_torque = (
    reader(PerJoint, in_block, at) for at in (_AT.q, _AT.dq, _AT.x_I, _AT.torque)
)
_write_x_I, _write_torque = (writer(PerJoint, in_block, at) for at in (_AT.x_I, _AT.torque))
_read_wanted, _read_error = reader(Wanted, in_block, _AT.wanted), reader(Error, in_block, _AT.error)
_write_error, _write_weights = writer(Error, in_block, _AT.error), writer(Weights, in_block, _AT.weights)
_read_bounds, _read_rule = reader(Bounds, in_list), reader(Rule, in_columns)


@register_jitable(forceinline=True)
def _premises(q: PerJoint, dq: PerJoint, c2: float, c4: float, c5: float) -> Any:
    """Return the premises (6) at the measured motor angles, as `premises` has them."""
    sinc12, (sin2, cos2) = _sinc(q.joint1 + q.joint2), sine_cosine(q.joint2)
    gravity = -c4 * _sinc(q.joint1) - c5 * sinc12
    return Weights(cos2, gravity, -c5 * sinc12, c2 * dq.joint2 * sin2, -c2 * dq.joint1 * sin2)


@register_jitable(forceinline=True)
def _sinc(angle: float) -> float:
    """Return sin(x)/x, 1 at x = 0."""
    ratio: float = select(angle == 0.0, 1.0, sine_cosine(angle)[0] / angle)
    return ratio


@register_jitable(forceinline=True)
def _at_maximum(z: float, low: float, high: float) -> float:
    """Return the weight of the vertex at a premise's maximum."""
    return min(max((z - low) / (high - low), 0.0), 1.0)


@register_jitable(forceinline=True)
def _minus(a: PerJoint, b: PerJoint) -> PerJoint:
    return PerJoint(a.joint1 - b.joint1, a.joint2 - b.joint2)


@register_jitable(forceinline=True)
def _advanced(error: Any, period: float) -> PerJoint:
    """Return x_I one control period later."""
    e, x_I = error.position, error.integral
    return PerJoint(x_I.joint1 + period * e.joint1, x_I.joint2 + period * e.joint2)


@register_jitable
def _blend(block: np.ndarray, lanes: int, kept_in_A: np.ndarray, i: int) -> None:
    """Fill h of vertex i of A."""
    for lane in range(lanes):
        block[_H + lane] = 1.0
    for position in range(len(kept_in_A)):
        omega, at_maximum = _OMEGA + kept_in_A[position] * BLOCK, (i >> position) & 1
        for lane in range(lanes):
            block[_H + lane] *= _weight(block[omega + lane], at_maximum)


@register_jitable(forceinline=True)
def _weight(omega: float, at_maximum: int) -> float:
    """Return ω for a vertex at the premise's maximum, 1 - ω for one at its minimum."""
    return omega if at_maximum else 1.0 - omega


@register_jitable(forceinline=True)
def _added(torque: float, h: float, gains: Any, error: Any, wanted: Any) -> float:
    """Return the torque with h (K ē + L r) added, entry by entry."""
    back, forward = gains
    for part in range(len(back)):
        for joint in range(JOINTS):
            torque += h * (back[part][joint] * error[part][joint] + forward[part][joint] * wanted[part][joint])
    return torque


_weights = joint_by_joint(_at_maximum, Weights, 3)


@kernel
def _fuzzy_law(
    observation: np.ndarray,
    integral: np.ndarray,
    torque: np.ndarray,
    rules: np.ndarray,
    of_E: int,
    kept_in_A: np.ndarray,
    bounds: np.ndarray,
    c2: float,
    c4: float,
    c5: float,
    period: float,
) -> None:
    """Evaluate the law for every lane and advance its integral.

    Args:
        observation: (lanes, 10).
        integral: x_I (lanes, 2) [rad s].
        torque: (lanes, 2), becomes u [N m].
        rules: K̄ = [K H] and L of each rule, (N N_e, numbers of `Rule`).
        of_E: N_e, how many vertices E has.
        kept_in_A: indices of the premises that blend A.
        bounds: of the premises, (numbers of `Bounds`,).
        c2: inertia of (3) [kg m²].
        c4: gravity torque of (3) [N m].
        c5: likewise.
        period: T [s].
    """
    block, limits = np.empty(_SIZE), _read_bounds(bounds, 0)
    for first in range(0, len(observation), BLOCK):
        lanes = min(BLOCK, len(observation) - first)
        into_block(observation, first, lanes, block, _AT.q.joint1)
        into_block(integral, first, lanes, block, _AT.x_I.joint1)
        for lane in range(lanes):
            q, dq, wanted = _read_q(block, lane), _read_dq(block, lane), _read_wanted(block, lane)
            error = Error(_minus(q, wanted.position), _minus(dq, wanted.velocity), _read_x_I(block, lane))
            _write_error(block, lane, error)
            _write_x_I(block, lane, _advanced(error, period))
            _write_weights(block, lane, _weights(_premises(q, dq, c2, c4, c5), limits.low, limits.high))
            _write_torque(block, lane, PerJoint(0.0, 0.0))
        for number in range(len(rules)):
            i, k, rule = number // of_E, number % of_E, _read_rule(rules, number)
            if k == 0:
                _blend(block, lanes, kept_in_A, i)
            for lane in range(lanes):
                h = block[_H + lane] * (_weight(block[_OMEGA + lane], k) if of_E > 1 else 1.0)  # z1 alone blends E
                error, wanted, before = _read_error(block, lane), _read_wanted(block, lane), _read_torque(block, lane)
                torque1 = _added(before.joint1, h, rule.torque1, error, wanted)
                _write_torque(block, lane, PerJoint(torque1, _added(before.joint2, h, rule.torque2, error, wanted)))
        out_of_block(block, _AT.x_I.joint1, integral, first, lanes)
        out_of_block(block, _AT.torque.joint1, torque, first, lanes)


_ACT = spread_of(_fuzzy_law)
