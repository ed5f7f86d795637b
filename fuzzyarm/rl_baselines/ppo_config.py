"""The configuration of a PPO training: one dataclass that is its own command line, and the presets.

Every field carries its help, unit and range; the flags, their help and all checks are made from that.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import numbers
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fuzzyarm.learned_policy.definition import LARGEST_SHIFT, MOST_REMEMBERED, ActionDefinition, FeatureDefinition

DISTRIBUTIONS = ("nominal", "robust")


def _field(
    default: Any,
    text: str,
    *,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    above: bool = False,
    choices: tuple[str, ...] = (),
) -> Any:
    """Return a field with its help, unit and range [low, high], or (low, high] if it must be above."""
    metadata = {"help": text, "unit": unit, "low": low, "high": high, "above": above, "choices": choices}
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class PPOConfig:
    """What is trained on what, and how; see each field's help.

    Raises:
        ValueError: a value is of the wrong type or out of range; the message is one line with the flag's name.
    """

    # The task
    distribution: str = _field(
        "nominal",
        "what episodes are drawn from: nominal is Case 1 on the paper's circle; robust draws plant, payload 0-5 kg, "
        "tip force 0-218 N, start and reference",
        choices=DISTRIBUTIONS,
    )
    references: int = _field(
        256, "in robust, how many circles, lemniscates and lines episodes are drawn from", low=1, high=100_000
    )
    circles: int = _field(
        64, "in robust, how often the paper's circle stands beside these references", low=0, high=100_000
    )
    base: str = _field("none", "policy whose target the action shifts, such as fuzzy-4-tip; none: actions are torques")
    scale: tuple[float, float] = _field(
        (400.0, 180.0),
        "of the action: torques of motors 1 and 2 [N m], or with a base angles [rad], of 0.5 at most",
        low=0.0,
        above=True,
    )
    action_period: float = _field(
        0.002, "time an action is held; the control period of the training", unit="s", low=0.0, high=0.1, above=True
    )
    smoothing_time: float = _field(0.0, "time constant of the low-pass on actions; 0: none", unit="s", low=0.0)
    tip_error_scale: float = _field(
        0.3,
        "of the training's reward, which falls with ln(1 + tip error / scale); 0: the environment's own reward",
        unit="mm",
        low=0.0,
    )
    # What the policy sees and is
    past_errors: int = _field(2, "past errors among the features", low=0, high=MOST_REMEMBERED)
    past_actions: int = _field(2, "past actions among the features", low=0, high=MOST_REMEMBERED)
    integral_time: float = _field(0.1, "time constant of the leaky integral; 0: none", unit="s", low=0.0)
    elastic_target: bool = _field(
        False, "errors count from where the motors of the unloaded arm belong, and past excess torques are seen"
    )
    hidden: tuple[int, ...] = _field((64, 64), "widths of the hidden layers", low=1, high=1024)
    # The training
    steps: int = _field(8_000_000, "environment steps, of all lanes together", low=1)
    lanes: int = _field(64, "arms that are trained on at once", low=1, high=65536)
    rollout: int = _field(64, "steps of each lane between two updates", low=2)
    batch_size: int = _field(1024, "samples in a gradient step; must divide lanes times rollout", low=2)
    epochs: int = _field(8, "passes over a rollout", low=1)
    learning_rate: float = _field(1e-3, "of Adam, at the beginning", low=0.0, above=True)
    final_learning_rate: float = _field(1e-5, "of Adam, at the end; linear in between", low=0.0)
    gamma: float = _field(0.98, "discount of a step", low=0.0, high=1.0)
    gae_lambda: float = _field(0.95, "of the advantage estimate", low=0.0, high=1.0)
    clip_range: float = _field(0.2, "of the ratio of probabilities", low=0.0, above=True)
    entropy_weight: float = _field(0.0, "of the entropy in the loss", low=0.0)
    value_weight: float = _field(0.5, "of the value error in the loss", low=0.0)
    max_gradient: float = _field(0.5, "largest norm of a gradient", low=0.0, above=True)
    target_kl: float = _field(0.0, "an update ends early beyond 1.5 times this divergence; 0: never", low=0.0)
    initial_log_std: float = _field(-1.5, "logarithm of the action's first standard deviation", low=-20.0, high=2.0)
    # The run
    seed: int = _field(0, "of everything that is random", low=0, high=2**31 - 1)
    threads: int = _field(1, "threads of torch and of the environment", low=1, high=1024)
    evaluation_interval: int = _field(
        250_000, "environment steps from one evaluation on the three cases to the next", low=1
    )
    checkpoint_interval: int = _field(500_000, "environment steps from one checkpoint to the next", low=1)
    tensorboard: bool = _field(True, "write TensorBoard logs too, if tensorboard is installed (it is no dependency)")

    def __post_init__(self) -> None:
        """Check types, ranges and what must fit together."""
        for field in dataclasses.fields(self):
            _check(field, getattr(self, field.name))
        if self.lanes * self.rollout % self.batch_size:
            raise ValueError(
                f"--batch-size {self.batch_size} must divide --lanes times --rollout = {self.lanes * self.rollout}"
            )
        if self.base != "none" and max(self.scale) > LARGEST_SHIFT:
            raise ValueError(
                f"--scale {self.scale[0]:g} {self.scale[1]:g} is out of range; allowed with a --base: (0, "
                f"{LARGEST_SHIFT:g}] rad"
            )
        if self.final_learning_rate > self.learning_rate:
            raise ValueError(
                f"--final-learning-rate {self.final_learning_rate:g} is out of range; allowed: [0, --learning-rate = "
                f"{self.learning_rate:g}]"
            )

    @property
    def features(self) -> FeatureDefinition:
        """What the policy sees."""
        return FeatureDefinition(
            past_errors=self.past_errors,
            past_actions=self.past_actions,
            integral_time=self.integral_time,
            elastic_target=self.elastic_target,
        )

    @property
    def action(self) -> ActionDefinition:
        """What the policy's action means."""
        base = None if self.base == "none" else self.base
        return ActionDefinition(
            scale=self.scale, period=self.action_period, base=base, smoothing_time=self.smoothing_time
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fields, ready for JSON."""
        return {
            name: list(value) if isinstance(value, tuple) else value for name, value in dataclasses.asdict(self).items()
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PPOConfig:
        """Return what `to_dict` was called on; ValueError if a field is missing, unknown or out of range."""
        names = {field.name for field in dataclasses.fields(cls)}
        if set(values) != names:
            raise ValueError(f"the configuration misses or adds: {', '.join(sorted(set(values) ^ names))}")
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return cls(**given)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Give a parser ``--preset`` and one flag per field; their texts are parsed by `chosen_config`."""
    parser.add_argument(
        "--preset", metavar="NAME", help=f"what the other flags start from: {', '.join(PRESETS)} (default: nominal)"
    )
    types = typing.get_type_hints(PPOConfig)
    for field in dataclasses.fields(PPOConfig):
        flag, text = _flag(field.name), _help(field)
        if types[field.name] is bool:
            parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
        elif field.name == "hidden":
            parser.add_argument(flag, nargs="*", metavar="N", help=text)
        elif isinstance(field.default, tuple):
            parser.add_argument(flag, nargs=len(field.default), metavar="X", help=text)
        else:
            parser.add_argument(flag, metavar="N" if types[field.name] is int else "X", help=text)


def chosen_config(options: argparse.Namespace) -> PPOConfig:
    """Return the preset with the flags that were given.

    Raises:
        ValueError: a value is no number, unknown or out of range, in one line.
    """
    preset = options.preset or "nominal"
    if preset not in PRESETS:
        raise ValueError(f"--preset {preset} is unknown; choose from: {', '.join(PRESETS)}")
    return dataclasses.replace(PRESETS[preset], **given_values(options))


def add_run_flags(parser: argparse.ArgumentParser) -> None:
    """Give a parser the flags of a run: those of the configuration, its folder, and whether it goes on."""
    parser.usage = "%(prog)s [--preset NAME] [--FLAG VALUE ...] --out DIR, or %(prog)s --resume --out DIR"
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the run, made if needed")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on from the last checkpoint in --out, as it was configured; the result is that of a run never stopped",
    )
    add_flags(parser)


