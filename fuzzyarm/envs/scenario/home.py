"""The posture in which the motions of a robot begin, if none is given: dexterous, at ease, far from its limits.

    home = argmax of  log √det(J Jᵀ) - |g(q)/Γ_max|² - mean(((q - middle)/half range)²)

The first term is Yoshikawa's manipulability (International Journal of Robotics Research, 1985) of all that the last
link can do, with lengths in reaches of the robot; half ranges are at most π. The `IMPROVED` best of `POSTURES` random
postures are improved by a local search. The best is rounded to `ROUNDED` decimals, so that it is the same on every
machine.
"""

from __future__ import annotations

import functools

import numpy as np

from fuzzyarm.envs.physics.rigid_body import gravity
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.inverse_kinematics import freedom
from fuzzyarm.envs.scenario.kinematics import ANGULAR, LINEAR, angle_ranges, chain, jacobian, reach

__all__ = ["home_posture"]

POSTURES, IMPROVED, SEED = 2000, 5, 2022
INSIDE = 0.9  # share of the half ranges that is searched
DIFFERENCE = 1e-6  # of a share
ROUNDED = 2  # decimals
SINGULAR = 1e-300  # stands for a determinant of zero


@functools.lru_cache(maxsize=64)
def home_posture(robot: Robot) -> tuple[float, ...]:
    """Return the angles (n,) [rad] of the module's rule."""
    from scipy.optimize import minimize  # SciPy is only needed here

    low, high = angle_ranges(robot)
    middle, half = 0.5 * (low + high), np.minimum(0.5 * (high - low), np.pi)
    limit, can, length = robot.drive("torque_limit"), freedom(robot), reach(robot)
    turns = len(robot) >= len(can.motion) + len(can.turning)

    def cost(shares: np.ndarray) -> np.ndarray:
        """Return what is to be small (...) at shares (..., n) of the half ranges."""
        q = middle + half * shares
        rows = jacobian(chain(robot, q))
        parts = [can.motion @ rows[..., LINEAR, :] / length, *([can.turning @ rows[..., ANGULAR, :]] if turns else [])]
        moving = np.concatenate(parts, axis=-2)
        sizes = np.linalg.det(moving @ np.swapaxes(moving, -1, -2))
        dexterity = 0.5 * np.log(np.maximum(sizes, SINGULAR))
        strain = np.sum((gravity(robot, q) / limit) ** 2, axis=-1)
        return np.asarray(strain + np.mean(shares**2, axis=-1) - dexterity)

    def slope(shares: np.ndarray) -> np.ndarray:
        """Return the derivative (n,) of the cost at shares (n,), by central differences."""
        steps = DIFFERENCE * np.eye(len(shares))
        return np.asarray((cost(shares + steps) - cost(shares - steps)) / (2.0 * DIFFERENCE))

    tried = np.random.default_rng(SEED).uniform(-INSIDE, INSIDE, (POSTURES, len(robot)))
    bounds = [(-INSIDE, INSIDE)] * len(robot)
    best = [
        minimize(cost, tried[number], jac=slope, method="L-BFGS-B", bounds=bounds)
        for number in np.argsort(cost(tried))[:IMPROVED]
    ]
    shares = min(best, key=lambda found: float(found.fun)).x
    return tuple((np.round(middle + half * shares, ROUNDED) + 0.0).tolist())
