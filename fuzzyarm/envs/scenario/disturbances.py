"""What acts on the arm beside the controller, as data: forces, payloads, torque biases and encoder noise."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload


class TipForce(Protocol):
    """A force on the tip as a pure function of time and of the reference's tip velocity."""

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s] for reference tip velocities (..., 2) [m/s]."""
        ...


@dataclasses.dataclass(frozen=True)
class MachiningForce:
    """The force of Case 2, opposite to the direction of travel.

    F_e(t) = -f_e(t) v / max(|v|, v_0) with f_e(t) = base + swing sin(π t / duration): the paper's F_e = -f_e v/|v|,
    faded out at rest. The paper prints only the range 138-218 N; the half sine over the 1.5 s is this project's choice.

    Attributes:
        base: force at both ends [N].
        swing: rise towards the middle [N].
        duration: length of the half sine [s].
        fade_speed: v_0 [m/s].
    """

    base: float = 138.0
    swing: float = 80.0
    duration: float = 1.5
    fade_speed: float = 0.01

    def __post_init__(self) -> None:
        """Check the numbers."""
        _finite("MachiningForce.base", self.base)
        _finite("MachiningForce.swing", self.swing)
        _finite("MachiningForce.duration", self.duration, above=0.0)
        _finite("MachiningForce.fade_speed", self.fade_speed, above=0.0)

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s] for reference tip velocities (..., 2) [m/s]."""
        time = np.asarray(time, dtype=np.float64)
        magnitude = self.base + self.swing * np.sin(np.pi * np.clip(time / self.duration, 0.0, 1.0))
        speed = np.maximum(np.hypot(tip_velocity[..., 0], tip_velocity[..., 1]), self.fade_speed)
        force: np.ndarray = -(magnitude / speed)[..., np.newaxis] * tip_velocity
        return force


@dataclasses.dataclass(frozen=True)
class ConstantForce:
    """A force (x, y) [N] that acts on the tip from `start` to `stop` [s] (start <= t < stop); x points down."""

    force: tuple[float, float]
    start: float = 0.0
    stop: float = math.inf

    def __post_init__(self) -> None:
        """Check the numbers."""
        _pair("ConstantForce.force", self.force)
        _interval("ConstantForce", self.start, self.stop)

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s]; the tip velocity plays no part."""
        return _while_active(self.force, time, self.start, self.stop)


@dataclasses.dataclass(frozen=True)
class TorqueBias:
    """A torque [N m] added to what the motors apply from `start` to `stop` [s]; the controller does not see it."""

    torque: tuple[float, float]
    start: float = 0.0
    stop: float = math.inf

    def __post_init__(self) -> None:
        """Check the numbers."""
        _pair("TorqueBias.torque", self.torque)
        _interval("TorqueBias", self.start, self.stop)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return the bias (..., 2) [N m] at times (...) [s]."""
        return _while_active(self.torque, time, self.start, self.stop)


@dataclasses.dataclass(frozen=True)
class EncoderNoise:
    """White Gaussian noise on the measured motor angles [rad] and velocities [rad/s], as standard deviations."""

    position: float = 0.0
    velocity: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        _finite("EncoderNoise.position", self.position, at_least=0.0)
        _finite("EncoderNoise.velocity", self.velocity, at_least=0.0)


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """What acts in one episode; compose any of the parts. `None` and the default payload mean: not there.

    Examples:
        >>> Disturbance(tip_force=ConstantForce((0.0, 50.0)), payload=Payload(2.0)).payload.mass
        2.0
    """

    tip_force: TipForce | None = None
    payload: Payload = Payload()
    torque_bias: TorqueBias | None = None
    encoder_noise: EncoderNoise | None = None

    def __post_init__(self) -> None:
        """Check that each part is what its name says."""
        for name, kind in (("payload", Payload), ("torque_bias", TorqueBias), ("encoder_noise", EncoderNoise)):
            part = getattr(self, name)
            if not isinstance(part, kind) and (part is not None or name == "payload"):
                raise ValueError(f"Disturbance.{name} = {part!r} must be a {kind.__name__}")
        if self.tip_force is not None and not hasattr(self.tip_force, "at"):
            raise ValueError(f"Disturbance.tip_force = {self.tip_force!r} must have a method at(time, tip_velocity)")


def _finite(name: str, *values: float, above: float = -math.inf, at_least: float = -math.inf) -> None:
    for value in values:
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if not (is_number and math.isfinite(value) and value > above and value >= at_least):
            low = f"({above:g}" if above > at_least else f"[{at_least:g}" if math.isfinite(at_least) else "(-inf"
            raise ValueError(f"{name} = {value!r} is out of range; allowed: {low}, inf)")


def _pair(name: str, value: Sequence[float]) -> None:
    if not (isinstance(value, Sequence | np.ndarray) and len(value) == 2):
        raise ValueError(f"{name} = {value!r} must be two numbers; allowed: (-inf, inf) each")
    _finite(name, *value)


def _while_active(vector: tuple[float, float], time: np.ndarray, start: float, stop: float) -> np.ndarray:
    """Return (..., 2): `vector` where start <= time < stop, zero elsewhere."""
    time = np.asarray(time, dtype=np.float64)
    active = (time >= start) & (time < stop)
    return active[..., np.newaxis] * np.array(vector, dtype=np.float64)


def _interval(name: str, start: float, stop: float) -> None:
    _finite(f"{name}.start", start, at_least=0.0)
    if not stop > start:
        raise ValueError(f"{name}: start = {start!r} s and stop = {stop!r} s; allowed: 0 <= start < stop")
