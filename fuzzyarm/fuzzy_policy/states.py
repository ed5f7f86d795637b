"""Slices of the parts of the states x = (q, q̇) and ē = (e, ė, x_I), in arrays and in the rows of matrices."""

from __future__ import annotations

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.envs.observation import JOINTS

__all__ = ["ERROR_STATES", "INTEGRAL", "PLANT", "PLANT_STATES", "POSITION", "SCALAR_STATES", "VELOCITY"]

POSITION, VELOCITY, INTEGRAL = consecutive(JOINTS, JOINTS, JOINTS)
"""Angles, velocities and, with the integral, x_I = ∫ (q - q_d) dt; one entry per joint in each."""

PLANT = slice(POSITION.start, VELOCITY.stop)  # the error of the plant, (e, ė), in ē
PLANT_STATES: int = VELOCITY.stop  # size of x
ERROR_STATES: int = INTEGRAL.stop  # size of ē with the integral; without it the size is `PLANT_STATES`
SCALAR_STATES = 3  # entries of ē per joint with the integral: (e, ė, x_I)
