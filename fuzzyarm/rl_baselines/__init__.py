"""Training of policies: batched arms for learning libraries, a trainer, and PPO.

torch and stable-baselines3 may be imported only here; they come with the extra ``rl``.
"""
