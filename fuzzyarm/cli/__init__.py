"""The command line."""

from fuzzyarm.cli.application import entry_point, main

__all__ = ["entry_point", "main"]
