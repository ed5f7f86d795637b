"""The picture of the two-joint arm, in its plane.

The frame is that of (26), turned so that gravity points down the picture: right = y, down = x.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.canvas import (
    FOOTER,
    HEADER,
    HEIGHT,
    INK,
    LONGEST_ARROW,
    MARGIN,
    PAPER,
    REACH,
    REFERENCE,
    STEEL,
    WIDTH,
    Canvas,
    magnified,
    paint_error,
    paint_footer,
    paint_force,
    paint_payload,
)
from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.envs.physics.parameters import ArmParameters

__all__ = ["View", "paint_in_plane"]

# Columns of the trace.
TIP, TIP_REFERENCE, LINK, FORCE_ROW = map(VECTORS.index, ("tip", "tip_reference", "q_link", "external_force"))


class View(NamedTuple):
    """Where the plane of the arm lies in the picture: the scale [px/m] and the base (right, down) [px]."""

    scale: float
    base: np.ndarray

    @classmethod
    def fit(cls, points: np.ndarray) -> View:
        """Return the view that shows all points (n, 2) [m] as large as the field allows, in its middle."""
        low, high = points.min(axis=0)[::-1], points.max(axis=0)[::-1]
        room = np.array([WIDTH, HEIGHT - HEADER - FOOTER]) - 2.0 * MARGIN
        scale = float(np.min(room / np.maximum(high - low, 1e-6)))
        return cls(scale, 0.5 * (np.array([WIDTH, HEIGHT + HEADER - FOOTER]) - scale * (low + high)))

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return (right, down) = base + scale (y, x) [px] of points (..., 2) [m]."""
        return self.base + self.scale * points[..., ::-1]


def paint_in_plane(canvas: Canvas, schedule: Schedule, trace: np.ndarray, parameters: ArmParameters) -> None:
    """Paint the field and the footer; arguments in the shapes and units of `Renderer.draw`."""
    length = parameters.length
    q = np.concatenate([schedule.references[:, :2], trace[:, LINK]])
    elbow, tip = tip_position(q, (length[0], 0.0)), tip_position(q, length)
    # The view contains the base, the reference and all poses so far, so it widens only if the arm leaves it.
    view = View.fit(np.concatenate([np.zeros((1, 2)), elbow, tip]))
    joints = view.pixels(np.stack([np.zeros(2), elbow[-1], tip[-1]]))
    canvas.disc(view.base, view.scale * sum(length), REACH)
    canvas.disc(view.base, view.scale * abs(length[0] - length[1]), PAPER)
    canvas.line(view.pixels(schedule.targets[:, :2]), 5.0, REFERENCE)
    _paint_arm(canvas, joints, 0.032 * view.scale * sum(length))
    payload, force = schedule.disturbance.payload, trace[-1, FORCE_ROW]
    if payload.mass > 0.0:
        along = payload.radius(parameters) / length[1]
        paint_payload(canvas, joints[1] + along * (joints[2] - joints[1]), payload.mass)
    if force.any():
        back = LONGEST_ARROW * force[::-1] / np.linalg.norm(schedule.forces, axis=1).max()
        paint_force(canvas, joints[2] - back, joints[2], float(np.hypot(*force)))
    paint_error(canvas, view.pixels(magnified(trace[:, TIP], trace[:, TIP_REFERENCE])))
    _paint_footer(canvas, view.scale)


def _paint_arm(canvas: Canvas, joints: np.ndarray, thickness: float) -> None:
    """Paint the mounting and the links through base, elbow and tip (3, 2) [px]."""
    base, elbow, tip = joints
    canvas.polygon(base + thickness * np.array([[-0.6, 0.0], [-1.1, -1.9], [1.1, -1.9], [0.6, 0.0]]), INK)
    canvas.line(base + thickness * np.array([[-1.7, -1.9], [1.7, -1.9]]), 6.0, INK)
    for start, end, width in ((base, elbow, thickness), (elbow, tip, 0.75 * thickness)):
        canvas.line(np.stack([start, end]), width + 4.0, INK)
        canvas.line(np.stack([start, end]), width, STEEL)
    for joint, radius in ((base, 0.6 * thickness), (elbow, 0.55 * thickness)):
        canvas.disc(joint, radius, INK)
        canvas.disc(joint, 0.45 * radius, PAPER)


def _paint_footer(canvas: Canvas, scale: float) -> None:
    """Paint the footer with a scale bar of 10^n m, at most 120 px long, on top of the arm."""
    paint_footer(canvas, "reach")
    middle, right = HEIGHT - 0.5 * FOOTER, WIDTH - 28.0
    bar = 10.0 ** np.floor(np.log10(120.0 / scale))
    canvas.line(np.array([[right - bar * scale, middle], [right, middle]]), 4.0, INK)
    canvas.text(f"{1e3 * bar:g} mm", "midright", (right - bar * scale - 12.0, middle))
