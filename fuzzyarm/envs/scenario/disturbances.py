"""Disturbances as data: forces, payloads, torque biases and encoder noise."""

import dataclasses
import functools
import math
from typing import Protocol

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import LARGEST, keep_quantities, quantity
from fuzzyarm.envs.physics.robot import MOST_JOINTS

__all__ = ["ConstantForce", "Disturbance", "EncoderNoise", "MachiningForce", "TipForce", "TorqueBias"]


class TipForce(Protocol):
    """A force on the tip as a pure function of time and of the reference's tip velocity.

    Vectors have two components in the plane of the two-joint arm and three for other robots.

    A new kind of force is any class with this method.
    """

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2 or 3) [N] at times (...) [s] for tip velocities (..., 2 or 3) [m/s]."""
        ...


@dataclasses.dataclass(frozen=True)
class MachiningForce:
    """The force of Case 2, opposite to the direction of travel.

    F_e(t) = -f_e(t) v / max(|v|, v_0) with f_e(t) = base + swing sin(π t / duration): the paper's F_e = -f_e v/|v|,
    faded out at rest. The paper prints only the range 138-218 N; the half sine is this project's choice.

    Attributes:
        base: force at both ends [N].
        swing: rise towards the middle [N].
        duration: length of the half sine [s].
        fade_speed: v_0 [m/s].
    """

    base: float = quantity("N", 138.0, low=-LARGEST)
    swing: float = quantity("N", 80.0, low=-LARGEST)
    duration: float = quantity("s", 1.5, low=1.0 / LARGEST)
    fade_speed: float = quantity("m/s", 0.01, low=1.0 / LARGEST)

    def __post_init__(self) -> None:
        keep_quantities(self, "MachiningForce.")

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2 or 3) [N] at times (...) [s] for tip velocities (..., 2 or 3) [m/s]."""
        time = np.asarray(time, dtype=np.float64)
        magnitude = self.base + self.swing * np.sin(np.pi * np.clip(time / self.duration, 0.0, 1.0))
        speed = np.maximum(functools.reduce(np.hypot, np.moveaxis(tip_velocity, -1, 0)), self.fade_speed)
        force: np.ndarray = -(magnitude / speed)[..., np.newaxis] * tip_velocity
        return force


@dataclasses.dataclass(frozen=True)
class ConstantForce:
    """A force on the tip from `start` to `stop` [s] (start <= t < stop).

    It has two components (x, y) [N], x downwards, for the two-joint arm, and three in the base frame of another robot.
    """

    force: tuple[float, ...]
    start: float = 0.0
    stop: float = math.inf

    def __post_init__(self) -> None:
        checks.keep(
            self, "force", checks.reals("ConstantForce.force", self.force, range(2, 4), "N", low=-LARGEST, high=LARGEST)
        )
        _keep_interval(self)

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2 or 3) [N] at times (...) [s]; it does not depend on the tip velocity."""
        return _while_active(self.force, time, self.start, self.stop)


@dataclasses.dataclass(frozen=True)
class TorqueBias:
    """A torque [N m] added to the motor torques from `start` to `stop` [s], one entry for each joint.

    The controller does not observe it.
    """

    torque: tuple[float, ...]
    start: float = 0.0
    stop: float = math.inf

    def __post_init__(self) -> None:
        counts = range(1, MOST_JOINTS + 1)
        torque = checks.reals("TorqueBias.torque", self.torque, counts, "N m", low=-LARGEST, high=LARGEST)
        checks.keep(self, "torque", torque)
        _keep_interval(self)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return the bias (..., joints) [N m] at times (...) [s]."""
        return _while_active(self.torque, time, self.start, self.stop)


@dataclasses.dataclass(frozen=True)
class EncoderNoise:
    """Standard deviations of the white Gaussian noise on the measured motor angles [rad] and velocities [rad/s]."""

    position: float = quantity("rad", 0.0, low=0.0, high=math.inf)
    velocity: float = quantity("rad/s", 0.0, low=0.0, high=math.inf)

    def __post_init__(self) -> None:
        keep_quantities(self, "EncoderNoise.")


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """The disturbances of one episode, in any combination; None and the default payload have no effect.

    Examples:
        >>> Disturbance(tip_force=ConstantForce((0.0, 50.0)), payload=Payload(2.0)).payload.mass
        2.0
    """

    tip_force: TipForce | None = None
    payload: Payload = Payload()
    torque_bias: TorqueBias | None = None
    encoder_noise: EncoderNoise | None = None

    def __post_init__(self) -> None:
        for name, kind in (("torque_bias", TorqueBias), ("encoder_noise", EncoderNoise)):
            part = getattr(self, name)
            if not isinstance(part, kind | None):
                raise ValueError(f"Disturbance.{name} = {checks.shown(part)} must be a {__name__}.{kind.__name__}")
        if not (hasattr(self.payload, "mass") and hasattr(self.payload, "radius")):
            raise ValueError(
                f"Disturbance.payload = {checks.shown(self.payload)} must have an attribute mass and a method "
                "radius(parameters), like Payload"
            )
        if self.tip_force is not None and not hasattr(self.tip_force, "at"):
            raise ValueError(
                f"Disturbance.tip_force = {checks.shown(self.tip_force)} must have a method at(time, tip_velocity)"
            )


def _while_active(vector: tuple[float, ...], time: np.ndarray, start: float, stop: float) -> np.ndarray:
    """Return `vector` at times start <= time < stop and zeros elsewhere, with shape (..., length of `vector`)."""
    time = np.asarray(time, dtype=np.float64)
    active = (time >= start) & (time < stop)
    return active[..., np.newaxis] * np.array(vector, dtype=np.float64)


def _keep_interval(part: ConstantForce | TorqueBias) -> None:
    """Check a disturbance's start and stop [s] and store them in it as floats; the stop may be infinite."""
    name, start, stop = type(part).__name__, part.start, part.stop
    checks.keep(part, "start", checks.real(f"{name}.start", start, "s", low=0.0))
    if not (checks.is_real(stop) and stop > start):
        raise ValueError(
            f"{name}: start = {checks.shown(start)} s and stop = {checks.shown(stop)} s; allowed: 0 <= start < stop"
        )
    checks.keep(part, "stop", math.inf if stop == math.inf else checks.real(f"{name}.stop", stop, "s"))
