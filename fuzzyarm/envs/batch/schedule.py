"""The schedule of an episode: reference, tip force and torque bias of every control step, tabulated before it starts.

A force is integrated over the control step, so that the table is as exact as the physics needs it.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.periods import MOST_STEPS
from fuzzyarm.envs.physics.integrator import ForceLine
from fuzzyarm.envs.physics.records import PerJoint, columns, size
from fuzzyarm.envs.scenario.disturbances import Disturbance, TipForce
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.reference import JointReference, quintic_time_law
from fuzzyarm.envs.task import Target

__all__ = ["COLUMNS", "ReferenceRow", "Row", "Schedule"]

FORCE_SAMPLES = 8  # inside a control step; a kink of the force within a step then costs less than 0.1 µm at the tip


class ReferenceRow(NamedTuple):
    """q_d, q̇_d and q̈_d [rad, rad/s, rad/s²], in the order in which the observation has them."""

    q: PerJoint
    dq: PerJoint
    ddq: PerJoint


class Row(NamedTuple):
    """One row of a schedule.

    Attributes:
        reference: of the joints at t_k.
        target: what the tip is compared with at t_k.
        force: on the tip, from t_k to t_(k+1).
        bias: torque from t_k to t_(k+1) [N m], beside what the motors apply.
    """

    reference: ReferenceRow
    target: Target
    force: ForceLine
    bias: PerJoint


COLUMNS = columns(Row)
"""The slice of columns that each field of `Row` takes in a schedule."""


@dataclasses.dataclass(frozen=True)
class Schedule:
    """A table over the control steps k = 0..steps; the torque of step k acts from t_k to t_(k+1).

    Attributes:
        disturbance: what acts in this episode.
        table: (steps + 1, numbers of `Row`); the properties below are its `COLUMNS`. No force or bias acts in the
            last row, where the episode is over.
    """

    disturbance: Disturbance
    table: np.ndarray

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return len(self.table) - 1

    @property
    def references(self) -> np.ndarray:
        """(steps + 1, 6), q_d, q̇_d, q̈_d at t_k [rad, rad/s, rad/s²]."""
        return self.table[:, COLUMNS.reference]

    @property
    def targets(self) -> np.ndarray:
        """(steps + 1, 7), what `task.assess` compares the tip with at t_k, a `Target`."""
        return self.table[:, COLUMNS.target]

    @property
    def forces(self) -> np.ndarray:
        """(steps, 4), the mean tip force of step k and the change over the step of the line that fits it best [N].

        Impulse and first moment are kept, and a force that sets in at t_k does not leak.
        """
        return self.table[:-1, COLUMNS.force]

    @property
    def biases(self) -> np.ndarray:
        """(steps, 2), the torque bias held over step k, taken at its middle [N m]."""
        return self.table[:-1, COLUMNS.bias]

    @classmethod
    def build(cls, reference: JointReference, disturbance: Disturbance, control_period: float) -> Schedule:
        """Sample a reference and a disturbance every `control_period` [s]."""
        # The last step may pass the end of the reference, which rests there.
        steps = math.ceil(reference.duration / control_period - 1e-9)
        if steps > MOST_STEPS:
            raise ValueError(
                f"a reference of {reference.duration:g} s has {steps} control periods of {control_period:g} s; "
                f"allowed: {MOST_STEPS}. Shorten the reference or lengthen the period"
            )
        times = control_period * np.arange(steps + 1)
        sample = reference.sample(times)
        table = np.zeros((steps + 1, size(Row)))
        table[:, COLUMNS.reference] = np.concatenate([sample.q, sample.dq, sample.ddq], axis=-1)
        table[:, COLUMNS.target] = _targets(reference, times)
        if disturbance.tip_force is not None:
            table[:-1, COLUMNS.force] = _force_lines(disturbance.tip_force, reference, times[:-1], control_period)
        if disturbance.torque_bias is not None:
            table[:-1, COLUMNS.bias] = disturbance.torque_bias.at(times[:-1] + 0.5 * control_period)
        return cls(disturbance, table)


def _force_lines(tip_force: TipForce, reference: JointReference, starts: np.ndarray, period: float) -> np.ndarray:
    """Return (len(starts), 4): mean force over each step and change of its least-squares line, from samples inside."""
    shares = (np.arange(FORCE_SAMPLES) + 0.5) / FORCE_SAMPLES
    times = (starts[:, np.newaxis] + shares * period).ravel()
    force = checks.array_of("tip_force.at", tip_force.at(times, reference.tip(times).velocity))
    if force.shape != (len(times), 2):
        # Compiled code checks no bounds.
        raise ValueError(f"tip_force.at gave shape {force.shape} for {len(times)} times; it must be ({len(times)}, 2)")
    force = checks.finite_array("tip_force.at", force, (len(times), 2), "N")
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
