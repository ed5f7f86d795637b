"""PPO of stable-baselines3 with its default settings on the learning task, 64 arms at a time.

python examples/train_sb3.py [steps] [--seed SEED] [--out my-sb3.zip]
fuzzyarm score --policy sb3:my-sb3.zip

150,000 steps take about a minute of one core.
"""

import argparse

import gymnasium as gym
import torch
from stable_baselines3 import PPO

from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("steps", nargs="?", type=int, default=150_000, help="at least; default: %(default)s")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="my-sb3.zip")
given = parser.parse_args()
if given.steps < 1:
    parser.error(f"steps = {given.steps} is out of range; allowed: 1, 2, 3, ...")

torch.set_num_threads(1)  # for networks this small more threads are not faster
envs = StableBaselinesVecEnv(gym.make_vec("fuzzyarm:FuzzyArmLearn-v0", num_envs=64))
model = PPO("MlpPolicy", envs, n_steps=32, seed=given.seed, device="cpu")
model.learn(given.steps)
model.save(given.out)
print(f"{model.num_timesteps} steps; rank it with: fuzzyarm score --policy sb3:{given.out}")
