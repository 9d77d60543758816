"""Film of one gaze: the head from outside, both eyes' images, and the pixel error over time."""

from collections.abc import Callable
from math import ceil
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from vergence.envs.plant import Simulation
from vergence.envs.reading import Image
from vergence.envs.task import GazeTask
from vergence.eval.gaze import GazeResult
from vergence.eval.gaze_trajectory import MM
from vergence.viewer.error_curve import ErrorCurve
from vergence.viewer.eye_pictures import BACKGROUND_GREY, EYE_COLOURS, draw_eye
from vergence.viewer.film_files import write_film
from vergence.viewer.lettering import write_text
from vergence.viewer.moment import Moment, moment_of
from vergence.viewer.painting import HeadPainter

_FRAME_MS: Final = 50
"""Time that a frame is shown, ms (chosen: smooth, and a multiple of a GIF's 10 ms)."""
_LAST_FRAME_MS: Final = 2000
"""Time that the last frame is shown before the film repeats, ms (chosen: time to read it)."""
_MOST_FRAMES: Final = 120
"""Most frames of a film, unless it would be faster than the gaze (chosen: length, file size)."""

# sizes of the frame, the view of the head, an eye's picture, the space around, and the title, px
# (chosen: legible on a page 800 px wide)
_WIDTH: Final = 800
_VIEW_HEIGHT: Final = 340
_EYE_WIDTH: Final = 250
_MARGIN: Final = 10
_TITLE_PX: Final = 17


class GazeFilm:
    """Moments of a gaze, and their film.

    Args:
        duration_s: length of the trial, s.
    """

    def __init__(self, duration_s: float) -> None:
        self._duration_s = duration_s
        self._slower = 1.0
        self._moments: list[Moment] = []

    def watch(self, task: GazeTask, step: int) -> None:
        """Keep the present moment of a task's first head, if a frame is due.

        Args:
            task: the task.
            step: control periods since the trial's start.
        """
        rate_hz = task.head.timing.control_rate_hz
        in_real_time = 1e-3 * _FRAME_MS * rate_hz
        stride = max(1, int(in_real_time))
        if isinstance(task.plant, Simulation):  # a robot's loop must not be delayed often
            stride = min(stride, ceil(self._duration_s * rate_hz / _MOST_FRAMES))
        self._slower = in_real_time / stride
        if step % stride:
            return
        shown = moment_of(task)
        if shown.images is not None:
            left, right = (_shrink(shown.images.of(eye)) for eye in range(2))
            shown = shown._replace(images=shown.images._replace(left=left, right=right))
        self._moments.append(shown)

    def write(
        self, path: Path, result: GazeResult, progress: Callable[[float], None] | None = None
    ) -> None:
        """Write the film.

        Args:
            path: the file, see `vergence.viewer.film_files.SUFFIXES`.
            result: the result of the gaze.
            progress: callback with the fraction done, after every frame.

        Raises:
            ConfigurationError: the film cannot be written.
        """
        frames = _Frames(result, self._moments, self._slower)
        durations = [_FRAME_MS] * (len(self._moments) - 1) + [_LAST_FRAME_MS]
        write_film(path, frames.draw, durations, progress)


class _Frames:
    """Frames of a film."""

    def __init__(self, result: GazeResult, moments: list[Moment], slower: float) -> None:
        self._result, self._moments = result, moments
        self._head = result.head
        self._painter = HeadPainter(result.head)
        known = [one for one in moments if np.isfinite(one.target).all()] or moments
        self._camera = self._painter.place_camera(
            known[-1].positions, known[-1].target, _WIDTH / _VIEW_HEIGHT
        )
        width, height = self._head.cameras.size.T
        self._panel_height = int(np.ceil((_EYE_WIDTH * height / width).max() / 2)) * 2
        self._curve = ErrorCurve(
            np.array([one.time_s for one in moments]),
            np.array([one.errors_px for one in moments]),
            (_WIDTH - 2 * _EYE_WIDTH - 4 * _MARGIN, self._panel_height),
        )
        rate = f"{slower:.2g}x slower" if slower > 1.0 else f"{1.0 / slower:.2g}x faster"
        self._rate = "" if np.isclose(slower, 1.0) else rate
        self._title = f"{result.head.name} head, controller {result.config.controller}"

    def draw(self, k: int) -> Image:
        """Draw a frame.

        Args:
            k: its index.

        Returns:
            (height, width, 3) RGB, of even sizes.
        """
        shown = self._moments[k]
        out = np.full(
            (_VIEW_HEIGHT + self._panel_height + 2 * _MARGIN, _WIDTH, 3), BACKGROUND_GREY, np.uint8
        )
        crossing = shown.fix.point if shown.fix.valid else None
        out[:_VIEW_HEIGHT] = self._painter.draw(
            shown.positions, shown.target, _WIDTH, _VIEW_HEIGHT,
            board=shown.shows_tag, fix=crossing, camera=self._camera,
        )  # fmt: skip
        write_text(out, self._title, (_MARGIN, 24), size=_TITLE_PX)
        clock = f"{shown.time_s:.2f} s"
        write_text(out, clock, (_WIDTH - _MARGIN, 24), size=_TITLE_PX, align="right")
        write_text(out, self._rate, (_WIDTH - _MARGIN, 44), align="right")
        write_text(out, _describe_crossing(shown), (_MARGIN, _VIEW_HEIGHT - 12))
        if shown.target_is_truth:  # a detection's image is older than the picture
            shown = shown._replace(pixels=np.full((2, 2), np.nan))
        top = _VIEW_HEIGHT + _MARGIN
        for eye, colour in enumerate(EYE_COLOURS):
            picture = draw_eye(self._head, shown, eye, _EYE_WIDTH)
            cv2.rectangle(picture, (0, 0), (_EYE_WIDTH - 1, len(picture) - 1), colour, 2)
            left = _MARGIN + eye * (_EYE_WIDTH + _MARGIN)
            out[top : top + len(picture), left : left + _EYE_WIDTH] = picture
        left = 3 * _MARGIN + 2 * _EYE_WIDTH
        curve = self._curve.draw(k, self._note(shown.time_s))
        out[top : top + len(curve), left : left + curve.shape[1]] = curve
        return out

    def _note(self, time_s: float) -> tuple[str, ...]:
        """Lines on the settling, from when it has happened."""
        settled_s = self._result.settle_1px_s
        if not time_s >= settled_s:
            return ()
        to = "within 1 px of the least" if self._result.has_residual else "settled to 1 px"
        return to, f"after {settled_s:.3f} s"


def _describe_crossing(shown: Moment) -> str:
    """Line on the fix by gaze."""
    if not shown.fix.valid:
        return "the optical axes do not cross ahead"
    if shown.target_is_truth:
        off = MM * float(np.linalg.norm(shown.fix.point - shown.target))
        return f"the optical axes cross {off:.1f} mm from the target"
    return "the optical axes cross at ({:.0f}, {:.0f}, {:.0f}) mm".format(*MM * shown.fix.point)


def _shrink(image: Image) -> Image:
    """An eye's image at the width of its picture."""
    height = round(_EYE_WIDTH / image.shape[1] * image.shape[0])
    size = (_EYE_WIDTH, height)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
