"""The picture of any serial robot, in perspective: gravity points down, and shadows fall along it on a floor."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.canvas import (
    FOOTER,
    FRAME,
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
from fuzzyarm.envs.perspective import Camera, Poses, floor_of, in_space, looking_at, poses_of
from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import reach

__all__ = ["paint_in_space"]

# Rows of the trace.
TIP, TIP_REFERENCE, LINK, FORCE_ROW = map(VECTORS.index, ("tip", "tip_reference", "q_link", "external_force"))
EVERY = 10  # instants between the poses that the view is made for
THICKNESS, THINNEST = 0.055, 0.6  # of the first link, share of the reach; of the last link, share of the first


def paint_in_space(canvas: Canvas, schedule: Schedule, trace: np.ndarray, robot: Robot) -> None:
    """Paint the field and the footer; arguments in the shapes and units of `Renderer.draw`."""
    joints, axes = len(robot), schedule.axes
    path, force = in_space(schedule.targets[:, :axes]), in_space(trace[-1, FORCE_ROW, :axes])
    asked = poses_of(robot, schedule.references[::EVERY, :joints])
    been = poses_of(robot, np.concatenate([trace[::EVERY, LINK, :joints], trace[-1:, LINK, :joints]]))
    floor, now = floor_of(robot, asked.points), Poses(been.points[-1], been.axes[-1])
    # The view contains the base, the reference and the poses so far, so it widens only if the arm leaves it.
    seen = np.concatenate([poses.points.reshape(-1, path.shape[-1]) for poses in (asked, been)])
    corners = np.array([[MARGIN, HEADER + MARGIN], [WIDTH - MARGIN, HEIGHT - FOOTER - MARGIN]], dtype=float)
    camera = looking_at(robot, path).fitted(np.concatenate([seen, floor.below(asked.points[0])]), *corners)
    for line in floor.grid:
        canvas.line(camera.pixels(line), 1.0, FRAME)
    thickness = THICKNESS * reach(robot)
    canvas.line(camera.pixels(floor.below(now.points)), 0.6 * _pixels(camera, now.points, thickness).mean(), REACH)
    canvas.line(camera.pixels(floor.below(path)), 2.0, REACH)
    canvas.line(camera.pixels(path), 5.0, REFERENCE)
    _paint_links(canvas, camera, now, thickness)
    payload = schedule.disturbance.payload
    if payload.mass > 0.0:
        paint_payload(canvas, camera.pixels(_carried(robot, payload.at, trace[-1, LINK, :joints])), payload.mass)
    if force.any():
        largest = np.linalg.norm(schedule.forces[:, :axes], axis=1).max()
        back = LONGEST_ARROW / _pixels(camera, now.points[-1], 1.0) * force / largest
        start, tip = camera.pixels(np.stack([now.points[-1] - back, now.points[-1]]))
        if np.hypot(*(tip - start)) > 1.0:
            paint_force(canvas, start, tip, float(np.linalg.norm(force)))
    errors = magnified(*(in_space(trace[:, row, :axes]) for row in (TIP, TIP_REFERENCE)))
    paint_error(canvas, camera.pixels(errors))
    _paint_footer(canvas, floor.square, bool(robot.arrays.gravity.any()))


def _paint_links(canvas: Canvas, camera: Camera, now: Poses, thickness: float) -> None:
    """Paint links and joints of a pose, far ones first."""
    places, widths = camera.pixels(now.points), _pixels(camera, now.points, thickness)
    widths = widths * np.linspace(1.0, THINNEST, len(widths))
    depth = camera.depth(now.points)
    canvas.polygon(camera.pixels(now.points[0] + 1.3 * thickness * _circle(now.axes[0])), INK)
    for k in np.argsort(-0.5 * (depth[1:] + depth[:-1])):
        width = 0.5 * (widths[k] + widths[k + 1])
        canvas.line(places[k : k + 2], width + 4.0, INK)
        canvas.line(places[k : k + 2], width, STEEL)
    for joint in np.argsort(-depth[1:-1]):
        end = 0.6 * thickness * now.axes[joint]
        ends = np.stack([now.points[joint + 1] - end, now.points[joint + 1] + end])
        near = camera.pixels(ends[np.argmin(camera.depth(ends))])
        canvas.line(camera.pixels(ends), 0.95 * widths[joint + 1], INK)
        canvas.disc(near, 0.25 * widths[joint + 1], PAPER)


def _circle(axis: np.ndarray) -> np.ndarray:
    """Return corners (n, 3) of a circle of radius 1 about an axis (3,)."""
    first = np.cross(axis, np.eye(len(axis))[np.argmin(np.abs(axis))])
    first, angles = first / np.linalg.norm(first), np.linspace(0.0, 2.0 * np.pi, 49)[:, np.newaxis]
    return np.asarray(np.cos(angles) * first + np.sin(angles) * np.cross(axis, first))


def _pixels(camera: Camera, points: np.ndarray, length: float) -> np.ndarray:
    """Return how long a length [m] across the line of sight is seen at points (..., 3) [m], (...) [px]."""
    return np.asarray(length * camera.focal / camera.depth(points))


def _carried(robot: Robot, at: str, q: np.ndarray) -> np.ndarray:
    """Return the place (3,) [m] of a payload at the tip or at the mass center of the last link, at angles q (n,)."""
    links, last = frames(robot, q), robot.arrays
    place = last.tip if at == "tip" else last.center[-1]
    return np.asarray(links.origin[-1] + links.rotation[-1] @ place)


def _paint_footer(canvas: Canvas, square: float, falls: bool) -> None:
    """Paint the footer with the size of the floor's squares [m], on top of the arm."""
    paint_footer(canvas, "shadow", falls)
    canvas.text(f"squares of {1e3 * square:g} mm", "midright", (WIDTH - 28.0, HEIGHT - 0.5 * FOOTER))
