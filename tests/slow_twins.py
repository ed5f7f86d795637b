"""Parametrised tests of which only some values run in the fast suite: the others test the same for longer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

__all__ = ["slow_but"]


def slow_but(fast: Iterable[Any], values: Iterable[Any]) -> list[Any]:
    """Return the parameters for `values`; those that are not in `fast` are marked slow."""
    kept = list(fast)
    return [value if value in kept else pytest.param(value, marks=pytest.mark.slow) for value in values]
