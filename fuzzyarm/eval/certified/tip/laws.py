"""The laws that a bound is proven for, on balls: the torque of a sample and its derivatives.

    u_k = law(θ, θ̇, x_I; r_k) + o_k,      x_I,k+1 = x_I,k + T (θ - q_r,k).

r_k and o_k are numbers that depend on the reference alone; they are those that the policy itself computes, in floats.
The laws are those of `fuzzy_policy.laws`, stated again for balls; a test compares them with the policies.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from flint import arb, arb_mat

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.observation import JOINTS, MEASURED, REFERENCE, SIZE, START
from fuzzyarm.envs.physics.dynamics import arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.certified.tip.enclosures import Jet, NoBound, largest
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.states import POSITION, VELOCITY

__all__ = ["INPUTS", "BallLaw", "Sample", "Torque", "asked", "ball_law"]

INPUTS = 3 * JOINTS
"""θ, θ̇ and x_I, the order of the derivatives of a law."""

_DESIRED = slice(START.q_reference, START.ddq_reference)  # (q_d, q̇_d) in an observation
_SINC_SERIES = 0.05  # below this angle the derivative of sin(x)/x comes from its series


class Sample(NamedTuple):
    """What a law is told at a sample: r = (q_r, q̇_r, q̈_r) (6,), and o (2,) [N m], which is added to its torque."""

    reference: np.ndarray
    offset: np.ndarray


class Torque(NamedTuple):
    """A torque of a law on balls.

    Attributes:
        value: u of both motors [N m].
        slopes: derivatives of both by the `INPUTS`.
        terms: no sum of the law, in floats, has terms of a larger total [N m].
    """

    value: list[Any]
    slopes: list[list[Any]]
    terms: float


class BallLaw(Protocol):
    """A law on balls."""

    def torque(self, theta: list[Any], velocity: list[Any], integral: list[Any], sample: Sample) -> Torque:
        """Return the torque; ValueError where the balls leave what the law is defined on."""
        ...


def ball_law(policy: Policy) -> BallLaw:
    """Return the law of a policy on balls; `NoBound` where none is known for its kind, or its arm has other joints."""
    law = policy.law if isinstance(policy, TipPolicy) else policy
    if type(law) is FuzzyPolicy:
        return _FuzzyLaw(law)
    if type(law) is ComputedTorquePolicy:
        if not isinstance(law.parameters, ArmParameters):
            raise NoBound(f"there is no bound for a robot of {len(law.parameters)} joints; choose the two-joint arm")
        return _ComputedTorque(law, law.parameters)
    raise NoBound(
        f"there is no bound for {shown(type(law).__name__)}, whose derivatives on balls are not known; choose a fuzzy "
        "policy or computed torque, with or without the ending -tip, elastic-observer or a learned policy"
    )


def asked(policy: Policy, references: np.ndarray) -> list[Sample]:
    """Return what the law is told at each sample of a schedule's `references` (steps + 1, 6), as the policy has it."""
    if not isinstance(policy, TipPolicy):
        return [Sample(row, np.zeros(JOINTS)) for row in references]
    # The policy's own steps, see `TipPolicy.act`: the target does not depend on what is measured.
    target, law = policy._target, policy.law
    memory, samples = np.zeros((1, policy.memory_size - law.memory_size)), []
    observation, resting = np.zeros((1, SIZE)), np.zeros((1, SIZE))
    feedforward, own = np.empty((1, JOINTS)), np.empty((1, JOINTS))
    for row in references:
        observation[:, REFERENCE] = row
        target.advance(observation, memory, resting[:, REFERENCE], feedforward)
        resting[:, MEASURED] = resting[:, _DESIRED]
        law.act(resting, np.zeros((1, law.memory_size)), own)
        samples.append(Sample(resting[0, REFERENCE].copy(), (feedforward - own)[0]))
    return samples


def _errors(theta: list[Any], velocity: list[Any], integral: list[Any], sample: Sample) -> list[Any]:
    """Return ē = (θ - q_r, θ̇ - q̇_r, x_I)."""
    q, dq = sample.reference[POSITION].tolist(), sample.reference[VELOCITY].tolist()
    return [
        *(a - b for a, b in zip(theta, q, strict=True)),
        *(a - b for a, b in zip(velocity, dq, strict=True)),
        *integral,
    ]


