"""PPO of stable-baselines3 on 64 arms that step as one batch, torques held for 10 ms.

python examples/train_batched.py [steps]

In half a minute on one core it does 500,000 steps, eight times as many as with one arm at a time (train_sb3.py). They
reduce the mean tip error from 970 mm, where the untrained arm falls, to 18 mm with seed 0; seeds 1 and 2 reached 23 and
12 mm. Nothing is saved, and 10 ms is not the 1 ms at which `fuzzyarm evaluate` compares policies. The real trainer is
`fuzzyarm train ppo`.
"""

import argparse

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from fuzzyarm.rl_baselines.sb3_vec_env import training_envs


def make_arm():
    """Return a single arm for evaluation, with actions in [-1, 1] like those of the batch."""
    return gym.wrappers.RescaleAction(gym.make("FuzzyArm-v0", control_period=0.01), -1, 1)


def show(when):
    """Run one episode without exploration and print the mean tip error."""
    arm, tip_errors, done = make_arm(), [], False
    observation, _ = arm.reset(seed=0)
    while not done:
        action, _ = model.predict(envs.normalize_obs(observation), deterministic=True)
        observation, _, terminated, truncated, info = arm.step(action)
        tip_errors.append(info["tip_error"])
        done = terminated or truncated
    error, end = 1e3 * sum(tip_errors) / len(tip_errors), info.get("reason", "path completed")
    print(f"{when}: mean tip error {error:.1f} mm over {info['time']:.2f} s, {end}")


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("steps", nargs="?", type=int, default=500_000, help="at least; default: %(default)s")
steps = parser.parse_args().steps
if steps < 1:
    parser.error(f"steps = {steps} is out of range; allowed: 1, 2, 3, ...")

torch.set_num_threads(1)  # for networks this small more threads are not faster
envs = VecNormalize(training_envs(64, control_period=0.01), norm_reward=False)
settings = {"learning_rate": 1e-3, "n_steps": 150, "batch_size": 960, "gamma": 0.98, "seed": 0, "device": "cpu"}
model = PPO("MlpPolicy", envs, policy_kwargs={"log_std_init": -1.0}, **settings)
show("before")
model.learn(steps)
show(f"after {model.num_timesteps} steps")
