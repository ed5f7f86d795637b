"""Pictures of arms, drawn in software with pygame: the two-joint arm in its plane, any other robot in perspective.

The plane has the frame of the paper's equation (26), turned so that gravity points down the picture: right = y,
down = x.
"""

import functools
from collections.abc import Callable

import numpy as np
import pygame
from numpy.typing import ArrayLike

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.perspective import Camera, Poses, across, floor_of, in_space, looking_at, poses_of
from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import CASES, Case, case_for
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.kinematics import reach

__all__ = ["Canvas", "paint"]

_MAGNIFICATIONS = (25, 10, 5, 2, 1)
"""Factors by which the trace magnifies the tip error, since a millimetre would be less than a pixel.

The first factor with which the trace stays in the field is used; with the last, 1, the trace is the tip's path.
"""

# Layout [px]. The arm stays in the field between header and footer, `_MARGIN` away from its edges: room for the
# thickness of the links, the force arrow and its label.
WIDTH, HEIGHT, HEADER, FOOTER, _MARGIN = 720, 720, 80, 56, 90
_LONGEST_ARROW = 60  # at the largest force of the episode
_DOT = 8  # radius of the dot at the end of the trace
_SUPERSAMPLING = 2

# Okabe and Ito's palette and greys, all of different lightness.
_Colour = tuple[int, int, int]
_PAPER, _REACH, _FRAME = (255, 255, 255), (240, 243, 246), (214, 220, 226)
INK, _STEEL, REFERENCE = (38, 50, 62), (178, 194, 208), (156, 166, 176)
TRACE, FORCE, PAYLOAD = (213, 94, 0), (0, 114, 178), (240, 228, 66)
_SMALL, _LARGE = 22, 34  # font heights


class Canvas:
    """Antialiased discs, lines, arrows and text; positions (2,) and lengths are in pixels of the finished picture."""

    def __init__(self) -> None:
        pygame.font.init()
        self.surface = pygame.Surface((_SUPERSAMPLING * WIDTH, _SUPERSAMPLING * HEIGHT), depth=32)
        self._fonts = {size: pygame.font.Font(None, _SUPERSAMPLING * size) for size in (_SMALL, _LARGE)}

    def picture(self) -> pygame.Surface:
        """Return what was drawn, scaled down to the size of the picture."""
        return pygame.transform.smoothscale(self.surface, (WIDTH, HEIGHT))

    def array(self) -> np.ndarray:
        """Return the picture as a new array (720, 720, 3) of uint8."""
        return np.ascontiguousarray(pygame.surfarray.array3d(self.picture()).transpose(1, 0, 2))

    def disc(self, center: np.ndarray, radius: float, colour: _Colour) -> None:
        """Fill a disc with this center (2,) and radius [px]."""
        pygame.draw.circle(self.surface, colour, np.rint(_SUPERSAMPLING * center), _SUPERSAMPLING * radius)

    def polygon(self, points: np.ndarray, colour: _Colour) -> None:
        """Fill a polygon with these corners (n, 2) [px]."""
        pygame.draw.polygon(self.surface, colour, np.rint(_SUPERSAMPLING * points))

    def line(self, points: np.ndarray, width: float, colour: _Colour) -> None:
        """Draw a polyline through points (n, 2) [px] with round ends and corners; a single point gives a dot."""
        points = _thinned(points)
        start, end = points[:-1], points[1:]
        along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1, keepdims=True), 1e-9)
        side = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], axis=-1)
        for corners in np.stack([start + side, end + side, end - side, start - side], axis=1):
            self.polygon(corners, colour)
        for point in points:
            self.disc(point, 0.5 * width, colour)

    def arrow(self, start: np.ndarray, end: np.ndarray, width: float, colour: _Colour) -> None:
        """Draw an arrow, in pixels, with a head 3 widths long, or thinner if it is shorter than that."""
        length = np.hypot(*(end - start))
        width, along = min(width, length / 3.0), (end - start) / length
        across, neck = np.array([-along[1], along[0]]), end - 3.0 * width * along
        self.line(np.stack([start, neck]), width, colour)
        self.polygon(np.stack([end, neck + 1.6 * width * across, neck - 1.6 * width * across]), colour)

    def text(self, text: str, anchor: str, at: ArrayLike, size: int = _SMALL, colour: _Colour = INK) -> None:
        """Write `text` with a white rim, so that the point `anchor` of its box, such as "midleft", lies at `at`."""
        font, position = self._fonts[size], _SUPERSAMPLING * np.array(at)
        rim, glyphs = font.render(text, True, _PAPER), font.render(text, True, colour)
        for angle in np.arange(8) * np.pi / 4.0:
            self.surface.blit(rim, rim.get_rect(**{anchor: position + 3.0 * np.array([np.cos(angle), np.sin(angle)])}))
        self.surface.blit(glyphs, glyphs.get_rect(**{anchor: position}))


