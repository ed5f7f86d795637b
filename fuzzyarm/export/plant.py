"""The plant as a program: what an arm does in a control period, made of the very functions that the environment steps.

The torques are clipped to the limits and held, the tip force is held, and the sub-steps are those of the environment.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.records import in_list, joint_by_joint, reader, size, writer
from fuzzyarm.envs.task import clipped

__all__ = ["Plant"]


class Plant:
    """An elastic arm with friction that is stepped control period by control period.

    Given are n motor torques [N m] and a force on the tip [N]; remembered are the 4 n numbers of the state, `State`,
    and behind them the mass of a payload [kg] where the arm carries one; the result is the place of the tip [m].

    Attributes:
        joints: n.
        axes: of the tip's space, 2 or 3.
        control_period: T [s].
        memory_size: 4 n + 1.
    """

    def __init__(self, arm: AnyArm, control_period: float = 1e-3) -> None:
        """Take the equations and the numbers of an arm.

        Raises:
            ValueError: the control period is out of range.
        """
        physics = equations_of(arm)
        self.joints, self.axes, self.control_period = physics.joints, physics.axes, control_period
        self._substeps = whole_substeps(control_period, None, fastest_rate([arm]))
        self._h = control_period / self._substeps
        self._plant, self._place = physics.plant_of(arm), physics.payload_place(Payload(), arm)
        self._limit = physics.limits(self._plant).torque
        self._constants, self._step, self._tip = physics.constants, physics.step, physics.tip
        self._clip = joint_by_joint(clipped, physics.PerJoint, 2)
        self._state_of, self._keep = reader(physics.State, in_list), writer(physics.State, in_list)
        self._angles_of, self._force_of = reader(physics.PerJoint, in_list), reader(physics.Point, in_list)
        self._show = writer(physics.Point, in_list)
        self._payload = size(physics.State)
        self.memory_size = self._payload + 1

    def command(self, given: np.ndarray, memory: np.ndarray, result: np.ndarray) -> None:
        """Advance `memory` (1, 4 n + 1) by a control period, in place, and fill `result` (1, axes) [m].

        `given` (1, n + axes) are torques [N m], then the force [N].
        """
        torque = self._clip(self._angles_of(given[0], 0), self._limit)
        force, now = self._force_of(given[0], self.joints), self._state_of(memory[0], 0)
        arm = self._constants(self._plant, memory[0, self._payload], self._place, 0.0)
        for _ in range(self._substeps):
            now = self._step(now, torque, force, arm, self._h)
        self._keep(memory[0], 0, now)
        self._show(result[0], 0, self._tip(now.link, arm))

    def place(self, given: np.ndarray, memory: np.ndarray, result: np.ndarray) -> None:
        """Fill `result` (1, axes) [m], the place of the tip at the link angles `given` (1, n) [rad]."""
        arm = self._constants(self._plant, 0.0, self._place, 0.0)
        self._show(result[0], 0, self._tip(self._angles_of(given[0], 0), arm))
