"""Extremes of the rigid loop in rollouts, to compare with its certified bounds: slowest decay and largest gain.

The report of an evaluation and ``benchmarks/certified_bounds.py`` use these functions with different time steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fuzzyarm.eval.certified.frozen import find_worst_point, freeze, gain_at, lyapunov_rate, slowest_error
from fuzzyarm.eval.certified.probes import Uniform, joined
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.eval.certified.rigid_rollout import STEP, Motion, Run, simulate
from fuzzyarm.fuzzy_policy.states import POSITION, VELOCITY

__all__ = ["DecayRates", "decay_rates", "disturbed_run", "worst_posture"]

LANES, DECAY_DURATION = 200, 0.2  # number of undisturbed rollouts from random states, and their duration [s]
SLOWEST_DURATION, SLOWEST_STEP = 0.02, 2e-5  # [s], of the rollout from where V decays slowest
AMPLITUDE = 100.0  # [N m], of the largest disturbance torque
_UNDISTURBED = joined(np.zeros((2, 1, 2)))


class DecayRates(NamedTuple):
    """Smallest rates -V'/2V [1/s] without disturbance; the certificate claims that all are at least α.

    Attributes:
        random: of rollouts from random states of the box.
        slowest: of a rollout from the state and error at which V decays slowest.
        in_box: of all states of the box and all errors, found by a search without a rollout.
    """

    random: float
    slowest: float
    in_box: float

    @property
    def observed(self) -> float:
        """Smallest rate of all rollouts."""
        return min(self.random, self.slowest)


def decay_rates(loop: RigidLoop, step: float = STEP) -> DecayRates:
    """Return the smallest decay rates of V; `step` is that of the random rollouts [s]."""
    P = loop.controller.P
    worst = find_worst_point(loop, lambda F, G, omega: -lyapunov_rate(F, P))
    # The rollout starts slightly inside the box, so that it does not leave the box at once.
    q, dq = 0.999 * worst.q[np.newaxis], 0.999 * worst.dq[np.newaxis]
    error = 1e-4 * slowest_error(freeze(loop, q, dq)[0], P)
    motion = Uniform(q - error[:, POSITION], dq - error[:, VELOCITY])
    slowest = simulate(loop, motion, error, _UNDISTURBED, SLOWEST_DURATION, step=SLOWEST_STEP)
    return DecayRates(_random_decay(loop, step), float(slowest.rate.min()), -worst.value)


def worst_posture(loop: RigidLoop) -> Uniform:
    """Return the held posture with the largest frozen gain, slightly inside the box."""
    worst = find_worst_point(loop, lambda F, G, omega: gain_at(F, G, 1j * omega), moving=False)
    return Uniform(0.98 * worst.q[np.newaxis], np.zeros((1, 2)))


def disturbed_run(
    loop: RigidLoop, motion: Motion, probes: Mapping[str, np.ndarray], duration: float, step: float = STEP
) -> Run:
    """Return the rollouts from zero error under disturbance torques, one lane for each probe.

    Args:
        loop: arm and controller.
        motion: the reference.
        probes: torques (k, 2) by name, of size 1, at the instants 0, step, ..., duration; see `probes.library`.
        duration: [s].
        step: of the torques and of the integration [s].
    """
    torques = AMPLITUDE * np.stack(list(probes.values()), axis=1)
    at_rest = np.zeros((len(probes), loop.states))
    return simulate(loop, motion, at_rest, joined(torques, step), duration, step=step)


def _random_decay(loop: RigidLoop, step: float) -> float:
    """Return the smallest rate of rollouts whose errors are spread like the ellipsoid V = 1 and then scaled."""
    P, arm, rng = loop.controller.P, loop.controller.model.parameters, np.random.default_rng(0)
    q, dq = (rng.uniform(-0.6, 0.6, (LANES, 2)) * limit for limit in (arm.joint_limit, arm.velocity_limit))
    errors = rng.normal(size=(LANES, loop.states)) @ np.linalg.cholesky(P).T
    largest_angle = rng.uniform(0.01, 0.3, LANES)  # [rad]
    errors *= (largest_angle / np.abs(errors[:, POSITION]).max(axis=1))[:, np.newaxis]
    return float(simulate(loop, Uniform(q, dq), errors, _UNDISTURBED, DECAY_DURATION, step=step).rate.min())
