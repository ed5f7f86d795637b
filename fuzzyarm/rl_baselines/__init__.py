"""Training of policies: batched arms for learning libraries, a trainer, and PPO.

torch and stable-baselines3 come with the extra ``rl``; outside this folder only `policies._sb3` imports torch.
"""
