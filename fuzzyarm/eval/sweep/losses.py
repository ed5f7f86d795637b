"""When workers that die again and again are given up, on any backend."""

from __future__ import annotations

__all__ = ["TRIES", "WorkersLost"]

TRIES = 3
"""How often workers may be lost at a piece of work, or in a row, until it is given up."""


class WorkersLost(Exception):
    """Workers die again and again; the message says how often."""
