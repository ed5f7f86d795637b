"""The schedule of an episode: reference, tip force and torque bias of every control step, tabulated before it starts.

A force within a step is stored as a line in time with the same impulse and first moment.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.periods import MOST_STEPS
from fuzzyarm.envs.physics.integrator import force_line
from fuzzyarm.envs.physics.records import columns, per_joint, record_type, size
from fuzzyarm.envs.scenario.disturbances import Disturbance, TipForce
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.envs.task import target_record

__all__ = ["Schedule", "reference_record", "row_record"]

_FORCE_SAMPLES = 8  # per control step; a kink of the force within a step then costs less than 0.1 µm at the tip


@functools.cache
def reference_record(joints: int) -> Any:
    """Return the record type of q_d, q̇_d and q̈_d [rad, rad/s, rad/s²], in the order of the observation."""
    return record_type("ReferenceRow", **dict.fromkeys(("q", "dq", "ddq"), per_joint(joints)))


@functools.cache
def row_record(joints: int, axes: int) -> Any:
    """Return the record type of a row k: joint `reference` and tip `target` at time t_k, loads until t_(k+1).

    `force` acts on the tip; `bias` is a torque [N m] added to the motor torques.
    """
    reference, target = reference_record(joints), target_record(axes)
    return record_type("Row", reference=reference, target=target, force=force_line(axes), bias=per_joint(joints))


@dataclasses.dataclass(frozen=True)
class Schedule:
    """A table over the control steps k = 0..steps; the torque of step k acts from t_k to t_(k+1).

    `table` (steps + 1, entries of `row_record`) has the units given there; the properties are its columns. The last
    row, at the end of the episode, has no force or bias.
    """

    disturbance: Disturbance
    table: np.ndarray
    joints: int
    axes: int

    @property
    def columns(self) -> Any:
        """A record that has, for each field of `row_record`, the slice of its columns in `table`."""
        return columns(row_record(self.joints, self.axes))

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return len(self.table) - 1

    @property
    def references(self) -> np.ndarray:
        """The reference at t_k (steps + 1, 3 n): q_d, q̇_d, q̈_d of n joints [rad, rad/s, rad/s²]."""
        return self.table[:, self.columns.reference]

    @property
    def targets(self) -> np.ndarray:
        """(steps + 1, 7 or 10), the target of the tip at t_k, a `task.target_record`."""
        return self.table[:, self.columns.target]

    @property
    def forces(self) -> np.ndarray:
        """(steps, 4 or 6) [N]: the mean tip force over step k, then the change of the least-squares line in it."""
        return self.table[:-1, self.columns.force]

    @property
    def biases(self) -> np.ndarray:
        """(steps, n), the torque bias [N m] held over step k: its value at the step's middle."""
        return self.table[:-1, self.columns.bias]

    @classmethod
    def build(
        cls, reference: Reference, disturbance: Disturbance, control_period: float, axes: int | None = None
    ) -> Schedule:
        """Sample a reference and a disturbance every `control_period` [s]; `axes` is 2 or 3, by default the path's."""
        axes = reference.tip(0.0).position.shape[-1] if axes is None else axes
        # The last step may pass the end of the reference, which rests there.
        steps = math.ceil(reference.duration / control_period - 1e-9)
        if steps > MOST_STEPS:
            raise ValueError(
                f"a reference of {reference.duration:g} s has {steps} control periods of {control_period:g} s; "
                f"allowed: at most {MOST_STEPS}. Shorten the reference or lengthen the control period"
            )
        times, joints = control_period * np.arange(steps + 1), reference.joints
        sample, kind = reference.sample(times), row_record(joints, axes)
        at, table = columns(kind), np.zeros((steps + 1, size(kind)))
        table[:, at.reference] = np.concatenate([sample.q, sample.dq, sample.ddq], axis=-1)
        table[:, at.target] = _targets(reference, times, axes)
        if disturbance.tip_force is not None:
            table[:-1, at.force] = _force_lines(disturbance.tip_force, reference, times[:-1], control_period, axes)
        if disturbance.torque_bias is not None:
            bias = disturbance.torque_bias.at(times[:-1] + 0.5 * control_period)
            if bias.shape[-1] != joints:
                raise ValueError(
                    f"TorqueBias.torque has {bias.shape[-1]} numbers; needed: {joints}, one for each joint"
                )
            table[:-1, at.bias] = bias
        return cls(disturbance, table, joints, axes)


def _force_lines(tip_force: TipForce, reference: Reference, starts: np.ndarray, period: float, axes: int) -> np.ndarray:
    """Return (steps, 2 · axes) [N]: the mean tip force over each step, then the change over the step by a fitted line.

    The steps begin at `starts` (steps,) [s] and last `period` [s].
    """
    shares = (np.arange(_FORCE_SAMPLES) + 0.5) / _FORCE_SAMPLES
    times = (starts[:, np.newaxis] + shares * period).ravel()
    force = checks.array_of("tip_force.at", tip_force.at(times, reference.tip(times).velocity[..., :axes]))
    if force.shape != (len(times), axes):
        # Compiled code does not check bounds.
        raise ValueError(
            f"tip_force.at returned an array of shape {force.shape}; needed: ({len(times)}, {axes}), one force per time"
        )
    force = checks.finite_array("tip_force.at", force, (len(times), axes), "N")
    samples, lever = np.reshape(force, (len(starts), _FORCE_SAMPLES, axes)), shares - 0.5
    return np.concatenate([samples.mean(axis=1), np.einsum("j,kja->ka", lever, samples) / (lever @ lever)], axis=-1)


def _targets(reference: Reference, times: np.ndarray, axes: int) -> np.ndarray:
    """Return rows (times, 7 or 10): the reference's tip, the curve's normal, center and radius (0 unless a circle)."""
    position, normal = reference.tip(times).position[..., :axes], reference.normals(times)[..., :axes]
    circle = np.zeros(axes + 1)
    if reference.circle is not None:
        center, circle[-1] = reference.circle
        circle[:-1] = center[:axes]
    return np.concatenate([position, normal, np.broadcast_to(circle, (len(times), axes + 1))], axis=-1)
