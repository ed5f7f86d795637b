"""The plant as a program: one control period of an arm, computed by the environment's own functions.

The torques are clipped to the limits and held, the tip force is held, and the sub-steps are those of the environment.
"""

from collections.abc import Sequence
from typing import Any

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.records import places, size
from fuzzyarm.envs.task import clipped
from fuzzyarm.numbers.functions import repeat, zeros

__all__ = ["Plant"]


class Plant:
    """An elastic arm with friction; a step is one control period.

    Inputs are n motor torques [N m] and a force on the tip [N] with 2 or 3 components. The memory contains the 4 n
    entries of `State`, then the mass of a payload at the tip [kg]. The output is the position of the tip [m].
    """

    def __init__(self, arm: AnyArm, control_period: float = 1e-3) -> None:
        """Set up the equations and parameters of an arm; ValueError if the control period [s] is out of range."""
        physics = equations_of(arm)
        self.joints, self.axes, self.control_period = physics.joints, physics.axes, control_period
        self._substeps = whole_substeps(control_period, None, fastest_rate([arm]))
        self._h = control_period / self._substeps
        self._plant, self._place = physics.plant_of(arm), physics.payload_place(Payload(), arm)
        self._limit, self._physics = physics.limits(self._plant).torque, physics
        self.memory = zeros(places(physics.State)), 0.0
        self.memory_size = size(physics.State) + 1

    def step(self, given: Sequence[Any], memory: Any) -> tuple[Any, Any]:
        """Return the memory after a control period, and the position of the tip (axes,) [m].

        `given` (n + axes,) are torques [N m], then the force [N].
        """
        physics, (now, payload) = self._physics, memory
        torque = physics.PerJoint(*map(clipped, given[: self.joints], self._limit))
        force = physics.Point(*given[self.joints :])
        arm = physics.constants(self._plant, payload, self._place, 0.0)
        now = repeat(self._substeps, lambda state: physics.step(state, torque, force, arm, self._h), now)
        return (now, payload), physics.tip(now.link, arm)

    def place(self, given: Sequence[Any], memory: Any) -> tuple[Any, Any]:
        """Return the unchanged memory, and the position of the tip (axes,) [m] at link angles `given` (n,) [rad]."""
        arm = self._physics.constants(self._plant, 0.0, self._place, 0.0)
        return memory, self._physics.tip(self._physics.PerJoint(*given), arm)
