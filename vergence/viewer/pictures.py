"""Pictures of the task: both eyes' images side by side, and the head from outside."""

from typing import Any, Final

import numpy as np

from vergence.envs.gaze import missing_window_hint
from vergence.envs.reading import Image
from vergence.envs.task import GazeTask
from vergence.errors import RenderingUnavailableError
from vergence.viewer.eye_pictures import BACKGROUND_GREY, draw_eye, write_label
from vergence.viewer.moment import moment_of
from vergence.viewer.painting import HeadPainter

VIEW_HEIGHT: Final = 320
"""Height of the view of the head, px (chosen: detail against size)."""


class TaskPictures:
    """Draws the heads of a task.

    Args:
        task: the task whose heads are drawn.
        mode: `rgb_array` or `human`.
        fps: largest number of pictures per second in the window.
    """

    def __init__(self, task: GazeTask, mode: str, fps: int) -> None:
        self._task = task
        self._mode = mode
        self._fps = fps
        self._painter = HeadPainter(task.head)
        self._window = Window() if mode == "human" else None

    def render(self) -> Image | None:
        """The picture of the first head: returned, or shown in the window."""
        picture = self.picture(0)
        if self._window is None:
            return picture
        self._window.show(picture, self._fps)
        return None

    def picture(self, n: int) -> Image:
        """The picture of one head.

        Args:
            n: environment index.

        Returns:
            (height, width, 3) RGB.
        """
        head, shown = self._task.head, moment_of(self._task, n)
        eyes = [draw_eye(head, shown, eye) for eye in range(2)]
        write_label(eyes[0], f"t = {shown.time_s:.3f} s", (10, len(eyes[0]) - 12))
        highest = max(len(eye) for eye in eyes)
        top = np.concatenate([_padded(eye, highest) for eye in eyes], axis=1)
        below = self._painter.draw(
            shown.positions,
            shown.target,
            top.shape[1],
            VIEW_HEIGHT,
            board=shown.shows_tag,
            fix=shown.fix.point if shown.fix.valid else None,
        )
        return np.concatenate([top, below], axis=0)

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()


class Window:
    """A window through pygame.

    Raises:
        RenderingUnavailableError: pygame is not installed.
    """

    def __init__(self) -> None:
        missing = missing_window_hint()
        if missing is not None:
            raise RenderingUnavailableError(missing)
        import pygame

        self._pygame: Any = pygame
        self._surface: Any = None

    def show(self, picture: Image, fps: int) -> None:
        """Show a picture, at most `fps` a second."""
        pygame = self._pygame
        if self._surface is None:
            pygame.init()
            pygame.display.set_caption("vergence")
            self._surface = pygame.display.set_mode((picture.shape[1], picture.shape[0]))
            self._clock = pygame.time.Clock()
        pygame.event.pump()
        surface = pygame.surfarray.make_surface(np.swapaxes(picture, 0, 1))
        self._surface.blit(surface, (0, 0))
        pygame.display.flip()
        self._clock.tick(fps)

    def close(self) -> None:
        """Close the window."""
        if self._surface is not None:
            self._pygame.quit()
            self._surface = None


def _padded(image: Image, height: int) -> Image:
    """Pad a picture at the bottom with background, to the height of the other eye's."""
    below = ((0, height - len(image)), (0, 0), (0, 0))
    return np.pad(image, below, constant_values=BACKGROUND_GREY)
