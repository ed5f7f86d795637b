"""Pictures of the arm for `render_mode`, drawn in software with pygame; only the mode ``human`` needs a display.

The frame is that of (26), turned so that gravity points down the picture: right = y, down = x.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pygame
from numpy.typing import ArrayLike

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance

__all__ = ["Canvas", "Renderer", "View", "case_title", "magnified", "paint", "thinned"]

MAGNIFICATION = 25  # factor by which the trace magnifies the tip error: a millimetre would be less than a pixel

# Layout [px]. The arm stays in the field between header and footer, `MARGIN` away from its edges: room for the
# thickness of the links, the force arrow and its label.
WIDTH, HEIGHT, HEADER, FOOTER, MARGIN = 720, 720, 80, 56, 90
LONGEST_ARROW = 60  # at the largest force of the episode
SUPERSAMPLING = 2

# Okabe and Ito's palette and greys, all of different lightness.
Colour = tuple[int, int, int]
PAPER, REACH, FRAME = (255, 255, 255), (240, 243, 246), (214, 220, 226)
INK, STEEL, REFERENCE = (38, 50, 62), (178, 194, 208), (156, 166, 176)
TRACE, FORCE, PAYLOAD = (213, 94, 0), (0, 114, 178), (240, 228, 66)
SMALL, LARGE = 22, 34  # font heights

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


class Renderer:
    """Draws frames, and shows them in a window if `human`, `fps` per second of wall-clock time."""

    def __init__(self, human: bool, fps: float) -> None:
        """Open the window if `human`; otherwise pygame's video module stays untouched."""
        self._human, self._fps, self._clock = human, fps, pygame.time.Clock()
        self._canvas = Canvas()
        if human:
            pygame.display.init()
            pygame.display.set_caption("FuzzyArm-v0")
            pygame.display.set_mode((WIDTH, HEIGHT))

    def draw(self, schedule: Schedule, trace: np.ndarray, time: float, parameters: ArmParameters) -> np.ndarray | None:
        """Draw the current state and the trace so far; return a new array (720, 720, 3) of uint8.

        In mode ``human`` the picture is shown in the window instead, and None is returned; a closed window stays
        closed.

        Args:
            schedule: of the episode under way.
            trace: (k + 1, 9, 2), the `VECTORS` at t_0..t_k.
            time: t_k [s].
            parameters: the arm.
        """
        if not self._human:
            paint(self._canvas, schedule, trace, time, parameters)
            return np.ascontiguousarray(pygame.surfarray.array3d(self._canvas.picture()).transpose(1, 0, 2))
        window = self._window()
        if window is not None:
            paint(self._canvas, schedule, trace, time, parameters)
            window.blit(self._canvas.picture(), (0, 0))
            pygame.display.flip()
            self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._human:
            pygame.display.quit()

    def _window(self) -> pygame.Surface | None:
        """Return the surface of the window, or None if the user has closed it."""
        if pygame.display.get_init() and any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
        return pygame.display.get_surface()


