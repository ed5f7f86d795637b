"""The gains that the paper prints in section 6.2 for four rules: those for i = 1, which are also used for i = 2.

K and H have the same sign, see docs/paper/reading.md. E_p1 is the vertex of the smallest z1 in the paper and here. No
matrix inequality certifies this law.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.controller import Controller

__all__ = ["with_printed_gains"]

_K = np.array(
    [
        [[-6.31e4, 1.16e4, -978.0, -18.0], [0.91e4, -6.513e4, 44.0, -591.0]],
        [[-9.73e3, -1.74e3, -469.0, -89.6], [-1.89e3, -3.76e3, -96.8, -162.0]],
    ]
)
_H = -np.array([[[0.720e4, 0.939e4], [0.939e4, 4.62e4]], [[312.0, 159.0], [152.0, 30.2]]])
_L = np.array(
    [
        [[14.7, -1.13, 0.47, -0.04, 0.004, -3e-4], [-6.37, 15.2, -0.21, 0.49, -0.002, 3.9e-4]],
        [[12.3, 0.634, 0.395, 0.0205, 0.0032, 0.0002], [3.82, 11.8, 0.123, 0.380, 0.0010, 0.0031]],
    ]
)


def with_printed_gains(controller: Controller) -> Controller:
    """Return the controller, which must have four rules, with the gains K_ik, H_ik and L_ik of the paper."""
    gains = np.stack([np.concatenate([_K, _H], axis=-1)] * 2)
    return dataclasses.replace(controller, gains=gains, feedforward=np.stack([_L] * 2))
