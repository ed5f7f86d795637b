"""Everything of one episode that is known before it starts: reference, forces, biases and noise, as tables."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from fuzzyarm.envs.disturbances import Disturbance
from fuzzyarm.envs.paths import Circle
from fuzzyarm.envs.reference import JointReference, quintic_time_law


@dataclasses.dataclass(frozen=True)
class Episode:
    """Tables over the control steps k = 0..steps; the torque of step k acts from t_k to t_(k+1).

    Attributes:
        disturbance: what acts in this episode.
        references: (steps + 1, 6), q_d, q̇_d, q̈_d at t_k [rad, rad/s, rad/s²].
        targets: (steps + 1, 7, 1), what `task.measure` compares the tip with at t_k.
        forces: (steps, 2, 1), the tip force held over step k, taken at its middle [N].
        biases: (steps, 2, 1), the torque bias likewise [N m].
        noise: (steps + 1, 4), encoder noise at t_k [rad, rad/s], or None.
    """

    disturbance: Disturbance
    references: np.ndarray
    targets: np.ndarray
    forces: np.ndarray
    biases: np.ndarray
    noise: np.ndarray | None

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return len(self.forces)

    @classmethod
    def build(
        cls, reference: JointReference, disturbance: Disturbance, control_period: float, noise: np.random.Generator
    ) -> Episode:
        """Sample a reference and a disturbance every `control_period` [s]; `noise` draws the encoder noise."""
        # The last step may pass the end of the reference, which rests there.
        steps = math.ceil(reference.duration / control_period - 1e-9)
        times = control_period * np.arange(steps + 1)
        middles = times[:-1] + 0.5 * control_period
        sample = reference.sample(times)
        forces = biases = np.zeros((steps, 2))
        if disturbance.tip_force is not None:
            forces = disturbance.tip_force.at(middles, reference.tip(middles)[1])
        if disturbance.torque_bias is not None:
            biases = disturbance.torque_bias.at(middles)
        if np.shape(forces) != (steps, 2):
            # The compiled kernel does not check bounds.
            raise ValueError(f"tip_force.at gave shape {np.shape(forces)} for {steps} times; it must be ({steps}, 2)")
        encoder = disturbance.encoder_noise
        return cls(
            disturbance,
            np.concatenate([sample.q, sample.dq, sample.ddq], axis=-1),
            _targets(reference, times)[:, :, np.newaxis],
            forces[:, :, np.newaxis],
            biases[:, :, np.newaxis],
            None if encoder is None else encoder.sample(noise, steps + 1),
        )


def _targets(reference: JointReference, times: np.ndarray) -> np.ndarray:
    """Return (len(times), 7): reference tip, left normal of the curve, circle center and radius (0: no circle)."""
    position, derivative, _ = reference.path.points(quintic_time_law(times, reference.duration)[0])
    length = np.hypot(derivative[:, 0], derivative[:, 1])[:, np.newaxis]
    normal = np.stack([-derivative[:, 1], derivative[:, 0]], axis=-1) / length
    circle = np.zeros(3)
    if isinstance(reference.path, Circle):
        circle[:] = *reference.path.center, reference.path.radius
    return np.concatenate([position, normal, np.broadcast_to(circle, (len(times), 3))], axis=-1)
