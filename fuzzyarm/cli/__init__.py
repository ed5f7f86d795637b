"""The command line."""

from fuzzyarm.cli._application import entry_point, main

__all__ = ["entry_point", "main"]
