"""FuzzyArm: a two-joint robot arm to track circles with, and controllers that come with a proof.

Importing the package registers ``FuzzyArm-v0`` with Gymnasium and loads no heavy module.
"""

from __future__ import annotations

from importlib.metadata import version

from gymnasium.envs.registration import register

from fuzzyarm.policies import load_policy

__all__ = ["__version__", "load_policy"]
__version__ = version("fuzzyarm")

# The environment itself refuses steps outside an episode and checks actions: Gymnasium's wrappers for that would only
# cost time on every step.
register(
    id="FuzzyArm-v0",
    entry_point="fuzzyarm.envs.fuzzy_arm:FuzzyArmEnv",
    vector_entry_point="fuzzyarm.envs.vector:FuzzyArmVectorEnv",
    order_enforce=False,
    disable_env_checker=True,
)
