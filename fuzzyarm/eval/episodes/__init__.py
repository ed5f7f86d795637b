"""Rollouts: recording of episodes, their file and their metrics."""
