"""Draw an arm in the middle of the machining case and save the picture.

python examples/picture.py arm.png
python examples/picture.py robot.png ur5 computed-torque
"""

import sys

import gymnasium as gym
from matplotlib.image import imsave

from fuzzyarm import load_policy

file, robot, law = sys.argv[1:] if len(sys.argv) > 2 else [sys.argv[1], "paper", "fuzzy-4"]
env = gym.make("FuzzyArm-v0", robot=robot, case="machining", render_mode="rgb_array")
policy = load_policy(law, robot=robot)
observation, _ = env.reset(seed=0)
state = None
for _ in range(750):
    action, state = policy.predict(observation, state)
    observation, *_ = env.step(action)
imsave(file, env.render())
env.close()
