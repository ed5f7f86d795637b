"""What was seen of an episode so far, and the pictures of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded

from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm

__all__ = ["Film"]


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
