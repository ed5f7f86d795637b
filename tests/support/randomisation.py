"""A randomisation of all that "robust" draws which is quickly made."""

import dataclasses

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference

# Three short references in place of the 32 long ones of "robust": these take a fifth of a second to tabulate.
ROBUST = dataclasses.replace(
    find_randomisation("plants", ArmParameters()),
    payload=(0.0, 5.0),
    force=(0.0, 1.0),
    angle=(-0.01, 0.01),
    references=(
        JointReference(path=Lemniscate((0.4, 0.5), 0.05), duration=0.2),
        JointReference(path=Line((0.4, 0.5), (0.45, 0.45)), duration=0.3),
        JointReference(path=Circle(radius=0.05), duration=0.25),
    ),
)
