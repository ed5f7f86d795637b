"""The settings of a training run that do not depend on the algorithm, and those for training `learned-observer`.

The settings of an algorithm are a class derived from `TrainingConfig` with further fields. The command line is
generated from these classes: a field defines the name, type and default of a flag, and the string below the field is
the flag's help.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, Self, get_args

from fuzzyarm.common.checks import choice, instance, real, whole
from fuzzyarm.common.documents import record
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition, learning_features

__all__ = ["SEGMENT", "EstimateConfig", "TrainingConfig"]

_Distribution = Literal["nominal", "robust"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """The settings of a training run with any algorithm; the string below each field explains the field.

    The defaults are those of ``FuzzyArmLearn-v0``, whose reward and early end apply to every training run. TypeError or
    ValueError names the value that is refused and the reason.
    """

    distribution: _Distribution = "robust"
    """What each episode draws: robust draws plant, payload, force, initial state and reference, like FuzzyArmLearn-v0;
    nominal is Case 1 on the paper's circle, or a robot's default path."""
    base: str = "none"
    """Policy whose target the action shifts, such as fuzzy-4-tip; with none, actions are torques."""
    robot: str | None = None
    """Another arm: cicese, manutec-r3, planar-3r, ur5, panda, or the TOML file of a robot or of a two-joint arm."""
    scale: tuple[float, ...] = (500.0, 250.0)
    """Largest action of each motor: a torque [N m], or with a base an angle [rad] of at most 0.5. On the command line,
    the default for a robot with more joints is its torque limits, or 0.01 rad."""
    action_period: float = 0.002
    """Time for which an action is held [s], at most 0.1; it is the control period in training."""
    smoothing_time: float = 0.0
    """Time constant of the low-pass filter on actions [s]; 0: no filter."""
    past_errors: int = 0
    """Number of past errors among the features (0 to 100)."""
    past_actions: int = 0
    """Number of past actions among the features (0 to 100)."""
    integral_time: float = 0.0
    """Time constant of the leaky integral of the error [s]; 0: no integral."""
    elastic_target: bool = False
    """Measure errors from the angles at which the motors of the unloaded arm should be, and add past excess torques to
    the features."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of the network (1 to 1024 each)."""
    total_timesteps: int = 300_000
    """Environment steps of the training run, over all lanes together."""
    lanes: int = 64
    """Number of arms that are simulated at once (1 to 65536)."""
    seed: int = 0
    """Seed of everything that is random."""
    threads: int = 1
    """Threads of torch and of the environment (1 to 1024); networks this small learn fastest on one."""
    evaluation_interval: int = 100_000
    """Environment steps between two evaluations on the paper's three cases."""
    checkpoint_interval: int = 50_000
    """Environment steps between two checkpoints."""

    def __post_init__(self) -> None:
        choice("distribution", self.distribution, get_args(_Distribution))
        real("action_period", self.action_period, "s", above=0.0, high=0.1)
        for width in instance("hidden", self.hidden, tuple):
            whole("hidden", width, low=1, high=1024)
        for name in ("total_timesteps", "evaluation_interval", "checkpoint_interval"):
            whole(name, getattr(self, name), low=1)
        whole("lanes", self.lanes, low=1, high=65_536)
        whole("seed", self.seed, high=2**31 - 1)
        whole("threads", self.threads, low=1, high=1024)
        if self.robot is not None:
            instance("robot", self.robot, str)
        # The definitions of features and action check the other fields.
        _ = self.action, self.features

    @property
    def features(self) -> FeatureDefinition:
        """The definition of the features that the policy observes."""
        same = ("past_errors", "past_actions", "integral_time", "elastic_target")
        registered = learning_features(len(self.scale))
        return dataclasses.replace(registered, **{name: getattr(self, name) for name in same})

    @property
    def action(self) -> ActionDefinition:
        """The definition of the policy's action."""
        base = None if instance("base", self.base, str) == "none" else self.base
        return ActionDefinition(self.scale, self.action_period, base, self.smoothing_time)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields by name, ready for JSON; ``robot`` is left out if it is None."""
        values = {name: list(v) if isinstance(v, tuple) else v for name, v in dataclasses.asdict(self).items()}
        return {name: value for name, value in values.items() if value is not None}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the configuration from `values`, a result of `to_dict`.

        Raises:
            ValueError: a field is missing or unknown, or its value is refused.
        """
        missing = {field.name for field in dataclasses.fields(cls) if field.default is not None} - set(values)
        if missing:
            raise ValueError(f"the configuration lacks: {', '.join(sorted(missing))}")
        return record(dict(values), cls)


SEGMENT = 50
"""Control periods between two stored states of the network's memory; a window begins at such a state."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EstimateConfig:
    """The settings for training `learned-observer`; errors as for `TrainingConfig`."""

    seed: int = 0
    """Seed of everything that is random."""
    hidden: int = 32
    """Numbers in the network's memory (1 to 512)."""
    modulation: int = 16
    """Numbers computed from the context to weight the memory (1 to 512)."""
    chunks: int = 200
    """Number of chunks of experience; the network learns from each before the next."""
    lanes: int = 160
    """Number of arms that are simulated at once (1 to 65536)."""
    steps: int = 100
    """Control periods in a chunk, a multiple of 50."""
    window: int = 100
    """Control periods in a sequence for learning, a multiple of 50, at most as many as in a chunk."""
    updates: int = 10
    """Gradient steps after each chunk."""
    replay: int = 8
    """Number of latest chunks that the network learns from."""
    learning_rate: float = 3e-3
    """Learning rate of Adam at the beginning; it then falls to 1e-5 along a cosine."""
    redraw: int = 6
    """Chunks after which plants, loads and courses are drawn again."""

    def __post_init__(self) -> None:
        from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import LARGEST_MEMORY  # this import loads the compiler

        whole("seed", self.seed, high=2**31 - 1)
        most = {"hidden": LARGEST_MEMORY, "modulation": LARGEST_MEMORY, "lanes": 65_536, "replay": 1000}
        most |= dict.fromkeys(("chunks", "redraw"), 1_000_000) | dict.fromkeys(("steps", "window", "updates"), 10_000)
        for name, high in most.items():
            whole(name, getattr(self, name), low=1, high=high)
        real("learning_rate", self.learning_rate, above=0.0)
        if self.steps % SEGMENT or self.window % SEGMENT or self.window > self.steps:
            raise ValueError(
                f"steps = {self.steps} and window = {self.window}: both must be multiples of {SEGMENT}, and window "
                "must not exceed steps"
            )
