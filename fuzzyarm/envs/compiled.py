"""Numba compilation with a disk cache that follows every physics source."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function` with Numba and cache the machine code on disk.

    Numba's cache only watches the file that defines the function: an edit in `dynamics` or `friction`, called from
    it, would leave stale machine code in use. A digest of all sources of this folder in the function's name, from
    which the cache file is named, prevents that. Without a writable cache folder the function is compiled anew.
    """
    function.__qualname__ = f"{function.__qualname__}_{_digest()}"
    try:
        return njit(cache=True, error_model="numpy")(function)
    except RuntimeError:
        return njit(error_model="numpy")(function)


@functools.cache
def _digest() -> str:
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]