class Canvas:
    """Antialiased discs, lines, arrows and text; places (2,) and lengths in units of pixels of the finished picture."""

    def __init__(self) -> None:
        """Make a surface in memory and load pygame's own font."""
        pygame.font.init()
        self.surface = pygame.Surface((SUPERSAMPLING * WIDTH, SUPERSAMPLING * HEIGHT), depth=32)
        self._fonts = {size: pygame.font.Font(None, SUPERSAMPLING * size) for size in (SMALL, LARGE)}

    def picture(self) -> pygame.Surface:
        """Return what was drawn, scaled down to the size of the picture."""
        return pygame.transform.smoothscale(self.surface, (WIDTH, HEIGHT))

    def disc(self, center: np.ndarray, radius: float, colour: Colour) -> None:
        """Fill a disc."""
        pygame.draw.circle(self.surface, colour, np.rint(SUPERSAMPLING * center), SUPERSAMPLING * radius)

    def polygon(self, points: np.ndarray, colour: Colour) -> None:
        """Fill a polygon with corners (n, 2)."""
        pygame.draw.polygon(self.surface, colour, np.rint(SUPERSAMPLING * points))

    def line(self, points: np.ndarray, width: float, colour: Colour) -> None:
        """Draw a polyline through (n, 2) with round ends and corners; a single point gives a dot."""
        points = thinned(points)
        start, end = points[:-1], points[1:]
        along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1, keepdims=True), 1e-9)
        side = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], axis=-1)
        for corners in np.stack([start + side, end + side, end - side, start - side], axis=1):
            self.polygon(corners, colour)
        for point in points:
            self.disc(point, 0.5 * width, colour)

    def arrow(self, start: np.ndarray, end: np.ndarray, width: float, colour: Colour) -> None:
        """Draw an arrow with a head 3 widths long; a shorter arrow is thinner in proportion."""
        length = np.hypot(*(end - start))
        width, along = min(width, length / 3.0), (end - start) / length
        across, neck = np.array([-along[1], along[0]]), end - 3.0 * width * along
        self.line(np.stack([start, neck]), width, colour)
        self.polygon(np.stack([end, neck + 1.6 * width * across, neck - 1.6 * width * across]), colour)

    def text(self, text: str, anchor: str, at: ArrayLike, size: int = SMALL, colour: Colour = INK) -> None:
        """Write `text` with a white rim; `anchor` names the point of its box that lies `at`, such as "midleft"."""
        font, position = self._fonts[size], SUPERSAMPLING * np.array(at)
        rim, glyphs = font.render(text, True, PAPER), font.render(text, True, colour)
        for angle in np.arange(8) * np.pi / 4.0:
            self.surface.blit(rim, rim.get_rect(**{anchor: position + 3.0 * np.array([np.cos(angle), np.sin(angle)])}))
        self.surface.blit(glyphs, glyphs.get_rect(**{anchor: position}))


def paint(canvas: Canvas, schedule: Schedule, trace: np.ndarray, time: float, parameters: ArmParameters) -> None:
    """Paint the whole picture; arguments in the shapes and units of `Renderer.draw`."""
    length = parameters.length
    q = np.concatenate([schedule.references[:, :2], trace[:, LINK]])
    elbow, tip = tip_position(q, (length[0], 0.0)), tip_position(q, length)
    # The view contains the base, the reference and all poses so far, so it widens only if the arm leaves it.
    view = View.fit(np.concatenate([np.zeros((1, 2)), elbow, tip]))
    joints = view.pixels(np.stack([np.zeros(2), elbow[-1], tip[-1]]))
    canvas.surface.fill(PAPER)
    canvas.disc(view.base, view.scale * sum(length), REACH)
    canvas.disc(view.base, view.scale * abs(length[0] - length[1]), PAPER)
    canvas.line(view.pixels(schedule.targets[:, :2]), 5.0, REFERENCE)
    _paint_arm(canvas, joints, 0.032 * view.scale * sum(length))
    payload = schedule.disturbance.payload
    if payload.mass > 0.0:
        along = payload.radius(parameters) / length[1]
        _paint_payload(canvas, joints[1] + along * (joints[2] - joints[1]), payload.mass)
    _paint_force(canvas, joints[2], trace[-1, FORCE_ROW], np.linalg.norm(schedule.forces, axis=1).max())
    errors = view.pixels(magnified(trace))
    for rim, colour in ((1.5, PAPER), (0.0, TRACE)):
        canvas.line(errors, 3.0 + 2.0 * rim, colour)
        canvas.disc(errors[-1], 6.0 + rim, colour)
    _paint_header(
        canvas, case_title(schedule.disturbance), time, float(np.hypot(*(trace[-1, TIP] - trace[-1, TIP_REFERENCE])))
    )
    _paint_footer(canvas, view.scale)


