"""How the path of the tip is seen in a figure: in the plane of the two-joint arm, or face-on where it lies in space."""

from __future__ import annotations

import dataclasses

import numpy as np

__all__ = ["View", "view_of"]

_PLANE, _SPACE = 2, 3


@dataclasses.dataclass(frozen=True)
class View:
    """Two directions in which points are drawn.

    Attributes:
        rows: (2, axes), of the unit vectors that point down and to the side in the picture.
        labels: of the vertical and the horizontal axis.
        upwards: whether the vertical axis counts upwards.
    """

    rows: np.ndarray
    labels: tuple[str, str]
    upwards: bool

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return the points (..., axes) [m] as (..., 2): down and to the side [m]."""
        return np.asarray(points @ self.rows.T)


def view_of(reference: np.ndarray) -> View:
    """Return the view of a path with these points (n, 2 or 3) [m].

    In space it is the plane that the path lies in, or comes closest to, with the base's z axis pointing as far up as it
    can.
    """
    if reference.shape[-1] == _PLANE:
        return View(np.eye(_PLANE), ("x, down [m]", "y, to the side [m]"), upwards=False)
    _, _, directions = np.linalg.svd(reference - reference.mean(axis=0), full_matrices=True)
    normal = directions[-1] * (1.0 if directions[-1].sum() >= 0.0 else -1.0)
    up = np.eye(_SPACE)[-1] - normal[-1] * normal
    if np.linalg.norm(up) < 0.1:  # a path in the plane of the base is seen from above, x downwards
        up = normal[0] * normal - np.eye(_SPACE)[0]
    up /= np.linalg.norm(up)
    side = np.cross(up, normal)
    return View(np.stack([-up, side]), (f"along {_named(up)} [m]", f"along {_named(side)} [m]"), upwards=True)


def _named(direction: np.ndarray) -> str:
    """Return a direction in the base frame as text."""
    return "(" + ", ".join(f"{part + 0.0:.2g}" for part in np.round(direction, 2)) + ")"
