"""Benchmark of speed: environment steps per second, compared with other packages."""
