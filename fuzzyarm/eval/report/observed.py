"""The worst that is observed on the rigid arm, to stand beside the certified bounds of a controller file.

It takes a few seconds a file: the searches and rollouts of ``benchmarks/certified_bounds.py`` with twice its time step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.eval.certified.extremes import decay_rates, disturbed_run, worst_posture
from fuzzyarm.eval.certified.probes import library, worst_torque
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.eval.certified.rigid_rollout import Motion
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.policies.spec import PolicySpec, resolve

__all__ = ["Observed", "observe", "observe_policies"]

STEP = 1e-3  # [s] of the rollouts; the fastest time constant of the shipped loops is about 4e-3 s


@dataclasses.dataclass(frozen=True)
class Observed:
    """The worst that was observed on the rigid arm in continuous time.

    Attributes:
        decay: smallest decay rate -V'/2V of undisturbed rollouts [1/s].
        gain: largest ‖q - q_d‖₂ / ‖w‖₂ of disturbed rollouts from zero error [rad/(N m)].
        probe: name of the disturbance with that largest gain.
    """

    decay: float
    gain: float
    probe: str


def observe(loop: RigidLoop, reference: Reference) -> Observed:
    """Return the slowest decay and the largest gain of rollouts of a loop.

    The decay is that of rollouts from random states and from the state at which V decays slowest. The gain is that
    under a library of torques and the worst torque found by power iteration, along the reference and at the held
    posture of largest frozen gain.
    """
    gain, probe = max(_largest_gain(loop, motion, reference.duration) for motion in (reference, worst_posture(loop)))
    return Observed(decay_rates(loop, STEP).observed, gain, probe)


def observe_policies(
    config: EvaluationConfig, bounds: Mapping[str, Mapping[str, Any] | None]
) -> dict[str, Observed | str]:
    """Return what is observed of every certified policy by its name, or in words why nothing is observed.

    Policies that use the same controller file share its result.

    Args:
        config: of the evaluation.
        bounds: certified bounds by policy, as `evaluate` stored them; None for a policy without a certificate.
    """
    reference = config.reference()
    by_file: dict[str, Observed] = {}
    result: dict[str, Observed | str] = {}
    for spec in map(resolve, config.policies):
        claimed = bounds[spec.label]
        if claimed is None:
            continue
        controller = _controller(spec, claimed, config, reference)
        if isinstance(controller, str):
            result[spec.label] = f"not observed: {controller}"
            continue
        digest = claimed["controller_digest"]
        if digest not in by_file:
            by_file[digest] = observe(RigidLoop(controller), reference)
        result[spec.label] = by_file[digest]
    return result


def _controller(
    spec: PolicySpec, claimed: Mapping[str, Any], config: EvaluationConfig, reference: Reference
) -> Controller | str:
    """Return the controller that the claimed bounds are of, or why it cannot be observed."""
    if claimed["form"] != "consistent":
        return f"the bounds of the {claimed['form']} form are of other quantities"
    try:
        policy = spec.load(config.control_period, config.parameters)
    except (OSError, ValueError):
        return "the controller file is gone or no longer proven"
    certificate = policy.certificate(reference)
    if certificate is None or certificate.bounds != claimed:
        return "the controller file has changed since the evaluation"
    return cast("Controller", certificate.controller)  # as the form says


def _largest_gain(loop: RigidLoop, motion: Motion, duration: float) -> tuple[float, str]:
    """Return the largest gain about a motion [rad/(N m)] and the name of the torque that causes it."""
    probes = library(duration, STEP) | {"worst torque found": worst_torque(loop, motion, duration, step=STEP)}
    run = disturbed_run(loop, motion, probes, duration, STEP)
    # The certificate claims nothing outside the box, so gains count only until a rollout leaves it.
    gains = np.where(run.in_box, run.gain, 0.0).max(axis=0)
    return max(zip(gains.tolist(), probes, strict=True))
