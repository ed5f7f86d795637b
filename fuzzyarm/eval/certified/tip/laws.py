"""The laws that a bound is proven for, on balls: the torque of a sample and its derivatives.

    u_k = law(θ, θ̇, x_I; r_k) + o_k,      x_I,k+1 = x_I,k + T (θ - q_r,k).

r_k and o_k are numbers that depend on the reference alone; they are those that the policy itself computes, in floats.
The law is the policy's own text, run on jets of balls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.observation import JOINTS, MEASURED, REFERENCE, SIZE, START
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.certified.tip.enclosures import Jet, NoBound, largest
from fuzzyarm.fuzzy_policy.law import LawPolicy, seen_by
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.states import INTEGRAL, PLANT_STATES, POSITION, VELOCITY
from fuzzyarm.numbers.functions import like

__all__ = ["INPUTS", "BallLaw", "Sample", "Torque", "asked", "ball_law"]

INPUTS = 3 * JOINTS
"""θ, θ̇ and x_I, the order of the derivatives of a law."""

_DESIRED = slice(START.q_reference, START.ddq_reference)  # (q_d, q̇_d) in an observation


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
        return _Shipped(law, _fuzzy_terms(law))
    if type(law) is ComputedTorquePolicy:
        if not isinstance(law.parameters, ArmParameters):
            raise NoBound(f"there is no bound for a robot of {len(law.parameters)} joints; choose the two-joint arm")
        return _Shipped(law, _computed_torque_terms(law, law.parameters))
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


class _Shipped:
    """The text of a policy's law, run on jets: `control_law.act`, which the environment's loops and the C file run too.

    Args:
        policy: its constants are exact numbers here.
        terms: gives `Torque.terms` [N m] from the sizes of θ, θ̇, ē = (θ - q_r, θ̇ - q̇_r, x_I) and r.
    """

    def __init__(self, policy: LawPolicy, terms: Callable[[np.ndarray, np.ndarray, np.ndarray], float]) -> None:
        self._law, self._terms = policy.control_law, terms

    def torque(self, theta: list[Any], velocity: list[Any], integral: list[Any], sample: Sample) -> Torque:
        """Return the torque; `NoBound` where a membership function leaves [0, 1]."""
        inputs = [Jet.variable(x, i) for i, x in enumerate([*theta, *velocity, *integral])]
        wanted = sample.reference.tolist()
        seen = like(seen_by(JOINTS), iter([*inputs[:PLANT_STATES], *wanted]))
        _, torque = self._law.act(tuple(inputs[INTEGRAL]), seen, self._law.constants, *self._law.tables)
        value = [u.value + float(o) for u, o in zip(torque, sample.offset, strict=True)]
        slopes = [[u.slope(i) for i in range(INPUTS)] for u in torque]
        errors = [x.value - r for x, r in zip(inputs[:PLANT_STATES], wanted, strict=False)]
        measured = np.array([largest(x.value) for x in inputs[:PLANT_STATES]])
        sizes = np.array([largest(x) for x in [*errors, *integral]])
        terms = self._terms(measured, sizes, np.abs(sample.reference))
        return Torque(value, slopes, terms + float(np.abs(sample.offset).max()))


def _fuzzy_terms(policy: FuzzyPolicy) -> Callable[[np.ndarray, np.ndarray, np.ndarray], float]:
    """Return the terms of a fuzzy law: the gains of one rule times what they multiply, in its weight's products."""
    controller, model = policy.controller, policy.controller.model
    back, forward = np.abs(controller.gains), np.abs(controller.feedforward_gains)
    factor = 4.0 * (1 + len(model.kept_in_A) + len(model.kept_in_E))
    return lambda _, errors, wanted: factor * float((back @ errors[: back.shape[-1]] + forward @ wanted).max())


def _computed_torque_terms(
    policy: ComputedTorquePolicy, parameters: ArmParameters
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], float]:
    """Return the terms of computed torque, with every sine and cosine at its largest."""
    arm, omega = arm_constants(parameters), float(policy.bandwidth)
    inertia = 2.0 * (arm.c1 + arm.c2 + arm.motor_inertia1 + arm.motor_inertia2)
    weight, viscous = 2.0 * (abs(arm.c4) + abs(arm.c5)), max(arm.viscous1, arm.viscous2)

    def terms(measured: np.ndarray, errors: np.ndarray, wanted: np.ndarray) -> float:
        e, de, x_I = (float(errors[part].max()) for part in (POSITION, VELOCITY, INTEGRAL))
        speed = float(measured[VELOCITY].max())
        asked = float(wanted.max()) + 3.0 * omega * (de + omega * (e + omega * x_I))
        return float(4.0 * (inertia * asked + 4.0 * arm.c2 * speed**2 + weight + viscous * speed))

    return terms
