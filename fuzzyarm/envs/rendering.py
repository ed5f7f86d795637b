"""Pictures of an arm for `render_mode`, drawn in software with pygame; only the mode ``human`` needs a display.

What was seen of an episode so far, and the pictures of it.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pygame
from gymnasium.error import ResetNeeded

from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.pictures import HEIGHT, PAPER, WIDTH, Canvas, paint_header, paint_in_plane, paint_in_space
from fuzzyarm.envs.scenario.cases import CASES, Case, case_for
from fuzzyarm.envs.scenario.disturbances import Disturbance

__all__ = ["Film", "Renderer", "case_title", "paint"]


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


class Film:
    """The trace of an episode; what draws it is made for the first picture, and left behind by copies and pickles.

    Args:
        in_window: whether pictures are shown in a window, as they become due.
        fps: how many per second of wall-clock time.
        control_period: [s].
        parameters: the arm.
    """

    def __init__(self, in_window: bool, fps: int, control_period: float, parameters: AnyArm) -> None:
        """Begin without a trace; nothing is loaded yet."""
        self._in_window, self._fps, self._parameters = in_window, fps, parameters
        self._steps_per_frame = max(1, round(1.0 / (fps * control_period)))
        self._trace: list[np.ndarray] = []
        self._time = 0.0
        self._renderer: Any = None

    def rewind(self) -> None:
        """Forget the trace: an episode begins."""
        self._trace.clear()

    def follow(self, time: float, vectors: np.ndarray, schedule: Schedule, ended: bool) -> None:
        """Add an instant to the trace, and draw if a frame of the window is due.

        Args:
            time: of the episode [s].
            vectors: (9, 2) or as the `Layout` of the arm has them, the `VECTORS` at that time.
            schedule: of the episode.
            ended: whether the episode ends there.
        """
        self._time = time
        self._trace.append(vectors)
        if self._in_window and (ended or (len(self._trace) - 1) % self._steps_per_frame == 0):
            self.picture(schedule)

    def picture(self, schedule: Schedule) -> np.ndarray | None:
        """Return the picture (H, W, 3) of the last instant, or show it in the window.

        Raises:
            gymnasium.error.ResetNeeded: no episode has begun.
        """
        if not self._trace:
            raise ResetNeeded("nothing to draw before the first env.reset()")
        if self._renderer is None:
            # Imported here: a training run never loads pygame.
            from fuzzyarm.envs.rendering import Renderer

            self._renderer = Renderer(self._in_window, self._fps)
        picture: np.ndarray | None = self._renderer.draw(schedule, np.array(self._trace), self._time, self._parameters)
        return picture

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave behind what draws: surfaces, fonts and a window are no data."""
        return {**self.__dict__, "_renderer": None}
