"""Running means and variances of stable-baselines3's normaliser, as part of a checkpoint."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["moments_of", "set_moments"]


def moments_of(running: Any) -> dict[str, Any]:
    """Return the state of a `RunningMeanStd` of stable-baselines3."""
    return {"mean": np.asarray(running.mean), "var": np.asarray(running.var), "count": float(running.count)}


def set_moments(running: Any, moments: dict[str, Any]) -> None:
    """Put a `RunningMeanStd` back to a state, whose arrays have become tensors."""
    running.mean, running.var = moments["mean"].numpy().copy(), moments["var"].numpy().copy()
    running.count = moments["count"]
