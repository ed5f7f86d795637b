"""When a lane of a batch begins its next episode, as Gymnasium's vector environments have it.

SAME_STEP, the default: within the step that ends the last one, of which `info` then has the last instant.
NEXT_STEP: in the step after, which ignores that lane's action.
DISABLED: when ``reset(options={"reset_mask": ...})`` names the lane.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from fuzzyarm.common import checks

__all__ = ["RESET_MASK", "chosen_mode", "masked_lanes"]

RESET_MASK = "reset_mask"
"""The reset option that holds which lanes (num_envs,) to reset, as booleans."""


def chosen_mode(given: Any) -> AutoresetMode:
    """Return the mode itself, or the one that has this value: "SameStep", "NextStep" or "Disabled".

    Raises:
        ValueError: there is no such mode.
    """
    if isinstance(given, AutoresetMode):
        return given
    return AutoresetMode(checks.choice("autoreset_mode", given, [mode.value for mode in AutoresetMode]))


def masked_lanes(name: str, mask: Any, lanes: int) -> np.ndarray:
    """Return the numbers (n,) of the lanes that a mask (lanes,) of booleans names, in ascending order.

    Raises:
        TypeError: the mask is no array of booleans.
        ValueError: it has not one entry per lane, or names no lane.
    """
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        kind = f"an array of {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"{name} is {kind}; it must be a numpy array of {lanes} booleans: which lanes to reset")
    if mask.shape != (lanes,):
        raise ValueError(f"{name} has shape {mask.shape}; needed: {(lanes,)}, one boolean per lane")
    if not mask.any():
        raise ValueError(f"{name} names no lane; at least one entry must be True")
    return np.flatnonzero(mask)
