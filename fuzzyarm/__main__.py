"""The command line of the package, started by ``python -m fuzzyarm``."""

from fuzzyarm.cli import entry_point

entry_point()
