"""Panels beside the scene: both eyes' images, errors and speeds over time, the state in words."""

from collections import deque
from typing import Final

import numpy as np
import viser
from viser import uplot

from vergence.envs.reading import Image
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.viewer.eye_pictures import BACKGROUND_GREY, EYE_COLOURS, EYE_WIDTH, draw_eye
from vergence.viewer.moment import Moment

HISTORY_S: Final = 4.0
"""Time that the curves show, s (chosen: several gazes)."""
_PLOT_PERIOD_S: Final = 0.1
"""Least time between two updates of the curves, s (chosen: smooth enough against load)."""
_MIN_DRAWN_ERROR_PX: Final = 0.01
"""Least drawn error, px; smaller ones are drawn as this (chosen: far below one that matters)."""
_ASPECT: Final = 2.4
"""Width of the curves by their height (chosen: images and curves fit a page 900 px high)."""
_PADDING_PX: Final = (16, 12, 0, 8)
"""Padding of the curves at the top, right, bottom and left, px (chosen: room for numbers)."""
_JPEG_QUALITY: Final = 80
"""Quality of the images, of 100 (chosen: no visible blocks)."""
_JOINT_COLOURS: Final = (
    "#1f77b4",
    "#7fb2d9",
    "#d6601e",
    "#efb08b",
    "#777777",
    "#999999",
    "#bbbbbb",
)
_TIME: Final = uplot.Series(label="time (s)")


class EyePanel:
    """The images of both eyes.

    Args:
        server: server of the browsers.
        head: the model of the head; another one may be assigned later.
    """

    def __init__(self, server: viser.ViserServer, head: HeadModel) -> None:
        self.head = head
        nothing = np.full((EYE_WIDTH, EYE_WIDTH, 3), BACKGROUND_GREY, np.uint8)
        self._images = [
            server.gui.add_image(nothing, format="jpeg", jpeg_quality=_JPEG_QUALITY)
            for _ in EYE_NAMES
        ]

    def show(self, shown: Moment) -> list[Image]:
        """Show a moment's images, and return their pictures, (height, width, 3) RGB."""
        pictures = [draw_eye(self.head, shown, eye) for eye in range(len(EYE_NAMES))]
        for handle, picture in zip(self._images, pictures, strict=True):
            handle.image = picture
        return pictures


class CurvePanel:
    """Curves of the pixel errors and of the joint speeds over the last seconds.

    Args:
        server: server of the browsers.
        head: the model of the head.
    """

    def __init__(self, server: viser.ViserServer, head: HeadModel) -> None:
        # the page never draws a plot that it first met without any data
        time_s, none = np.array([0.0, 1.0]), np.full(2, _MIN_DRAWN_ERROR_PX)
        self._errors = server.gui.add_uplot(
            data=(time_s, none, none),
            series=(_TIME, *(
                uplot.Series(label=name, stroke=_css(colour), width=2)
                for name, colour in zip(EYE_NAMES, EYE_COLOURS, strict=True)
            )),
            title="pixel error (px)",
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(distr=3)},
            aspect=_ASPECT,
            padding=_PADDING_PX,
        )  # fmt: skip
        self._speeds = server.gui.add_uplot(
            data=(time_s, 0.0 * none),
            series=(_TIME, uplot.Series()),
            title="joint speed (deg/s)",
            scales={"x": uplot.Scale(time=False)},
            aspect=_ASPECT,
            padding=_PADDING_PX,
        )
        self._rows: deque[FloatArray] = deque()
        self.set_head(head)

    def set_head(self, head: HeadModel) -> None:
        """Begin anew with the joints of a head."""
        self._joints = [head.joints.index(name) for name in dict.fromkeys(head.joints) if name]
        self._rows.clear()
        self._drawn_s = -np.inf
        names = [head.joints[joint] for joint in self._joints]
        self._speeds.series = (
            _TIME,
            *(
                uplot.Series(label=name, stroke=colour, width=2)
                for name, colour in zip(names, _JOINT_COLOURS, strict=False)
            ),
        )
        time_s = np.array([0.0, 1.0])
        self._speeds.data = (time_s, *[np.zeros(2) for _ in names])

    def rows_of(
        self, times_s: FloatArray, errors_px: FloatArray, velocities: FloatArray
    ) -> FloatArray:
        """Rows of the curves.

        Args:
            times_s: (n,) s.
            errors_px: (n, 2) pixel errors by eye, px.
            velocities: (n, 7) joint velocities, rad/s.

        Returns:
            (n, 3 + joints) times, s, errors, px, and speeds, degrees/s.
        """
        errors = np.maximum(errors_px, _MIN_DRAWN_ERROR_PX)
        speeds = np.rad2deg(velocities[:, self._joints])
        return np.column_stack([times_s, errors, speeds])

    def add(self, shown: Moment) -> None:
        """Add a moment; one before the last begins the curves anew."""
        (row,) = self.rows_of(
            np.array([shown.time_s]), shown.errors_px[None], shown.velocities[None]
        )
        if self._rows and shown.time_s < self._rows[-1][0]:
            self._rows.clear()
        self._rows.append(row)
        while self._rows[0][0] < shown.time_s - HISTORY_S:
            self._rows.popleft()
        if not 0.0 <= shown.time_s - self._drawn_s < _PLOT_PERIOD_S:
            self.draw(np.array(self._rows))

    def draw(self, rows: FloatArray) -> None:
        """Draw curves, see `rows_of`."""
        self._drawn_s = float(rows[-1, 0])
        columns = [np.ascontiguousarray(column) for column in rows.T]
        self._errors.data = tuple(columns[:3])
        self._speeds.data = (columns[0], *columns[3:])


def _css(colour: tuple[int, int, int]) -> str:
    return f"rgb{colour}"
