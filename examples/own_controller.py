"""A controller of your own: PD with the gravity torque of the reference posture. Copy it and change the law.

fuzzyarm evaluate --policy examples.own_controller:factory
"""

import gymnasium as gym
import numpy as np

from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics


class GravityPD:
    """u = g(q_d) - K_p (q_a - q_d) - K_d (q̇_a - q̇_d), on (10,) or (lanes, 10)."""

    position_gain, velocity_gain = np.array([2.0e4, 4.0e3]), np.array([6.0e2, 1.0e2])  # N m/rad, N m s/rad

    def __init__(self, robot):
        """Keep the arm. A law that remembers something between calls returns it as its state."""
        self.arm = arm_constants(robot)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return motor torques [N m] and the next state, here none."""
        o = observed(observation)
        at_rest = np.zeros_like(o.q_reference)
        gravity = rigid_inverse_dynamics(o.q_reference, at_rest, at_rest, self.arm)
        error, error_rate = o.q_motor - o.q_reference, o.dq_motor - o.dq_reference
        return gravity - self.position_gain * error - self.velocity_gain * error_rate, state


def factory(control_period, robot):
    """Make the controller for calls every `control_period` [s] of the arm `robot`; take only what you need."""
    return GravityPD(robot)


if __name__ == "__main__":
    env = gym.make("FuzzyArm-v0")
    policy = factory(env.unwrapped.control_period, env.unwrapped.parameters)
    (observation, _), done, worst = env.reset(seed=0), False, 0.0
    while not done:
        observation, _, terminated, truncated, info = env.step(policy.predict(observation)[0])
        worst, done = max(worst, info["tip_error"]), terminated or truncated
    print(f"largest tip error {1e3 * worst:.1f} mm, {info.get('reason', 'path completed')}")
