"""Panel with both eyes' pixel errors over time, on a logarithmic scale."""

from typing import Final

import cv2
import numpy as np

from vergence.envs.reading import Image
from vergence.models.parts import FloatArray
from vergence.viewer.eye_pictures import BACKGROUND_GREY, EYE_COLOURS, TARGET_COLOUR
from vergence.viewer.lettering import write_text

_LEAST_PX: Final = 0.1
"""Lower end of the scale, px (chosen: below it is noise of the detector)."""
_SETTLED_PX: Final = 1.0
"""Error to which a gaze settles, px (chosen: the larger of the two that are reported)."""
_MARGINS: Final = (34, 12, 34, 30)
"""Space left, right, above and below the axes, px (chosen: room for their numbers)."""
_GRID_GREY: Final = 220
"""Grey level of the grid, 0 to 255 (chosen: fainter than the curves)."""
_SUBPIXEL_BITS: Final = 4
"""Binary digits of OpenCV's fractions of pixels (chosen: smooth curves)."""
_SMALL_PX: Final = 12
"""Size of the axes' numbers, px (chosen)."""


class ErrorCurve:
    """The panel's axes, and the curves up to any time.

    Args:
        times_s: (k,) times, ascending, s.
        errors_px: (k, 2) pixel errors of both eyes; nan for none.
        size: width and height of the panel, px.
    """

    def __init__(self, times_s: FloatArray, errors_px: FloatArray, size: tuple[int, int]) -> None:
        left, right, above, below = _MARGINS
        self._end_s = max(float(times_s[-1]), 1e-3)
        highest = float(np.nanmax(errors_px)) if np.isfinite(errors_px).any() else 0.0
        self._decades = max(1, int(np.ceil(np.log10(max(highest, _LEAST_PX) / _LEAST_PX))))
        self._corner = (left, size[1] - below)
        self._extent = (size[0] - left - right, size[1] - above - below)
        self._times_s, self._errors_px = times_s, errors_px
        self._axes: Image = np.full((size[1], size[0], 3), BACKGROUND_GREY, np.uint8)
        self._draw_axes()

    def draw(self, k: int, note: tuple[str, ...] = ()) -> Image:
        """Draw the curves up to a time.

        Args:
            k: index of the present time.
            note: lines in the upper right corner.

        Returns:
            (height, width, 3) RGB.
        """
        out = self._axes.copy()
        places = self._places(self._times_s[: k + 1, None], self._errors_px[: k + 1])
        fraction = 1 << _SUBPIXEL_BITS
        for eye, colour in enumerate(EYE_COLOURS):
            known = np.isfinite(self._errors_px[: k + 1, eye])
            points = np.round(places[:, eye] * fraction)
            for run in np.split(np.arange(k + 1), np.flatnonzero(np.diff(known)) + 1):
                if known[run[0]]:
                    curve = points[run].astype(np.int32)
                    # the left eye's is broader, and seen where the right eye's covers it
                    cv2.polylines(
                        out, [curve], False, colour, 2 - eye + 1, cv2.LINE_AA, _SUBPIXEL_BITS
                    )
            if known[-1]:
                at = points[-1].astype(int).tolist()
                cv2.circle(out, at, (5 - eye) * fraction, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS)
        for row, line in enumerate(note):
            at = (self._corner[0] + self._extent[0], _MARGINS[2] + 20 + 18 * row)
            write_text(out, line, at, colour=TARGET_COLOUR, align="right")
        return out

    def _places(self, times_s: FloatArray, errors_px: FloatArray) -> FloatArray:
        """(..., 2) pixels of points; errors beyond the scale lie at its end."""
        with np.errstate(divide="ignore"):
            decades = np.log10(np.asarray(errors_px) / _LEAST_PX)
        right = self._corner[0] + self._extent[0] * times_s / self._end_s
        up = self._extent[1] / self._decades * np.clip(decades, 0.0, self._decades)
        return np.stack(np.broadcast_arrays(right, self._corner[1] - up), axis=-1)

    def _draw_axes(self) -> None:
        (left, bottom), (width, height) = self._corner, self._extent
        for decade in range(self._decades + 1):
            error = _LEAST_PX * 10.0**decade
            y = round(float(bottom - decade * height / self._decades))
            settled = bool(np.isclose(error, _SETTLED_PX))
            colour = TARGET_COLOUR if settled else (_GRID_GREY,) * 3
            cv2.line(self._axes, (left, y), (left + width, y), colour, 1)
            write_text(self._axes, f"{error:g}", (left - 5, y + 4), size=_SMALL_PX, align="right")
        write_text(self._axes, "pixel error", (_MARGINS[0], 18))
        for at in (0.0, 0.5 * self._end_s, self._end_s):
            x = left + round(width * at / self._end_s)
            cv2.line(self._axes, (x, bottom), (x, bottom + 4), (_GRID_GREY - 60,) * 3, 1)
            align = "right" if at == self._end_s else "middle"
            text = f"{at:g} s" if at == self._end_s else f"{at:g}"
            where = (x + (8 if at == self._end_s else 0), bottom + 18)
            write_text(self._axes, text, where, size=_SMALL_PX, align=align)  # type: ignore[arg-type]
