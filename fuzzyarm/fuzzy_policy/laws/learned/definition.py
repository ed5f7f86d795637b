"""Data that define the observations and actions of a learned policy, as part of a bundle.

This module loads no policy code, so that the command line reads it quickly.
"""

import dataclasses
import math

from fuzzyarm.common.checks import instance, real, reals, truth, whole
from fuzzyarm.envs.periods import SHORTEST_PERIOD, checked_period

__all__ = ["ActionDefinition", "ArmDefinition", "FeatureDefinition", "learning_features"]

_MOST_JOINTS = 12  # as in `envs.physics.robot`
_LONGEST_MEMORY = 1e6  # s


@dataclasses.dataclass(frozen=True)
class FeatureDefinition:
    """The features and their scales, in the notation of `laws.learned.features`; part of every bundle."""

    past_errors: int = 2  # n, number of past errors, 0 to 100
    past_actions: int = 2  # m, number of past actions, 0 to 100
    integral_time: float = 0.1  # τ, time constant of the leak [s]; 0: no integral
    # whether errors are relative to θ_d instead of q_d, and the features include as many past excess torques as past
    # actions
    elastic_target: bool = False
    error_scale: float = 1e-3  # E [rad]
    rate_scale: float = 0.02  # V [rad/s]
    velocity_scale: float = 5.0  # D [rad/s]
    acceleration_scale: float = 50.0  # A [rad/s²]
    integral_scale: float = 1e-4  # X [rad s]
    excess_scale: float = 100.0  # U [N m]
    joints: int = 2  # number of joints, 1 to 12
    compression: float = 1.0  # c, compression of errors

    def __post_init__(self) -> None:
        whole("past_errors", self.past_errors, high=100)
        whole("past_actions", self.past_actions, high=100)
        real("integral_time", self.integral_time, "s", low=0.0, high=_LONGEST_MEMORY)
        truth("elastic_target", self.elastic_target)
        whole("joints", self.joints, low=1, high=_MOST_JOINTS)
        for field in dataclasses.fields(self):
            if field.name.endswith("_scale") or field.name == "compression":
                real(field.name, getattr(self, field.name), above=0.0)

    @property
    def size(self) -> int:
        """Number of features."""
        past = self.past_errors + self.past_actions + self.past_excesses
        # five current features per joint: e, ė, q_d, q̇_d, q̈_d
        return self.joints * (5 + past + (self.integral_time > 0.0))

    @property
    def past_excesses(self) -> int:
        """Number of past excess torques of each joint in the features."""
        return self.past_actions if self.elastic_target else 0


_COMPRESSION = 3.0  # of the errors: the asinh of the largest error in the box is 9; inputs should be of order 1
_LEAK = 0.1  # s


def learning_features(joints: int, history: int = 0) -> FeatureDefinition:
    """Return the features of ``FuzzyArmLearn-v0``.

    If `history` > 0, the features include error integrals and the last `history` errors and actions.
    """
    return FeatureDefinition(history, history, _LEAK if history else 0.0, joints=joints, compression=_COMPRESSION)


@dataclasses.dataclass(frozen=True)
class ActionDefinition:
    """The meaning of an action a in [-1, 1]ⁿ: the torque u = `scale` · a or, with a `base`, a shift of its target.

    The base, a policy, receives the motor angles minus `scale` · a, and so moves the motors to its target plus
    `scale` · a. A torque added to the base's would have no lasting effect: its integral would cancel it.
    """

    # one value per joint, for a = 1: torques [N m], or with a base angles [rad], 0.5 rad at most
    scale: tuple[float, ...] = (400.0, 180.0)
    period: float = 2e-3  # time for which an action is held [s]; a base acts at every control step
    base: str | None = None  # name of a policy for `fuzzyarm.load_policy`; None: no base
    # τ_b [s] of the low-pass a_k = λ a_(k-1) + (1 - λ) b_k with λ = exp(-T/τ_b), where T is the period and b_k the
    # output of the network; 0: a_k = b_k
    smoothing_time: float = 0.0

    def __post_init__(self) -> None:
        if self.base is not None and not instance("base", self.base, str):
            raise ValueError("base = '' must be the name of a policy, or None")
        unit, largest = ("N m", math.inf) if self.base is None else ("rad", 0.5)
        whole("the number of scales", len(instance("scale", self.scale, tuple)), low=1, high=_MOST_JOINTS)
        reals("scale", self.scale, len(self.scale), unit, above=0.0, high=largest)
        real("period", self.period, "s", low=SHORTEST_PERIOD, high=1.0)
        real("smoothing_time", self.smoothing_time, "s", low=0.0, high=_LONGEST_MEMORY)

    @property
    def smoothing(self) -> float:
        """The λ in the low-pass filter a_k = λ a_(k-1) + (1 - λ) b_k of the network's outputs b_k; 0: no filter."""
        period, time = float(self.period), float(self.smoothing_time)
        return math.exp(-period / time) if time > 0.0 else 0.0

    def calls(self, control_period: float) -> int:
        """Return for how many periods of `control_period` [s] an action is held; ValueError if not a whole number."""
        checked_period("control_period", control_period)
        calls = round(self.period / control_period)
        if calls < 1 or abs(calls * control_period - self.period) > 1e-9 * self.period:
            raise ValueError(
                f"the policy acts every {self.period:g} s, which is not a whole multiple of control_period = "
                f"{control_period:g} s; allowed control periods: {self.period:g} s divided by 1, 2, 3, ..."
            )
        return calls


@dataclasses.dataclass(frozen=True)
class ArmDefinition:
    """The arm that a policy was trained for."""

    name: str  # name of the robot
    digest: str  # `Robot.digest` of the robot; for the two-joint arm, the digest of the equivalent robot
