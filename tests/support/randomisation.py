"""Randomisations of all that "robust" draws, and more, which are quickly made; a force and noise beside them."""

import dataclasses

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
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
SHORT = tuple(JointReference(Line((0.4, 0.5), (0.45, 0.4 + 0.02 * k)), duration=0.3) for k in range(5))
EVERYTHING = DomainRandomisation(
    mass=(0.9, 1.1),
    motor_inertia=(0.8, 1.3),
    stiffness=(0.7, 1.2),
    damping=(0.5, 1.6),
    dry_friction=(0.4, 1.5),
    viscous_friction=(0.3, 1.4),
    payload=(1.0, 5.0),
    force=(0.2, 0.8),
    angle=(-0.01, 0.02),
    references=SHORT,
)
NOISY = Disturbance(
    tip_force=CASES["machining"].disturbance.tip_force, encoder_noise=EncoderNoise(position=1e-4, velocity=1e-2)
)
