"""What a learned policy sees and does, as data: the part of a bundle that says so, and nothing that computes."""

from __future__ import annotations

import dataclasses
import math
import numbers

JOINTS = 2
MOST_REMEMBERED = 100  # errors or actions


@dataclasses.dataclass(frozen=True)
class FeatureDefinition:
    """Which features there are, and their scales; stated in every bundle.

    Attributes:
        past_errors: n, how many past errors are remembered, 0 to 100.
        past_actions: m, how many past actions, 0 to 100.
        integral_time: τ, time constant of the leak [s]; 0: no integral.
        error_scale: E [rad].
        rate_scale: V [rad/s].
        velocity_scale: D [rad/s].
        acceleration_scale: A [rad/s²].
        integral_scale: X [rad s].

    Raises:
        ValueError: a number is out of range.
    """

    past_errors: int = 2
    past_actions: int = 2
    integral_time: float = 0.1
    error_scale: float = 1e-3
    rate_scale: float = 0.02
    velocity_scale: float = 5.0
    acceleration_scale: float = 50.0
    integral_scale: float = 1e-4

    def __post_init__(self) -> None:
        """Check every number."""
        for name in ("past_errors", "past_actions"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST_REMEMBERED:
                raise ValueError(f"{name} = {value!r} is out of range; allowed: 0, 1, ..., {MOST_REMEMBERED}")
        if not (is_finite(self.integral_time) and self.integral_time >= 0.0):
            raise ValueError(f"integral_time = {self.integral_time!r} s is out of range; allowed: [0, inf) s, 0: none")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name.endswith("_scale") and not (is_finite(value) and value > 0.0):
                raise ValueError(f"{field.name} = {value!r} is out of range; allowed: (0, inf)")

    @property
    def size(self) -> int:
        """Number of features."""
        return JOINTS * (5 + self.past_errors + self.past_actions + (self.integral_time > 0.0))

    @property
    def memory_size(self) -> int:
        """Numbers to remember: past errors, past actions, integral."""
        return JOINTS * (self.past_errors + self.past_actions + 1)


@dataclasses.dataclass(frozen=True)
class ActionDefinition:
    """What an action a in [-1, 1]² means: the torque u = `torque_scale` · a, held for `period`, plus that of a base.

    Attributes:
        torque_scale: torque of motors 1 and 2 at a = 1 [N m].
        period: time between two actions [s].
        base: name of the policy whose torque is added at every control step, as `fuzzyarm.load_policy` knows it; None:
            no base.

    Raises:
        ValueError: a number is out of range.
    """

    torque_scale: tuple[float, float] = (400.0, 180.0)
    period: float = 2e-3
    base: str | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        scale = self.torque_scale
        if not (isinstance(scale, tuple) and len(scale) == 2 and all(is_finite(x) and x > 0.0 for x in scale)):
            raise ValueError(f"torque_scale = {scale!r} N m is out of range; allowed: two numbers in (0, inf) N m")
        if not (is_finite(self.period) and self.period > 0.0):
            raise ValueError(f"action period = {self.period!r} s is out of range; allowed: (0, inf) s")
        if not (self.base is None or (isinstance(self.base, str) and self.base)):
            raise ValueError(f"base = {self.base!r} must be the name of a policy, or None")

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
