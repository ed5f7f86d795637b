"""The contents of a data set: the level of its policies, the condition they act in, and the number of episodes."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, get_args

from fuzzyarm.common.checks import choice, real, whole

__all__ = ["CONDITIONS", "LEVELS", "VERSION", "Condition", "DatasetConfig"]

VERSION = 0
"""The number at the end of a data set's name, which changes with the contents."""
_Level = Literal["expert", "medium", "mixed"]
"""The quality of the policies."""
Condition = Literal["nominal", "loads"]
"""The arms, loads and paths on which the policies act."""

LEVELS: Mapping[_Level, tuple[str, ...]] = {
    "expert": ("learned-observer",),
    "medium": ("computed-torque",),
    "mixed": ("learned-observer", "computed-torque", "ppo-robust"),
}
"""The policies of each level, in the order of their episodes."""

CONDITIONS: Mapping[Condition, Mapping[str, Any]] = {
    "nominal": {"case": "nominal"},
    "loads": {"case": "machining", "randomisation": "robust"},
}
"""Arguments of ``FuzzyArm-v0``; for "loads", each episode draws plant, payload, force, start and reference."""

_MOST_EPISODES = 2_000  # half a gigabyte in memory while they are written


@dataclasses.dataclass(frozen=True, kw_only=True)
class DatasetConfig:
    """The contents of a data set; the text after each field explains it.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is out of range.
    """

    level: _Level = "expert"
    """Policies: expert (learned-observer), medium (computed-torque) or mixed (both and ppo-robust, a third each)."""
    condition: Condition = "nominal"
    """Arms and paths: nominal (the paper's circle and arm) or loads (plants, payloads, forces, initial states and
    references are drawn at random)."""
    episodes: int = 60
    """Number of episodes, divided evenly among the policies (1 to 2000)."""
    noise: float = 0.02
    """Standard deviation of the noise on the torques, as a share of their limits (0 to 1); without noise, all
    episodes of the nominal condition are the same. The torques in the data set are those with noise."""
    seed: int = 0
    """Episode i draws from seed + i."""

    def __post_init__(self) -> None:
        """Check every value."""
        choice("level", self.level, get_args(_Level))
        choice("condition", self.condition, get_args(Condition))
        whole("episodes", self.episodes, low=len(LEVELS[self.level]), high=_MOST_EPISODES)
        real("noise", self.noise, low=0.0, high=1.0)
        whole("seed", self.seed, high=2**31 - 1)

    @property
    def name(self) -> str:
        """The name of the data set in Minari."""
        return f"fuzzyarm/{self.level}-{self.condition}-v{VERSION}"

    @property
    def shares(self) -> dict[str, int]:
        """Number of episodes by policy."""
        policies = LEVELS[self.level]
        whole_share, rest = divmod(self.episodes, len(policies))
        return {policy: whole_share + (place < rest) for place, policy in enumerate(policies)}