def _thinned(points: np.ndarray) -> np.ndarray:
    """Return the points (n, 2) [px] of a polyline about 2 px apart, both ends included."""
    travelled = np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T))
    keep = np.diff(travelled // 2.0, prepend=-1.0) > 0.0
    keep[-1] = True
    return points[keep]


def _paint_error(
    canvas: Canvas, pixels: Callable[[np.ndarray], np.ndarray], tip: np.ndarray, reference: np.ndarray
) -> int:
    """Paint a trace (n, 2 or 3) [m], which `pixels` maps to px, with magnified tip error; return the magnification."""
    low, high = np.array([[_DOT, HEADER + _DOT], [WIDTH - _DOT, HEIGHT - FOOTER - _DOT]])
    for factor in _MAGNIFICATIONS:
        errors = pixels(reference + factor * (tip - reference))
        if np.all((low <= errors) & (errors <= high)):
            break
    for rim, colour in ((1.5, _PAPER), (0.0, TRACE)):
        canvas.line(errors, 3.0 + 2.0 * rim, colour)
        canvas.disc(errors[-1], 6.0 + rim, colour)
    return factor


def _paint_payload(canvas: Canvas, center: np.ndarray, mass: float) -> None:
    """Paint a disc at `center` (2,) [px] whose radius grows with the cube root of the mass [kg]."""
    radius = min(max(9.0 * mass ** (1.0 / 3.0), 8.0), 28.0)
    canvas.disc(center, radius + 2.5, INK)
    canvas.disc(center, radius, PAYLOAD)
    canvas.text(f"{mass:g} kg", "midleft", center + np.array([radius + 8.0, 0.0]))


def _paint_force(canvas: Canvas, start: np.ndarray, tip: np.ndarray, magnitude: float) -> None:
    """Paint the arrow of a tip force of this magnitude [N], from start (2,) to tip (2,) [px]."""
    canvas.arrow(start, tip, 7.0, FORCE)
    label = start + 26.0 * (start - tip) / np.hypot(*(start - tip))
    inside = np.clip(label, [32, HEADER + 12], [WIDTH - 32, HEIGHT - FOOTER - 12])
    canvas.text(f"{magnitude:.0f} N", "center", inside, colour=FORCE)


def _paint_header(canvas: Canvas, title: str, time: float, tip_error: float) -> None:
    """Paint title, time [s] and tip error [m], on top of any part of the arm that reaches into the header."""
    canvas.line(np.array([[0.0, 0.5 * HEADER], [WIDTH, 0.5 * HEADER]]), HEADER, _PAPER)
    canvas.line(np.array([[0.0, HEADER], [WIDTH, HEADER]]), 1.0, _FRAME)
    canvas.text(title, "midleft", (28.0, 41.0), _LARGE)
    canvas.text(f"t = {time:.3f} s", "midright", (WIDTH - 28.0, 29.0))
    canvas.text(f"tip error {1e3 * tip_error:.2f} mm", "midright", (WIDTH - 28.0, 53.0))


def _paint_footer(canvas: Canvas, factor: int, ground: str, falls: bool = True) -> None:
    """Paint the legend and, if `falls`, the direction of gravity, on top of any part of the arm that is there.

    The legend states by which factor the error is magnified, and what the grey `ground` is.
    """
    top, middle = HEIGHT - FOOTER, HEIGHT - 0.5 * FOOTER
    canvas.line(np.array([[0.0, middle], [WIDTH, middle]]), FOOTER, _PAPER)
    canvas.line(np.array([[0.0, top], [WIDTH, top]]), 1.0, _FRAME)
    legend = ((28.0, REFERENCE, 4.0, "reference"), (150.0, TRACE, 4.0, f"tip error × {factor}"))
    for left, colour, width, label in (*legend, (304.0, _REACH, 14.0, ground)):
        canvas.line(np.array([[left, middle], [left + 20.0, middle]]), width, colour)
        canvas.text(label, "midleft", (left + 34.0, middle))
    if falls:
        canvas.arrow(np.array([440.0, middle - 14.0]), np.array([440.0, middle + 14.0]), 3.0, INK)
        canvas.text("gravity", "midleft", (452.0, middle))


# Rows of the trace.
_TIP, _TIP_REFERENCE, _LINK, _FORCE_ROW = map(VECTORS.index, ("tip", "tip_reference", "q_link", "external_force"))


def paint(canvas: Canvas, schedule: Schedule, trace: np.ndarray, time: float, arm: AnyArm) -> None:
    """Paint the whole picture of an arm at a time [s] of the episode with this schedule.

    The trace (instants, 9, `Layout.longest`) has the nine `VECTORS` at each instant of the episode up to this time.
    """
    canvas.surface.fill(_PAPER)
    if isinstance(arm, ArmParameters):
        _paint_in_plane(canvas, schedule, trace, arm)
    else:
        _paint_in_space(canvas, schedule, trace, arm)
    deviation = trace[-1, _TIP] - trace[-1, _TIP_REFERENCE]
    error = float(np.linalg.norm(deviation[: schedule.axes]))
    _paint_header(canvas, _case_title(schedule.disturbance, arm), time, error)


def _case_title(disturbance: Disturbance, arm: AnyArm) -> str:
    """Return the title of the case that has this disturbance for this arm, or "custom disturbance" without a match."""
    cases = (_case(arm, name) for name in CASES)
    return next((case.title for case in cases if case and case.disturbance == disturbance), "custom disturbance")


@functools.lru_cache(maxsize=64)
def _case(arm: AnyArm, name: str) -> Case | None:
    """Return the case `name` with loads for an arm; None if the arm cannot follow the reference that sets the loads."""
    try:
        return case_for(name, arm)
    except ValueError:
        return None


def _paint_in_plane(canvas: Canvas, schedule: Schedule, trace: np.ndarray, parameters: ArmParameters) -> None:
    """Paint the two-joint arm in its plane, and the footer; arguments in the shapes and units of `paint`."""
    length = parameters.length
    q = np.concatenate([schedule.references[:, :2], trace[:, _LINK]])
    elbow, tip = tip_position(q, (length[0], 0.0)), tip_position(q, length)
    # The view contains the base, the reference and all poses so far, so it widens only if the arm leaves it.
    seen = np.concatenate([np.zeros((1, 2)), elbow, tip])[:, ::-1]
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = np.array([WIDTH, HEIGHT - HEADER - FOOTER]) - 2.0 * _MARGIN
    scale = float(np.min(room / np.maximum(high - low, 1e-6)))  # px/m, as large as the field allows
    base = 0.5 * (np.array([WIDTH, HEIGHT + HEADER - FOOTER]) - scale * (low + high))

    def pixels(points: np.ndarray) -> np.ndarray:
        """Return (right, down) = base + scale (y, x) [px] of points (..., 2) [m]."""
        return np.asarray(base + scale * points[..., ::-1])

    joints = pixels(np.stack([np.zeros(2), elbow[-1], tip[-1]]))
    canvas.disc(base, scale * sum(length), _REACH)
    canvas.disc(base, scale * abs(length[0] - length[1]), _PAPER)
    canvas.line(pixels(schedule.targets[:, :2]), 5.0, REFERENCE)
    _paint_arm(canvas, joints, 0.032 * scale * sum(length))
    payload, force = schedule.disturbance.payload, trace[-1, _FORCE_ROW]
    if payload.mass > 0.0:
        along = payload.radius(parameters) / length[1]
        _paint_payload(canvas, joints[1] + along * (joints[2] - joints[1]), payload.mass)
    if force.any():
        back = _LONGEST_ARROW * force[::-1] / np.linalg.norm(schedule.forces, axis=1).max()
        _paint_force(canvas, joints[2] - back, joints[2], float(np.hypot(*force)))
    factor = _paint_error(canvas, pixels, trace[:, _TIP], trace[:, _TIP_REFERENCE])
    _paint_footer(canvas, factor, "reach")
    middle, right = HEIGHT - 0.5 * FOOTER, WIDTH - 28.0
    bar = 10.0 ** np.floor(np.log10(120.0 / scale))  # m, a scale bar of at most 120 px
    canvas.line(np.array([[right - bar * scale, middle], [right, middle]]), 4.0, INK)
    canvas.text(f"{1e3 * bar:g} mm", "midright", (right - bar * scale - 12.0, middle))


def _paint_arm(canvas: Canvas, joints: np.ndarray, thickness: float) -> None:
    """Paint the mounting and the links through base, elbow and tip (3, 2) [px]."""
    base, elbow, tip = joints
    canvas.polygon(base + thickness * np.array([[-0.6, 0.0], [-1.1, -1.9], [1.1, -1.9], [0.6, 0.0]]), INK)
    canvas.line(base + thickness * np.array([[-1.7, -1.9], [1.7, -1.9]]), 6.0, INK)
    for start, end, width in ((base, elbow, thickness), (elbow, tip, 0.75 * thickness)):
        canvas.line(np.stack([start, end]), width + 4.0, INK)
        canvas.line(np.stack([start, end]), width, _STEEL)
    for joint, radius in ((base, 0.6 * thickness), (elbow, 0.55 * thickness)):
        canvas.disc(joint, radius, INK)
        canvas.disc(joint, 0.45 * radius, _PAPER)


_EVERY = 10  # instants between the poses that the view must contain
_THICKNESS, _THINNEST = 0.055, 0.6  # first link, as share of the reach; last link, as share of the first


def _paint_in_space(canvas: Canvas, schedule: Schedule, trace: np.ndarray, robot: Robot) -> None:
    """Paint a robot in perspective, and the footer; arguments in the shapes and units of `paint`."""
    joints, axes = len(robot), schedule.axes
    path, force = in_space(schedule.targets[:, :axes]), in_space(trace[-1, _FORCE_ROW, :axes])
    asked = poses_of(robot, schedule.references[::_EVERY, :joints])
    been = poses_of(robot, np.concatenate([trace[::_EVERY, _LINK, :joints], trace[-1:, _LINK, :joints]]))
    floor, now = floor_of(robot, asked.points), Poses(been.points[-1], been.axes[-1])
    # The view contains the base, the reference and the poses so far, so it widens only if the arm leaves it.
    seen = np.concatenate([poses.points.reshape(-1, path.shape[-1]) for poses in (asked, been)])
    corners = np.array([[_MARGIN, HEADER + _MARGIN], [WIDTH - _MARGIN, HEIGHT - FOOTER - _MARGIN]], dtype=float)
    camera = looking_at(robot, path).fitted(np.concatenate([seen, floor.below(asked.points[0])]), *corners)
    for line in floor.grid:
        canvas.line(camera.pixels(line), 1.0, _FRAME)
    thickness = _THICKNESS * reach(robot)
    canvas.line(camera.pixels(floor.below(now.points)), 0.6 * _pixels(camera, now.points, thickness).mean(), _REACH)
    canvas.line(camera.pixels(floor.below(path)), 2.0, _REACH)
    canvas.line(camera.pixels(path), 5.0, REFERENCE)
    _paint_links(canvas, camera, now, thickness)
    payload = schedule.disturbance.payload
    if payload.mass > 0.0:
        _paint_payload(canvas, camera.pixels(_carried(robot, payload.at, trace[-1, _LINK, :joints])), payload.mass)
    if force.any():
        largest = np.linalg.norm(schedule.forces[:, :axes], axis=1).max()
        back = _LONGEST_ARROW / _pixels(camera, now.points[-1], 1.0) * force / largest
        start, tip = camera.pixels(np.stack([now.points[-1] - back, now.points[-1]]))
        if np.hypot(*(tip - start)) > 1.0:
            _paint_force(canvas, start, tip, float(np.linalg.norm(force)))
    factor = _paint_error(canvas, camera.pixels, *(in_space(trace[:, row, :axes]) for row in (_TIP, _TIP_REFERENCE)))
    _paint_footer(canvas, factor, "shadow", bool(robot.arrays.gravity.any()))
    canvas.text(f"squares of {1e3 * floor.square:g} mm", "midright", (WIDTH - 28.0, HEIGHT - 0.5 * FOOTER))


def _paint_links(canvas: Canvas, camera: Camera, now: Poses, thickness: float) -> None:
    """Paint the links, the first one `thickness` [m] wide, and the joints of a pose, far ones first."""
    places, widths = camera.pixels(now.points), _pixels(camera, now.points, thickness)
    widths = widths * np.linspace(1.0, _THINNEST, len(widths))
    depth = camera.depth(now.points)
    canvas.polygon(camera.pixels(now.points[0] + 1.3 * thickness * _circle(now.axes[0])), INK)
    for k in np.argsort(-0.5 * (depth[1:] + depth[:-1])):
        width = 0.5 * (widths[k] + widths[k + 1])
        canvas.line(places[k : k + 2], width + 4.0, INK)
        canvas.line(places[k : k + 2], width, _STEEL)
    for joint in np.argsort(-depth[1:-1]):
        end = 0.6 * thickness * now.axes[joint]
        ends = np.stack([now.points[joint + 1] - end, now.points[joint + 1] + end])
        near = camera.pixels(ends[np.argmin(camera.depth(ends))])
        canvas.line(camera.pixels(ends), 0.95 * widths[joint + 1], INK)
        canvas.disc(near, 0.25 * widths[joint + 1], _PAPER)


def _circle(axis: np.ndarray) -> np.ndarray:
    """Return the corners (n, 3) of a polygon that approximates the unit circle about an axis (3,)."""
    first, angles = across(axis), np.linspace(0.0, 2.0 * np.pi, 49)[:, np.newaxis]
    return np.asarray(np.cos(angles) * first + np.sin(angles) * np.cross(axis, first))


def _pixels(camera: Camera, points: np.ndarray, length: float) -> np.ndarray:
    """Return the picture length (...) [px] of a length [m] across the line of sight, at points (..., 3) [m]."""
    return np.asarray(length * camera.focal / camera.depth(points))


def _carried(robot: Robot, at: str, q: np.ndarray) -> np.ndarray:
    """Return the position (3,) [m] of a payload at the tip or at the mass center of the last link, at angles q (n,)."""
    links, last = frames(robot, q), robot.arrays
    place = last.tip if at == "tip" else last.center[-1]
    return np.asarray(links.origin[-1] + links.rotation[-1] @ place)
