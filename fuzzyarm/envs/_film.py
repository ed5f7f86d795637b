"""The trace of an episode, and pictures of it for the environment; only the mode ``human`` needs a display."""

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded

from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm

__all__ = ["Film"]


class Film:
    """The trace of an arm's episode, and its pictures: as arrays, or in a window at `fps` frames per second.

    The control period is in s.
    """

    def __init__(self, in_window: bool, fps: float, control_period: float, arm: AnyArm) -> None:
        self._in_window, self._fps, self._arm = in_window, fps, arm
        self._steps_per_frame = max(1, round(1.0 / (fps * control_period)))
        self._trace: list[np.ndarray] = []
        self._time = 0.0
        self._canvas: Any = None
        self._clock: Any = None

    def rewind(self) -> None:
        """Clear the trace at the beginning of an episode."""
        self._trace.clear()

    def follow(self, time: float, vectors: np.ndarray, schedule: Schedule, ended: bool) -> None:
        """Add `vectors` (9, `Layout.longest`), in the order of `VECTORS`, at a time [s] to the trace.

        In a window, draw a picture, with the path of `schedule`, if a frame is due or the episode has `ended`.
        """
        self._time = time
        self._trace.append(vectors)
        if self._in_window and (ended or (len(self._trace) - 1) % self._steps_per_frame == 0):
            self.picture(schedule)

    def picture(self, schedule: Schedule) -> np.ndarray | None:
        """Return the picture (720, 720, 3) of uint8, or show it in an open window; ResetNeeded before reset."""
        if not self._trace:
            raise ResetNeeded("there is nothing to draw yet: call env.reset() before env.render()")
        import pygame  # imported here, because a training run never needs it

        from fuzzyarm.envs import _pictures as pictures

        if self._canvas is None:
            self._canvas, self._clock = pictures.Canvas(), pygame.time.Clock()
            if self._in_window:
                pygame.display.init()
                pygame.display.set_caption("FuzzyArm-v0")
                pygame.display.set_mode((pictures.WIDTH, pictures.HEIGHT))
        window: Any = None
        if self._in_window:
            if pygame.display.get_init() and any(event.type == pygame.QUIT for event in pygame.event.get()):
                pygame.display.quit()
            window = pygame.display.get_surface()
            if window is None:
                return None
        pictures.paint(self._canvas, schedule, np.array(self._trace), self._time, self._arm)
        if not self._in_window:
            return np.asarray(self._canvas.array())
        window.blit(self._canvas.picture(), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._canvas is not None and self._in_window:
            import pygame

            pygame.display.quit()
        self._canvas = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without surfaces, fonts and window, which cannot be copied."""
        return {**self.__dict__, "_canvas": None, "_clock": None}
