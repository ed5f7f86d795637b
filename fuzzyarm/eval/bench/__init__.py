"""Benchmark of speed: environment steps per second, compared with peers."""
