"""Everything of one episode that is known before it starts: reference, forces, biases and noise, as tables."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from fuzzyarm.envs.disturbances import Disturbance, TipForce
from fuzzyarm.envs.paths import Circle
from fuzzyarm.envs.reference import JointReference, quintic_time_law

FORCE_SAMPLES = 8  # inside a control step; a kink of the force within a step then costs less than 0.1 µm at the tip


@dataclasses.dataclass(frozen=True)
class Episode:
    """Tables over the control steps k = 0..steps; the torque of step k acts from t_k to t_(k+1).

    Attributes:
        disturbance: what acts in this episode.
        references: (steps + 1, 6), q_d, q̇_d, q̈_d at t_k [rad, rad/s, rad/s²].
        targets: (steps + 1, 7, 1), what `task.measure` compares the tip with at t_k.
        forces: (steps, 4, 1), the mean tip force of step k and the change over the step of the straight line that
            fits it best [N]: impulse and first moment are kept, and a force that sets in at t_k does not leak.
        biases: (steps, 2, 1), the torque bias held over step k, taken at its middle [N m].
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
        sample = reference.sample(times)
        forces, biases = np.zeros((steps, 4)), np.zeros((steps, 2))
        if disturbance.tip_force is not None:
            forces = _force_lines(disturbance.tip_force, reference, times[:-1], control_period)
        if disturbance.torque_bias is not None:
            biases = disturbance.torque_bias.at(times[:-1] + 0.5 * control_period)
        encoder = disturbance.encoder_noise
        return cls(
            disturbance,
            np.concatenate([sample.q, sample.dq, sample.ddq], axis=-1),
            _targets(reference, times)[:, :, np.newaxis],
            forces[:, :, np.newaxis],
            biases[:, :, np.newaxis],
            None if encoder is None else encoder.sample(noise, steps + 1),
        )


def _force_lines(tip_force: TipForce, reference: JointReference, starts: np.ndarray, period: float) -> np.ndarray:
    """Return (len(starts), 4): mean force over each step and change of its least-squares line, from samples inside."""
    shares = (np.arange(FORCE_SAMPLES) + 0.5) / FORCE_SAMPLES
    times = (starts[:, np.newaxis] + shares * period).ravel()
    force = tip_force.at(times, reference.tip(times).velocity)
    if np.shape(force) != (len(times), 2):
        # Compiled code checks no bounds.
        raise ValueError(
            f"tip_force.at gave shape {np.shape(force)} for {len(times)} times; it must be ({len(times)}, 2)"
        )
    samples, lever = np.reshape(force, (len(starts), FORCE_SAMPLES, 2)), shares - 0.5
    return np.concatenate([samples.mean(axis=1), np.einsum("j,kja->ka", lever, samples) / (lever @ lever)], axis=-1)


def _targets(reference: JointReference, times: np.ndarray) -> np.ndarray:
    """Return (len(times), 7): reference tip, left normal of the curve, circle center and radius (0: no circle)."""
    position, derivative, _ = reference.path.points(quintic_time_law(times, reference.duration)[0])
    length = np.hypot(derivative[:, 0], derivative[:, 1])[:, np.newaxis]
    normal = np.stack([-derivative[:, 1], derivative[:, 0]], axis=-1) / length
    circle = np.zeros(3)
    if isinstance(reference.path, Circle):
        circle[:] = *reference.path.center, reference.path.radius
    return np.concatenate([position, normal, np.broadcast_to(circle, (len(times), 3))], axis=-1)
