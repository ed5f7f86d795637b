"""Learned policies; the only place that may import torch and stable-baselines3. Empty so far."""
