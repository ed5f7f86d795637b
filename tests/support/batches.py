"""Batches of arms as users make them, short references, and torques that throw arms out of the box."""

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import fuzzyarm  # noqa: F401  registers FuzzyArm-v0
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Lemniscate, Line
from fuzzyarm.envs.scenario.reference import JointReference

LIMIT = np.array(ArmParameters().torque_limit)
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3))
LEAVING = np.r_[3.14, 0.0, 3.14, 0.0, 2.0, 0.0, 2.0, 0.0]  # out of the box within a few steps
SHORT = JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.05)  # 50 steps
LONGER = JointReference(path=Lemniscate((0.4, 0.5), 0.02), duration=0.1)


def batch(num_envs, **arguments):
    """The environment under test, made as its users make it."""
    return gym.make_vec("FuzzyArm-v0", num_envs=num_envs, **arguments)


def loop(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments):
    """What it must equal: Gymnasium's loop over single environments."""
    kwargs = {"autoreset_mode": autoreset_mode}
    return gym.make_vec("FuzzyArm-v0", num_envs=num_envs, vectorization_mode="sync", vector_kwargs=kwargs, **arguments)


def torques(seed, steps, lanes, scale=1.0, hold=300):
    """Torques anywhere in the action space, (steps, lanes, 2); their signs last long enough to throw an arm out."""
    generator = np.random.default_rng(seed)
    signs = np.repeat(generator.choice([-1.0, 1.0], (steps // hold + 1, lanes, 2)), hold, axis=0)[:steps]
    return signs * generator.uniform(0.5, 1.0, signs.shape) * scale * LIMIT
