"""The settings of the training of `learned-observer`; the command line is made from them."""

from __future__ import annotations

import dataclasses

from fuzzyarm.common.checks import real, whole
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import LARGEST_MEMORY

__all__ = ["SEGMENT", "EstimateConfig"]

SEGMENT = 50
"""Control periods between two instants at which the memory of the network is kept, where a window may begin."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EstimateConfig:
    """What is trained for how long; the text after each field says what it is.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is out of range.
    """

    seed: int = 0
    """Seed of everything that is random."""
    hidden: int = 32
    """Numbers that the network remembers (1 to 512)."""
    modulation: int = 16
    """Numbers by which the context weighs them (1 to 512)."""
    chunks: int = 200
    """Chunks of experience, each of which is learned from before the next."""
    lanes: int = 160
    """Number of arms that are simulated at once (1 to 65536)."""
    steps: int = 100
    """Control periods of a chunk, a multiple of 50."""
    window: int = 100
    """Control periods of a sequence that is learned from, a multiple of 50, at most those of a chunk."""
    updates: int = 10
    """Gradient steps after each chunk."""
    replay: int = 8
    """Number of latest chunks that are learned from."""
    learning_rate: float = 3e-3
    """Learning rate of Adam at the beginning; it falls to 1e-5 as a cosine."""
    redraw: int = 6
    """Chunks after which plants, loads and courses are drawn again."""

    def __post_init__(self) -> None:
        """Check types and ranges, and what must fit together."""
        whole("seed", self.seed, high=2**31 - 1)
        most = {"hidden": LARGEST_MEMORY, "modulation": LARGEST_MEMORY, "lanes": 65_536, "replay": 1000}
        most |= dict.fromkeys(("chunks", "redraw"), 1_000_000) | dict.fromkeys(("steps", "window", "updates"), 10_000)
        for name, high in most.items():
            whole(name, getattr(self, name), low=1, high=high)
        real("learning_rate", self.learning_rate, above=0.0)
        if self.steps % SEGMENT or self.window % SEGMENT or self.window > self.steps:
            raise ValueError(
                f"steps = {self.steps} and window = {self.window}: both must be multiples of {SEGMENT}, the "
                "window at most the steps"
            )
