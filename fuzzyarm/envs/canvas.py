"""What pictures of arms are made of, drawn in software with pygame: shapes, text, header and footer."""

from __future__ import annotations

import numpy as np
import pygame
from numpy.typing import ArrayLike

__all__ = [
    "Canvas", "Colour", "magnified", "paint_error", "paint_footer", "paint_force", "paint_header", "paint_payload",
    "thinned",
]  # fmt: skip

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


def thinned(points: np.ndarray) -> np.ndarray:
    """Return the points (n, 2) [px] of a polyline about 2 px apart, both ends included."""
    travelled = np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T))
    keep = np.diff(travelled // 2.0, prepend=-1.0) > 0.0
    keep[-1] = True
    return points[keep]


def magnified(tip: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return reference + 25 (tip - reference) [m], of points of any shape."""
    return np.asarray(reference + MAGNIFICATION * (tip - reference))


def paint_error(canvas: Canvas, errors: np.ndarray) -> None:
    """Paint the trace of the magnified tip (n, 2) [px], and where it is now."""
    for rim, colour in ((1.5, PAPER), (0.0, TRACE)):
        canvas.line(errors, 3.0 + 2.0 * rim, colour)
        canvas.disc(errors[-1], 6.0 + rim, colour)


def paint_payload(canvas: Canvas, center: np.ndarray, mass: float) -> None:
    """Paint a disc whose volume grows with the mass [kg]."""
    radius = min(max(9.0 * mass ** (1.0 / 3.0), 8.0), 28.0)
    canvas.disc(center, radius + 2.5, INK)
    canvas.disc(center, radius, PAYLOAD)
    canvas.text(f"{mass:g} kg", "midleft", center + np.array([radius + 8.0, 0.0]))


def paint_force(canvas: Canvas, start: np.ndarray, tip: np.ndarray, magnitude: float) -> None:
    """Paint the arrow of a force of this magnitude [N] that pushes the tip, from start (2,) to tip (2,) [px]."""
    canvas.arrow(start, tip, 7.0, FORCE)
    label = start + 26.0 * (start - tip) / np.hypot(*(start - tip))
    inside = np.clip(label, [32, HEADER + 12], [WIDTH - 32, HEIGHT - FOOTER - 12])
    canvas.text(f"{magnitude:.0f} N", "center", inside, colour=FORCE)


def paint_header(canvas: Canvas, title: str, time: float, tip_error: float) -> None:
    """Paint title, time [s] and tip error [m], on top of parts of the arm that leave the field."""
    canvas.line(np.array([[0.0, 0.5 * HEADER], [WIDTH, 0.5 * HEADER]]), HEADER, PAPER)
    canvas.line(np.array([[0.0, HEADER], [WIDTH, HEADER]]), 1.0, FRAME)
    canvas.text(title, "midleft", (28.0, 41.0), LARGE)
    canvas.text(f"t = {time:.3f} s", "midright", (WIDTH - 28.0, 29.0))
    canvas.text(f"tip error {1e3 * tip_error:.2f} mm", "midright", (WIDTH - 28.0, 53.0))


def paint_footer(canvas: Canvas, ground: str, falls: bool = True) -> None:
    """Paint the legend, with what grey `ground` is, and the direction of gravity if there is any, on top of the arm."""
    top, middle = HEIGHT - FOOTER, HEIGHT - 0.5 * FOOTER
    canvas.line(np.array([[0.0, middle], [WIDTH, middle]]), FOOTER, PAPER)
    canvas.line(np.array([[0.0, top], [WIDTH, top]]), 1.0, FRAME)
    legend = ((28.0, REFERENCE, 4.0, "reference"), (150.0, TRACE, 4.0, f"tip error × {MAGNIFICATION}"))
    for left, colour, width, label in (*legend, (304.0, REACH, 14.0, ground)):
        canvas.line(np.array([[left, middle], [left + 20.0, middle]]), width, colour)
        canvas.text(label, "midleft", (left + 34.0, middle))
    if falls:
        canvas.arrow(np.array([440.0, middle - 14.0]), np.array([440.0, middle + 14.0]), 3.0, INK)
        canvas.text("gravity", "midleft", (452.0, middle))
