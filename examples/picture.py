"""Draw the arm in the middle of the machining case and save the picture.

python examples/picture.py arm.png
"""

import sys

import gymnasium as gym
from matplotlib.image import imsave

from fuzzyarm import load_policy

env = gym.make("FuzzyArm-v0", case="machining", render_mode="rgb_array")
policy = load_policy("fuzzy-4")
observation, _ = env.reset(seed=0)
state = None
for _ in range(750):
    action, state = policy.predict(observation, state)
    observation, *_ = env.step(action)
imsave(sys.argv[1], env.render())
env.close()
