"""What the rigid loop of a controller file is seen to do, to stand beside what its certificate promises.

A few seconds a file: the searches and rollouts of ``benchmarks/certified_bounds.py``, at half its resolution in time.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.certified.frozen import find_worst_point, freeze, gain_at, lyapunov_rate, slowest_error
from fuzzyarm.eval.certified.probes import Uniform, joined, library, worst_torque
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.eval.certified.rigid_rollout import Motion, simulate
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.fuzzy_policy.states import POSITION, VELOCITY
from fuzzyarm.policies import resolve

STEP = 1e-3  # [s] of the rollouts, an order below the fastest time constant of the shipped loops
AMPLITUDE = 100.0  # [N m]
LANES, DECAY_DURATION = 200, 0.2  # undisturbed rollouts at random states, [s]
NOTHING = joined(np.zeros((2, 1, 2)))


@dataclasses.dataclass(frozen=True)
class Observed:
    """The worst seen on the rigid arm in continuous time.

    Attributes:
        decay: slowest rate -V'/2V of undisturbed rollouts [1/s].
        gain: largest ‖q - q_d‖₂ / ‖w‖₂ of disturbed rollouts from zero error [rad/(N m)].
        probe: the disturbance of that largest gain.
    """

    decay: float
    gain: float
    probe: str


def observe(loop: RigidLoop, reference: JointReference) -> Observed:
    """Return the worst seen in rollouts, where a search expects the worst and elsewhere.

    Decay: `LANES` errors at random states of the box, and the error and state at which V decays slowest. Gain: the
    library of torques and the worst torque found by power iteration, along the reference and at the held posture of
    largest frozen gain.
    """
    at_rest = find_worst_point(loop, lambda F, G, omega: gain_at(F, G, 1j * omega), moving=False)
    posture = Uniform(0.98 * at_rest.q[np.newaxis], np.zeros((1, 2)))
    gain, probe = max(_gain(loop, motion, reference.duration) for motion in (reference, posture))
    return Observed(min(_slowest_decay(loop), _random_decay(loop)), gain, probe)


def _slowest_decay(loop: RigidLoop) -> float:
    """Start where V decays slowest in the box, a promille inside it, and along that error."""
    P = loop.controller.P
    slowest = find_worst_point(loop, lambda F, G, omega: -lyapunov_rate(F, P))
    q, dq = 0.999 * slowest.q[np.newaxis], 0.999 * slowest.dq[np.newaxis]
    error = 1e-4 * slowest_error(freeze(loop, q, dq)[0], P)
    run = simulate(loop, Uniform(q - error[:, POSITION], dq - error[:, VELOCITY]), error, NOTHING, 0.01, step=2e-5)
    return float(run.rate.min())


def _random_decay(loop: RigidLoop) -> float:
    P, limits, rng = loop.controller.P, loop.controller.model.parameters, np.random.default_rng(0)
    inner = [rng.uniform(-0.6, 0.6, (LANES, 2)) * limit for limit in (limits.joint_limit, limits.velocity_limit)]
    errors = rng.normal(size=(LANES, loop.states)) @ np.linalg.cholesky(P).T
    errors *= (rng.uniform(0.01, 0.3, LANES) / np.abs(errors[:, POSITION]).max(axis=1))[:, np.newaxis]
    return float(simulate(loop, Uniform(*inner), errors, NOTHING, DECAY_DURATION, step=STEP).rate.min())


def _gain(loop: RigidLoop, motion: Motion, duration: float) -> tuple[float, str]:
    """Return the largest gain about a motion [rad/(N m)] and the torque that has it."""
    probes = library(duration, STEP) | {"worst torque found": worst_torque(loop, motion, duration, step=STEP)}
    torques = AMPLITUDE * np.stack(list(probes.values()), axis=1)
    run = simulate(loop, motion, np.zeros((len(probes), loop.states)), joined(torques, STEP), duration, step=STEP)
    # Beyond the box nothing is claimed: a gain counts up to where a rollout leaves it.
    return max(zip(np.where(run.in_box, run.gain, 0.0).max(axis=0).tolist(), probes, strict=True))


def observe_policies(config: EvaluationConfig, bounds: dict[str, Any]) -> dict[str, Observed | str]:
    """Return what is observed of every certified policy by its name, or in words why there is nothing to observe.

    A controller file stands for all policies that use it.

    Args:
        config: of the evaluation.
        bounds: certified bounds by policy, as `evaluate` stored them; None for a policy without a certificate.
    """
    reference, seen = JointReference(parameters=config.parameters), {}
    result: dict[str, Observed | str] = {}
    for given in config.policies:
        spec = resolve(given)
        name = spec.label
        claimed = bounds[name]
        if claimed is None:
            continue
        if claimed["form"] != "consistent":
            result[name] = f"not observed: the bounds of the {claimed['form']} form are of other quantities"
            continue
        try:
            policy = spec.load(config.control_period, config.parameters)
        except (OSError, ValueError):
            result[name] = "not observed: the controller file is gone or no longer proven"
            continue
        certificate, digest = policy.certificate(reference), claimed["controller_digest"]
        if certificate is None or certificate.bounds != claimed:
            result[name] = "not observed: the controller file has changed since the evaluation"
            continue
        if digest not in seen:
            seen[digest] = observe(RigidLoop(certificate.controller), reference)
        result[name] = seen[digest]
    return result
