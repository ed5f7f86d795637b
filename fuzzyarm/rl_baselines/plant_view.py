"""What no sensor measures, for a value function that a shipped policy does not need.

The tip error, the links' errors from the reference, the tip force and what the episode drew: plant, load and start.
Errors go through asinh, in units that resolve a tenth of a millimetre.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import observed

__all__ = ["plant_view"]

_TIP, _ANGLE, _VELOCITY, _FORCE = 1e-4, 1e-4, 1e-2, 200.0  # m, rad, rad/s, N


def plant_view(info: Mapping[str, Any], observation: np.ndarray, which: Any = slice(None)) -> np.ndarray:
    """Return what the plants of some lanes do (rows, numbers), each of order 1 but for what was drawn.

    Args:
        info: of the whole batch, see `FuzzyArmVectorEnv`.
        observation: (rows, 5 n) of these lanes.
        which: the lanes.
    """
    o = observed(observation)
    parts = [
        np.arcsinh((info["tip"] - info["tip_reference"])[which] / _TIP),
        np.arcsinh((info["q_link"][which] - o.q_reference) / _ANGLE),
        np.arcsinh((info["dq_link"][which] - o.dq_reference) / _VELOCITY),
        info["external_force"][which] / _FORCE,
    ]
    drawn = info.get("randomisation", {})
    names = [name for name in sorted(drawn) if not name.startswith("_")]
    rows = (np.asarray(drawn[name], dtype=np.float64)[which] for name in names)
    return np.hstack([*parts, *(row.reshape(len(observation), -1) for row in rows)])
