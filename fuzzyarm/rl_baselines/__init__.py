"""How policies are learned: the batched arms as learning libraries need them, a trainer, and PPO.

torch and stable-baselines3 may be imported here and nowhere else in the package; they come with the extra ``rl``.
"""
