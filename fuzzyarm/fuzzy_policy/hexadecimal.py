"""Numbers in JSON without rounding: floats as texts in C99 hexadecimal, and the digest of a document."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np

from fuzzyarm.common.checks import shown

__all__ = ["decoded", "digest_of", "encoded", "signed"]


def encoded(value: Any) -> Any:
    """Return `value` with every float in exact hexadecimal and arrays as nested lists."""
    if isinstance(value, np.ndarray):
        return encoded(value.tolist())
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, dict):
        return {key: encoded(entry) for key, entry in value.items()}
    return [encoded(entry) for entry in value] if isinstance(value, list) else value


def decoded(value: Any) -> Any:
    """Return nested lists or mappings with every hexadecimal string as a float; anything else raises ValueError."""
    if isinstance(value, str):
        try:
            return float.fromhex(value)
        except OverflowError:
            raise ValueError(f"{shown(value)} is beyond the largest float") from None
    if isinstance(value, list):
        return [decoded(entry) for entry in value]
    if isinstance(value, dict):
        return {key: decoded(entry) for key, entry in value.items()}
    raise ValueError(f"{shown(value)} is not an exact hexadecimal float")


def digest_of(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a document's canonical JSON: it detects accidental changes and is no signature."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8")).hexdigest()


def signed(document: dict[str, Any]) -> str:
    """Return the text of a file with a document and, in its last line, the digest of it."""
    entries = {**document, "digest": digest_of(document)}
    lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"
