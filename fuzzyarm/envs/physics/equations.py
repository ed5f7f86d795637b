"""The equations of an arm, by its parameters."""

from __future__ import annotations

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.two_joints import two_joints

__all__ = ["equations_of"]


def equations_of(arm: ArmParameters) -> Physics:
    """Return the equations of motion of an arm; arms of one structure have the same object."""
    return two_joints()
