"""What a learned policy sees and does, as data: the part of a bundle that says so, and nothing that computes."""

from __future__ import annotations

import dataclasses
import math
import numbers

JOINTS = 2
MOST_REMEMBERED = 100  # errors or actions
LARGEST_SHIFT = 0.5  # rad


@dataclasses.dataclass(frozen=True)
class FeatureDefinition:
    """Which features there are, and their scales; stated in every bundle.

    Attributes:
        past_errors: n, how many past errors are remembered, 0 to 100.
        past_actions: m, how many past actions, 0 to 100.
        integral_time: τ, time constant of the leak [s]; 0: no integral.
        elastic_target: whether errors count from θ_d in place of q_d, and the past excess torques are seen, as many as
            past actions.
        error_scale: E [rad].
        rate_scale: V [rad/s].
        velocity_scale: D [rad/s].
        acceleration_scale: A [rad/s²].
        integral_scale: X [rad s].
        excess_scale: U [N m].

    Raises:
        ValueError: a number is out of range.
    """

    past_errors: int = 2
    past_actions: int = 2
    integral_time: float = 0.1
    elastic_target: bool = False
    error_scale: float = 1e-3
    rate_scale: float = 0.02
    velocity_scale: float = 5.0
    acceleration_scale: float = 50.0
    integral_scale: float = 1e-4
    excess_scale: float = 100.0

    def __post_init__(self) -> None:
        """Check every number."""
        for name in ("past_errors", "past_actions"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST_REMEMBERED:
                raise ValueError(f"{name} = {value!r} is out of range; allowed: 0, 1, ..., {MOST_REMEMBERED}")
        if not (is_finite(self.integral_time) and self.integral_time >= 0.0):
            raise ValueError(f"integral_time = {self.integral_time!r} s is out of range; allowed: [0, inf) s, 0: none")
        if not isinstance(self.elastic_target, bool):
            raise ValueError(f"elastic_target = {self.elastic_target!r} must be true or false")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name.endswith("_scale") and not (is_finite(value) and value > 0.0):
                raise ValueError(f"{field.name} = {value!r} is out of range; allowed: (0, inf)")

    @property
    def size(self) -> int:
        """Number of features."""
        return JOINTS * (5 + self.past_errors + self.past_actions + (self.integral_time > 0.0) + self.past_excesses)

    @property
    def past_excesses(self) -> int:
        """Number of past excess torques."""
        return self.past_actions if self.elastic_target else 0


@dataclasses.dataclass(frozen=True)
class ActionDefinition:
    """What an action a in [-1, 1]² means: the torque u = `scale` · a, or with a base a shift of what the base tracks.

    A base is told that the motors stand at q_a - `scale` · a, so it brings them to its own target plus `scale` · a. A
    torque beside the base's would do no such thing: the base's integral takes it for a load and cancels it.

    Attributes:
        scale: at a = 1, of joints 1 and 2: torques [N m], or with a base angles [rad], of 0.5 rad at most.
        period: time for which an action is held [s]; a base acts at every control step.
        base: name of a policy, as `fuzzyarm.load_policy` knows it; None: no base.
        smoothing_time: τ_b [s]: a_k = λ a_(k-1) + (1 - λ) b_k with λ = exp(-T/τ_b) for what the network says, b_k; 0:
            a_k = b_k.

    Raises:
        ValueError: a number is out of range.
    """

    scale: tuple[float, float] = (400.0, 180.0)
    period: float = 2e-3
    base: str | None = None
    smoothing_time: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        if not (self.base is None or (isinstance(self.base, str) and self.base)):
            raise ValueError(f"base = {self.base!r} must be the name of a policy, or None")
        scale, largest = self.scale, math.inf if self.base is None else LARGEST_SHIFT
        if not (
            isinstance(scale, tuple) and len(scale) == 2 and all(is_finite(x) and 0.0 < x <= largest for x in scale)
        ):
            allowed = "(0, inf) N m" if self.base is None else f"(0, {largest:g}] rad with a base"
            raise ValueError(f"scale = {scale!r} is out of range; allowed: two numbers in {allowed}")
        if not (is_finite(self.period) and self.period > 0.0):
            raise ValueError(f"action period = {self.period!r} s is out of range; allowed: (0, inf) s")
        if not (is_finite(self.smoothing_time) and self.smoothing_time >= 0.0):
            raise ValueError(
                f"smoothing_time = {self.smoothing_time!r} s is out of range; allowed: [0, inf) s, 0: none"
            )

    @property
    def smoothing(self) -> float:
        """The share λ of an action that the next one keeps."""
        return math.exp(-self.period / self.smoothing_time) if self.smoothing_time > 0.0 else 0.0

    def calls(self, control_period: float) -> int:
        """Return for how many control periods [s] an action is held.

        Raises:
            ValueError: the action period is no whole multiple of the control period.
        """
        calls = round(self.period / control_period)
        if calls < 1 or abs(calls * control_period - self.period) > 1e-9 * self.period:
            raise ValueError(
                f"the policy acts every {self.period:g} s, which is no whole multiple of control_period = "
                f"{control_period:g} s; allowed: {self.period:g} s divided by 1, 2, 3, ..."
            )
        return calls


def is_finite(value: object) -> bool:
    """Whether a value is a finite real number, and no boolean."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
