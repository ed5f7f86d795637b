"""Stability margins of the sampled elastic arm."""
