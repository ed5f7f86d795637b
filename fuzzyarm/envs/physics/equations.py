"""The equations of an arm, by its parameters."""

from __future__ import annotations

from fuzzyarm.envs.physics.generated import physics_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.physics.two_joints import two_joints

__all__ = ["equations_of"]


def equations_of(arm: ArmParameters | Robot) -> Physics:
    """Return the equations of motion of an arm; arms of one structure have the same object.

    Those of the two-joint arm were written by hand (`two_joints`), those of a `Robot` are generated.
    """
    return physics_of(arm) if isinstance(arm, Robot) else two_joints()