class _FuzzyLaw:
    """u = Σ h_i v_k (K̄_ik ē + L_ik r), the membership functions with their derivatives; see `laws.fuzzy`."""

    def __init__(self, policy: FuzzyPolicy) -> None:
        controller, model = policy.controller, policy.controller.model
        self._arm = arm_constants(model.parameters)
        gains = np.zeros((*controller.gains.shape[:-1], INPUTS))
        gains[..., : controller.gains.shape[-1]] = controller.gains
        # Rules in the order of the weights: the premises of A, the first fastest, then that of E.
        flat = np.swapaxes(gains, 0, 1).reshape(-1, INPUTS)
        feed = np.swapaxes(controller.feedforward_gains, 0, 1).reshape(-1, INPUTS)
        self._gains, self._feed = arb_mat(flat.tolist()), arb_mat(feed.tolist())
        self._rows = [[arb(x) for x in row] for row in flat.tolist()]
        self._sizes = np.abs(flat), np.abs(feed)
        self._kept = [*model.kept_in_A, *model.kept_in_E]
        self._bounds = model.bounds

    def torque(self, theta: list[Any], velocity: list[Any], integral: list[Any], sample: Sample) -> Torque:
        """Return the torque; ValueError where a membership function leaves [0, 1]."""
        errors = _errors(theta, velocity, integral, sample)
        column = arb_mat([[e] for e in errors])
        vertex = (self._gains * column + self._feed * arb_mat([[x] for x in sample.reference.tolist()])).entries()
        weights = self._weights([*theta, *velocity])
        value, slopes = [], []
        for joint in range(JOINTS):
            own = vertex[joint::JOINTS]
            # The weights sum to one: any number may be taken off the torques of all rules.
            common = own[0].mid()
            total = sum((w.value * (u - common) for w, u in zip(weights, own, strict=True)), arb(0)) + common
            value.append(total + float(sample.offset[joint]))
            rows = self._rows[joint::JOINTS]
            row = [
                sum((w.value * gain[i] for w, gain in zip(weights, rows, strict=True)), arb(0)) for i in range(INPUTS)
            ]
            for i in range(2 * JOINTS):
                row[i] += sum(
                    (w.slopes[i] * (u - common) for w, u in zip(weights, own, strict=True) if i in w.slopes), arb(0)
                )
            slopes.append(row)
        back, forward = self._sizes
        sizes = back @ [largest(e) for e in errors] + forward @ np.abs(sample.reference)
        return Torque(
            value, slopes, 4.0 * float(sizes.max()) * (1 + len(self._kept)) + float(np.abs(sample.offset).max())
        )

    def _weights(self, measured: list[Any]) -> list[Jet]:
        """Return the weight of each rule."""
        q1, q2, dq1, dq2 = (Jet.variable(x, i) for i, x in enumerate(measured))
        arm = self._arm
        sinc12, sin2 = _sinc(q1 + q2), q2.sin()
        premises = (
            q2.cos(), _sinc(q1) * -arm.c4 - sinc12 * arm.c5, sinc12 * -arm.c5, dq2 * sin2 * arm.c2, dq1 * sin2 * -arm.c2
        )  # fmt: skip
        weights = [Jet(arb(1), {})]
        for index in self._kept:
            low, high = (arb(x) for x in self._bounds[index].tolist())
            share = (premises[index] - low) * (1 / (high - low))
            if not (share.value >= 0 and share.value <= 1):
                raise NoBound("a membership function leaves [0, 1]: the arm may leave the box of the T-S model")
            rest = 1 - share
            weights = [*(w * rest for w in weights), *(w * share for w in weights)]
        return weights


def _sinc(angle: Jet) -> Jet:
    """Return sin(x)/x: its derivative is (cos x - sinc x)/x, and -x/3 within |x|³/30 where that is ill-conditioned."""
    x = angle.value
    value = x.sinc()
    size = largest(x)
    if float(x.abs_lower()) > _SINC_SERIES:
        rate = (x.cos() - value) / x
    elif size < 1.0:
        rate = -x / 3 + arb(0, size**3 / 30.0 * 1.001)
    else:
        rate = arb(0, 0.5)  # |sinc'| < 0.437 everywhere
    return Jet(value, {index: slope * rate for index, slope in angle.slopes.items()})


class _ComputedTorque:
    """u = M (q̈_r - 3ω ė - 3ω² e - ω³ x_I) + C q̇ + g + f_v q̇ at the measured motors; see `laws.computed_torque`."""

    def __init__(self, policy: ComputedTorquePolicy, parameters: ArmParameters) -> None:
        self._arm, self._bandwidth = arm_constants(parameters), arb(policy.bandwidth)

    def torque(self, theta: list[Any], velocity: list[Any], integral: list[Any], sample: Sample) -> Torque:
        """Return the torque."""
        arm, omega = self._arm, self._bandwidth
        inputs = [Jet.variable(x, i) for i, x in enumerate([*theta, *velocity, *integral])]
        q1, q2, dq1, dq2, _, _ = inputs
        errors = _errors(inputs[:JOINTS], inputs[JOINTS : 2 * JOINTS], inputs[2 * JOINTS :], sample)
        wanted = []
        for joint, acceleration in enumerate(sample.reference[2 * JOINTS :].tolist()):
            e, de, x = errors[joint::JOINTS]
            wanted.append((de * 3 + (e * 3 + x * omega) * omega) * -omega + acceleration)
        m11, m12, m22 = mass_matrix(q2.cos(), arm)
        coriolis = coriolis_torque(q2.sin(), dq1, dq2, arm)
        gravity = gravity_torque(q1.sin(), (q1 + q2).sin(), arm)
        rigid = (
            (m11 + arm.motor_inertia1) * wanted[0] + m12 * wanted[1],
            m12 * wanted[0] + (m22 + arm.motor_inertia2) * wanted[1],
        )
        viscous = (dq1 * arm.viscous1, dq2 * arm.viscous2)
        total = [a + b + c + d for a, b, c, d in zip(rigid, coriolis, gravity, viscous, strict=True)]
        value = [u.value + float(o) for u, o in zip(total, sample.offset, strict=True)]
        slopes = [[u.slope(i) for i in range(INPUTS)] for u in total]
        inertia = 2.0 * float(arm.c1 + arm.c2 + arm.motor_inertia1 + arm.motor_inertia2)
        sizes = [largest(e.value) for e in errors]
        feedback = [float(omega) ** power * 3.0 * max(sizes[i], sizes[i + 1]) for power, i in ((2, 0), (1, 2), (3, 4))]
        others = sum(largest(x.value) for x in (*coriolis, *gravity, *viscous))
        terms = 4.0 * (inertia * (sum(feedback) + float(np.abs(sample.reference).max())) + others)
        return Torque(value, slopes, terms + float(np.abs(sample.offset).max()))
