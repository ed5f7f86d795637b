"""Pictures of an arm for `render_mode`, drawn in software with pygame; only the mode ``human`` needs a display."""

from __future__ import annotations

import functools

import numpy as np
import pygame

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.pictures import HEIGHT, PAPER, WIDTH, Canvas, paint_header, paint_in_plane, paint_in_space
from fuzzyarm.envs.scenario.cases import CASES, Case, case_for
from fuzzyarm.envs.scenario.disturbances import Disturbance

__all__ = ["Renderer", "case_title", "paint"]


TIP, TIP_REFERENCE = map(VECTORS.index, ("tip", "tip_reference"))  # columns of the trace


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

    def draw(self, schedule: Schedule, trace: np.ndarray, time: float, arm: AnyArm) -> np.ndarray | None:
        """Draw the current state and the trace so far; return a new array (720, 720, 3) of uint8.

        In mode ``human`` the picture is shown in the window instead, and None is returned; a closed window stays
        closed.

        Args:
            schedule: of the episode under way.
            trace: (k + 1, 9, 2), or as many columns as the `Layout` of the arm has, the `VECTORS` at t_0..t_k.
            time: t_k [s].
            arm: the one that is drawn.
        """
        if not self._human:
            paint(self._canvas, schedule, trace, time, arm)
            return np.ascontiguousarray(pygame.surfarray.array3d(self._canvas.picture()).transpose(1, 0, 2))
        window = self._window()
        if window is not None:
            paint(self._canvas, schedule, trace, time, arm)
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


def paint(canvas: Canvas, schedule: Schedule, trace: np.ndarray, time: float, arm: AnyArm) -> None:
    """Paint the whole picture; arguments in the shapes and units of `Renderer.draw`."""
    canvas.surface.fill(PAPER)
    if isinstance(arm, ArmParameters):
        paint_in_plane(canvas, schedule, trace, arm)
    else:
        paint_in_space(canvas, schedule, trace, arm)
    deviation = trace[-1, TIP] - trace[-1, TIP_REFERENCE]
    error = float(np.linalg.norm(deviation[: schedule.axes]))
    paint_header(canvas, case_title(schedule.disturbance, arm), time, error)


def case_title(disturbance: Disturbance, arm: AnyArm) -> str:
    """Return the title of the case that has this disturbance, with the loads for an arm."""
    cases = (_case(arm, name) for name in CASES)
    return next((case.title for case in cases if case and case.disturbance == disturbance), "custom disturbance")


@functools.lru_cache(maxsize=64)
def _case(arm: AnyArm, name: str) -> Case | None:
    """Return a case for an arm; None for an arm that can follow no default reference, to which no load is scaled."""
    try:
        return case_for(name, arm)
    except ValueError:
        return None
