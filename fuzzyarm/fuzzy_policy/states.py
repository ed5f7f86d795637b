"""Where the parts of the states x = (q, q̇) and ē = (e, ė, x_I) lie, in arrays and in the rows of matrices."""

from __future__ import annotations

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.envs.observation import JOINTS

__all__ = ["ERROR_STATES", "INTEGRAL", "PLANT", "PLANT_STATES", "POSITION", "SCALAR_STATES", "VELOCITY"]

POSITION, VELOCITY, INTEGRAL = consecutive(JOINTS, JOINTS, JOINTS)
"""Angles, velocities and, with the integral, x_I = ∫ (q - q_d) dt; one number per joint in each."""

PLANT = slice(POSITION.start, VELOCITY.stop)
"""The error of the plant, (e, ė), in ē."""

PLANT_STATES: int = VELOCITY.stop
"""Numbers in x."""

ERROR_STATES: int = INTEGRAL.stop
"""Numbers in ē with the integral; without it there are `PLANT_STATES`."""

SCALAR_STATES = 3
"""Numbers of one joint in ē with the integral: (e, ė, x_I)."""
