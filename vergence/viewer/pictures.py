"""Pictures of the task: both eyes' images side by side, and the head from outside."""

from typing import Any, Final

import cv2
import numpy as np

from vergence.envs.reading import Image
from vergence.envs.task import GazeTask
from vergence.envs.task_env import missing_window_hint
from vergence.errors import RenderingUnavailableError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.viewer.eye_pictures import (
    BACKGROUND_GREY,
    EYE_COLOURS,
    TARGET_COLOUR,
    draw_cross,
    draw_eye,
    write_label,
)
from vergence.viewer.moment import moment_of
from vergence.viewer.opengl import opengl_failure
from vergence.viewer.outside_view import OutsideView

VIEW_HEIGHT: Final = 320
"""Height of the view of the head, px (chosen: detail against size)."""


def opengl_works() -> bool:
    """True if MuJoCo's renderer works on this machine, see `vergence.viewer.opengl`."""
    return opengl_failure() is None


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
        self._scene = OutsideView(task.head) if opengl_works() else None
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
        positions, target, known = shown.positions, shown.target, shown.target_is_truth
        width = top.shape[1]
        if self._scene is None:
            below = draw_optical_axes(
                head, positions, target, width, VIEW_HEIGHT, target_is_truth=known
            )
        else:
            below = self._scene.draw(positions, target, width, VIEW_HEIGHT, board=known)
        return np.concatenate([top, below], axis=0)

    def close(self) -> None:
        """Close the window and the renderer."""
        if self._window is not None:
            self._window.close()
        if self._scene is not None:
            self._scene.close()


def draw_optical_axes(
    head: HeadModel,
    positions: FloatArray,
    target: FloatArray,
    width: int,
    height: int,
    *,
    target_is_truth: bool = True,
) -> Image:
    """The optical axes from above and from the left, drawn without OpenGL.

    Args:
        head: the head.
        positions: (7,) joint angles, rad.
        target: (3,) in N, m.
        width: px.
        height: px.
        target_is_truth: True to draw the target as ground truth, a circle; else as a fix by gaze, a
            cross.

    Returns:
        (height, width, 3) RGB.
    """
    poses = head.camera_poses(positions)
    out = np.full((height, width, 3), BACKGROUND_GREY, dtype=np.uint8)
    anywhere = bool(np.isfinite(target).all())
    depth = max(1.2 * float(target[2]), 0.5) if anywhere else 1.0
    half = width // 2
    tail = f"{depth:.1f} m deep" + (
        ", cross: fix by gaze" if anywhere and not target_is_truth else ""
    )
    for panel, (axis, sign, title) in enumerate(
        (
            (0, 1.0, f"from above, {tail}"),
            (1, 1.0, f"from the left, {tail}"),
        )
    ):
        left, margin = panel * half, 36
        scale = (half - 2 * margin) / depth
        middle = height // 2

        def pixel_of(
            point: FloatArray, axis: int = axis, sign: float = sign, left: int = left,
            scale: float = scale, middle: int = middle,
        ) -> tuple[int, int]:  # fmt: skip
            across = np.clip(middle + sign * scale * point[axis], -10_000, 10_000)
            return round(left + 36 + scale * float(point[2])), round(float(across))

        for eye, colour in enumerate(EYE_COLOURS):
            origin, direction = poses[eye, :3, 3], poses[eye, :3, 2]
            view = out[:, left : left + half]
            a, b = pixel_of(origin), pixel_of(origin + 1.5 * depth * direction)
            cv2.line(view, (a[0] - left, a[1]), (b[0] - left, b[1]), colour, 2, cv2.LINE_AA)
            cv2.circle(view, (a[0] - left, a[1]), 8, colour, -1, cv2.LINE_AA)
        if anywhere and target_is_truth:
            cv2.circle(out, pixel_of(target), 6, TARGET_COLOUR, 2, cv2.LINE_AA)
        elif anywhere:
            draw_cross(out, np.array(pixel_of(target)), TARGET_COLOUR, 9)
        write_label(out, title, (left + 12, 24))
    cv2.line(out, (half, 10), (half, height - 10), (200, 200, 200), 1)
    return out


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