def chosen_run(options: argparse.Namespace) -> tuple[PPOConfig | None, Path]:
    """Return the configuration, None to resume, and the folder; ValueError in one line if they cannot be."""
    if not options.resume:
        return chosen_config(options), options.out
    given = [_flag(name) for name in ("preset", *given_values(options)) if getattr(options, name) is not None]
    if given:
        raise ValueError(f"--resume goes on as the run was configured; leave out {', '.join(given)}")
    return None, options.out


def given_values(options: argparse.Namespace) -> dict[str, Any]:
    """Return the values of the flags that were given, by field; ValueError if one cannot be read."""
    values = {}
    for field in dataclasses.fields(PPOConfig):
        text = getattr(options, field.name)
        if text is not None:
            values[field.name] = _parsed(field, text)
    return values


def _parsed(field: dataclasses.Field[Any], text: Any) -> Any:
    """Return the value that a flag's text, or list of texts, stands for."""
    if isinstance(text, bool) or isinstance(field.default, str):
        return text
    sample = field.default[0] if isinstance(field.default, tuple) else field.default
    texts = text if isinstance(text, list) else [text]
    try:
        # 4e6 and 4_000_000 are whole numbers too.
        values = tuple(_whole(one) if isinstance(sample, int) else float(one) for one in texts)
    except (ValueError, OverflowError):
        kind = "a whole number" if isinstance(sample, int) else "a number"
        raise ValueError(f"{_flag(field.name)} {' '.join(texts)} must be {kind}; allowed: {_range(field)}") from None
    return values if isinstance(field.default, tuple) else values[0]


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        value = float(text)
        if not value.is_integer():
            raise
        return int(value)


