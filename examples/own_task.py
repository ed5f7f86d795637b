"""A scenario of your own: another path, another disturbance, the shipped controller.

python examples/own_task.py
"""

import gymnasium as gym

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Lemniscate
from fuzzyarm.envs.scenario.reference import JointReference

push = Disturbance(tip_force=ConstantForce((0.0, 50.0), start=0.5), encoder_noise=EncoderNoise(1e-5, 1e-3))
eight = JointReference(Lemniscate(center=(0.4, 0.5), half_width=0.2), duration=2.0)
env = gym.make("FuzzyArm-v0", disturbance=push, reference=eight)

policy = load_policy("fuzzy-4")
observation, info = env.reset(seed=0)
state, done, worst = None, False, 0.0
while not done:
    action, state = policy.predict(observation, state)
    observation, _, terminated, truncated, info = env.step(action)
    worst, done = max(worst, info["tip_error"]), terminated or truncated
print(f"largest tip error {1e3 * worst:.2f} mm, {info.get('reason', 'path completed')}")