def thinned(points: np.ndarray) -> np.ndarray:
    """Return the points (n, 2) [px] of a polyline about 2 px apart, both ends included."""
    travelled = np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T))
    keep = np.diff(travelled // 2.0, prepend=-1.0) > 0.0
    keep[-1] = True
    return points[keep]


def magnified(trace: np.ndarray) -> np.ndarray:
    """Return reference + 25 (tip - reference), (n, 2) [m], of a trace (n, 9, 2) of the `VECTORS`."""
    tip, reference = trace[:, TIP], trace[:, TIP_REFERENCE]
    return np.asarray(reference + MAGNIFICATION * (tip - reference))


def case_title(disturbance: Disturbance) -> str:
    """Return the title of the case that has this disturbance."""
    return next((case.title for case in CASES.values() if case.disturbance == disturbance), "custom disturbance")


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


def _paint_payload(canvas: Canvas, center: np.ndarray, mass: float) -> None:
    """Paint a disc whose volume grows with the mass [kg]."""
    radius = min(max(9.0 * mass ** (1.0 / 3.0), 8.0), 28.0)
    canvas.disc(center, radius + 2.5, INK)
    canvas.disc(center, radius, PAYLOAD)
    canvas.text(f"{mass:g} kg", "midleft", center + np.array([radius + 8.0, 0.0]))


def _paint_force(canvas: Canvas, tip: np.ndarray, force: np.ndarray, largest: float) -> None:
    """Paint the force (x, y) [N] pushing the tip [px], the arrow scaled by the `largest` force of the episode [N]."""
    magnitude = float(np.hypot(*force))
    if magnitude == 0.0:
        return
    start = tip - LONGEST_ARROW * force[::-1] / largest
    canvas.arrow(start, tip, 7.0, FORCE)
    label = np.clip(start - 26.0 * force[::-1] / magnitude, [32, HEADER + 12], [WIDTH - 32, HEIGHT - FOOTER - 12])
    canvas.text(f"{magnitude:.0f} N", "center", label, colour=FORCE)


def _paint_header(canvas: Canvas, title: str, time: float, tip_error: float) -> None:
    """Paint title, time [s] and tip error [m], on top of parts of the arm that leave the field."""
    canvas.line(np.array([[0.0, 0.5 * HEADER], [WIDTH, 0.5 * HEADER]]), HEADER, PAPER)
    canvas.line(np.array([[0.0, HEADER], [WIDTH, HEADER]]), 1.0, FRAME)
    canvas.text(title, "midleft", (28.0, 41.0), LARGE)
    canvas.text(f"t = {time:.3f} s", "midright", (WIDTH - 28.0, 29.0))
    canvas.text(f"tip error {1e3 * tip_error:.2f} mm", "midright", (WIDTH - 28.0, 53.0))


def _paint_footer(canvas: Canvas, scale: float) -> None:
    """Paint the legend, the direction of gravity and a scale bar of 10^n m, at most 120 px long, on top of the arm."""
    top, middle, right = HEIGHT - FOOTER, HEIGHT - 0.5 * FOOTER, WIDTH - 28.0
    canvas.line(np.array([[0.0, middle], [WIDTH, middle]]), FOOTER, PAPER)
    canvas.line(np.array([[0.0, top], [WIDTH, top]]), 1.0, FRAME)
    legend = ((28.0, REFERENCE, 4.0, "reference"), (150.0, TRACE, 4.0, f"tip error × {MAGNIFICATION}"))
    for left, colour, width, label in (*legend, (304.0, REACH, 14.0, "reach")):
        canvas.line(np.array([[left, middle], [left + 20.0, middle]]), width, colour)
        canvas.text(label, "midleft", (left + 34.0, middle))
    canvas.arrow(np.array([440.0, middle - 14.0]), np.array([440.0, middle + 14.0]), 3.0, INK)
    canvas.text("gravity", "midleft", (452.0, middle))
    bar = 10.0 ** np.floor(np.log10(120.0 / scale))
    canvas.line(np.array([[right - bar * scale, middle], [right, middle]]), 4.0, INK)
    canvas.text(f"{1e3 * bar:g} mm", "midright", (right - bar * scale - 12.0, middle))