def _check(field: dataclasses.Field[Any], value: Any) -> None:
    """Raise ValueError unless a value is of its field's type and in range."""
    allowed, name, default = field.metadata, _flag(field.name), field.default
    if allowed["choices"] and value not in allowed["choices"]:
        raise ValueError(f"{name} {value} is unknown; choose from: {', '.join(allowed['choices'])}")
    if isinstance(default, (str, bool)):
        if not isinstance(value, type(default)) or value == "":
            raise ValueError(f"{name} {value!r} must be of type {type(default).__name__}")
        return
    is_pair = isinstance(default, tuple) and field.name != "hidden"
    if isinstance(default, tuple) and not (isinstance(value, tuple) and (len(value) == 2 or not is_pair)):
        raise ValueError(f"{name} {value!r} must be a tuple of numbers")
    sample = default[0] if isinstance(default, tuple) else default
    for one in value if isinstance(default, tuple) else (value,):
        is_number = isinstance(one, int if isinstance(sample, int) else numbers.Real) and not isinstance(one, bool)
        inside = is_number and math.isfinite(one) and allowed["low"] <= one <= allowed["high"]
        if not inside or (allowed["above"] and one == allowed["low"]):
            raise ValueError(f"{name} {one} is out of range; allowed: {_range(field)}")


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _range(field: dataclasses.Field[Any]) -> str:
    allowed = field.metadata
    unit = f" {allowed['unit']}" if allowed["unit"] else ""
    left = "(" if allowed["above"] or allowed["low"] == -math.inf else "["
    right = ")" if allowed["high"] == math.inf else "]"
    return f"{left}{allowed['low']:g}, {allowed['high']:g}{right}{unit}"


def _help(field: dataclasses.Field[Any]) -> str:
    """Return a flag's help: text, unit, range and default."""
    if isinstance(field.default, bool):
        return f"{field.metadata['help']} (default: {'on' if field.default else 'off'})"
    if isinstance(field.default, str):
        return f"{field.metadata['help']} (default: {field.default})"
    values = field.default if isinstance(field.default, tuple) else (field.default,)
    default = " ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
    return f"{field.metadata['help']}; {_range(field)} (default: {default})"


# At the end: making them runs the checks.
ROBUST = PPOConfig(
    distribution="robust",
    hidden=(128, 128),
    steps=12_000_000,
    lanes=256,
    rollout=32,
    batch_size=2048,
    epochs=5,
    evaluation_interval=500_000,
)
PRESETS: dict[str, PPOConfig] = {
    "nominal": PPOConfig(),
    "robust": ROBUST,
    "residual": dataclasses.replace(
        ROBUST,
        base="fuzzy-4-tip",
        scale=(0.01, 0.02),
        smoothing_time=0.06,
        elastic_target=True,
        hidden=(64, 64),
        steps=6_000_000,
        batch_size=1024,
        epochs=10,
    ),
}
