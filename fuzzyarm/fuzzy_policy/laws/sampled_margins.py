"""Whether gains hold on the sampled elastic robot, anywhere in its range: what the default gains are chosen by.

At random postures the robot is linearised without gravity and dry friction, see `observer_gains.sampled_arm`, and a
law near rest is, with its memory s,

    u = κ (D x + C s),    s⁺ = G x + F s,

with x the plant's 4 n states, u held over a period or one period late. `fuzzyarm.eval.stability` measures the same of
any policy, with gravity, at postures of a path.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import with_drives
from fuzzyarm.fuzzy_policy.laws.gain_schedule import random_angles
from fuzzyarm.fuzzy_policy.laws.observer_gains import sampled_arm, state_part

__all__ = ["CONDITIONS", "ONE_AT_A_TIME", "Condition", "LinearLaw", "Place", "places_of", "worst_radius"]


class Condition(NamedTuple):
    """How the loop differs from what the law expects: factor κ on its gain, late samples, factor on the stiffness."""

    loop_gain: float = 1.0
    delay: int = 0
    stiffness: float = 1.0


ONE_AT_A_TIME = (Condition(), Condition(loop_gain=2.0), Condition(delay=1))
"""The margins of the bandwidth of computed torque: 6 dB, and one sample of delay."""

CONDITIONS = (
    *(Condition(gain, delay) for gain in (1.0, 0.67, 1.5) for delay in (0, 1)),
    *(Condition(stiffness=factor) for factor in (0.9, 1.1)),
)
"""The margins of the observer's weights."""

COUNT = 16  # postures


@dataclasses.dataclass(frozen=True)
class Place:
    """The robot at a posture.

    Attributes:
        q: the angles (n,) [rad].
        inertia: M (n, n) [kg m²].
        robot: the nominal one.
        control_period: T [s].
    """

    q: np.ndarray
    inertia: np.ndarray
    robot: Robot
    control_period: float

    def plant(self, stiffness: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return A (5 n, 5 n) and B (5 n, n) of `sampled_arm`, with all joints `stiffness` times as stiff."""
        arm = with_drives(self.robot, stiffness=stiffness * self.robot.drive("stiffness"))
        return sampled_arm(arm, self.control_period, self.inertia)


class LinearLaw(NamedTuple):
    """A law near rest, see the module: D (n, 4 n), C (n, m), G (m, 4 n), F (m, m), torques in N m."""

    D: np.ndarray
    C: np.ndarray
    G: np.ndarray
    F: np.ndarray


def places_of(robot: Robot, control_period: float, count: int = COUNT) -> list[Place]:
    """Return random postures, always the same, for a control period [s]."""
    angles = random_angles(robot)[:count]
    return [Place(q, M, robot, control_period) for q, M in zip(angles, mass_matrix(robot, angles), strict=True)]


def worst_radius(place: Place, law: LinearLaw, conditions: tuple[Condition, ...]) -> float:
    """Return the largest |λ| per control period of the loop, over conditions."""
    plants = {factor: place.plant(factor) for factor in {condition.stiffness for condition in conditions}}
    return max(float(np.abs(np.linalg.eigvals(_matrix(plants[c.stiffness], law, c))).max()) for c in conditions)


def _matrix(plant: tuple[np.ndarray, np.ndarray], law: LinearLaw, condition: Condition) -> np.ndarray:
    """Return the map of (x, s), or of (x, s, u) if u acts one period late."""
    joints, states = law.D.shape
    state = state_part(joints)
    A, B = plant[0][state, state], plant[1][state]
    D, C, memory = condition.loop_gain * law.D, condition.loop_gain * law.C, len(law.F)
    if not condition.delay:
        return np.block([[A + B @ D, B @ C], [law.G, law.F]])
    return np.block(
        [
            [A, np.zeros((states, memory)), B],
            [law.G, law.F, np.zeros((memory, joints))],
            [D, C, np.zeros((joints, joints))],
        ]
    )
