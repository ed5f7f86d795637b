"""A rehearsal of the recording: the motion on the simulated arm, under computed torque, with encoder noise."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.identification.excitation import Excitation
from fuzzyarm.identification.log import Log

__all__ = ["NOISE", "rehearsed"]

NOISE = EncoderNoise(1e-5, 1e-3)
"""Of encoders with about 10⁵ lines [rad, rad/s]."""


def rehearsed(
    motion: Excitation, arm: ArmParameters, known: ArmParameters, seed: int, noise: EncoderNoise = NOISE
) -> Log:
    """Return the log of a motion on a simulated arm, one sample a millisecond.

    Args:
        motion: to follow.
        arm: the arm that moves.
        known: the arm that the controller takes it for.
        seed: of the noise.
        noise: of angles [rad] and velocities [rad/s].

    Raises:
        ValueError: the arm left its limits, since the controller knows it too badly.
    """
    env = FuzzyArmEnv(parameters=arm, reference=motion, disturbance=Disturbance(encoder_noise=noise))
    policy = ComputedTorquePolicy(known)
    (observation, _), memory = env.reset(seed=seed), None
    measured, torque, terminated, truncated = [], [], False, False
    while not (terminated or truncated):
        action, memory = policy.predict(observation, memory)
        measured.append(observation)
        observation, _, terminated, truncated, info = env.step(action)
        torque.append(info["torque"])
    env.close()
    if terminated:
        seconds = len(torque) * env.control_period
        raise ValueError(
            f"the arm left its limits after {seconds:.3g} s ({info['reason']}): the controller knows it too badly for "
            "this motion"
        )
    parts = observed(np.array(measured))
    return Log(env.control_period, parts.q_motor, np.array(torque), parts.dq_motor)
