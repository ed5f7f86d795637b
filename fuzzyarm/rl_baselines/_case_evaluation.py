"""The tip errors of a policy in the paper's three cases, which run as one batch."""

from typing import Any

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, argument_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["COLUMNS", "evaluate_cases"]

_MEASURES = ("max_mm", "rms_mm", "share")
COLUMNS = tuple(f"{case}_{measure}" for case in PAPER_CASES for measure in _MEASURES)
"""Keys of the result of `evaluate_cases`; a case that is added to the package does not change them."""


def evaluate_cases(policy: Policy, arm: AnyArm | None = None) -> dict[str, float]:
    """Run an episode of each of the paper's cases on the arm's default reference, at the policy's control period.

    Returns:
        By `COLUMNS`: largest and root mean square tip error of each case [mm], and the fraction of the episode that was
        completed, 1 if the reference was followed to its end.
    """
    arm, cases = ArmParameters() if arm is None else arm, list(PAPER_CASES)
    reference: Any = default_reference(arm)
    envs = FuzzyArmVectorEnv(
        len(cases), case=cases, reference=reference, control_period=policy.control_period, threads=1, **argument_of(arm)
    )
    errors, seconds = [], np.zeros(len(cases))
    for step in episodes(envs, policy, envs.reset(seed=0)):
        errors.append(np.where(step.running, step.info["tip_error"], np.nan))
        seconds += policy.control_period * step.running
    recorded = 1e3 * np.array(errors)
    largest, rms = np.nanmax(recorded, axis=0), np.sqrt(np.nanmean(recorded**2, axis=0))
    rows = np.stack([largest, rms, np.minimum(seconds / reference.duration, 1.0).round(9)], axis=1)
    return dict(zip(COLUMNS, rows.ravel().tolist(), strict=True))
