"""Check a camera's response by the edges of targets: the right response makes their blur symmetric.

In terms of light, a lens blurs an edge between black and white symmetrically, regardless of the
shape of its blur. If the levels are encoded otherwise than stated, the bright side looks wider.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from vergence.models.camera import LINEAR, SRGB, CameraResponse, light_table
from vergence.models.parts import FloatArray
from vergence.perception.spacing import neighbour_pairs
from vergence.vision import Detection
from vergence.vision.image import measurement_channel

_STRIP_HALF_WIDTH_PX: Final = 4.0
"""Half width of the strip along an edge, px (chosen: the whole blur against other edges)."""
_LEAST_EDGE_PX: Final = 16.0
"""Shortest edge that is used, px: shorter ones have less than 8 px between their ends (chosen:
number of edges against noise)."""
_EDGE_END_FRACTION: Final = 0.22
"""Fraction of an edge at each end that is left out, as other edges blur into it (chosen: bias
against pixels lost)."""
_MAX_EDGES_PER_TARGET: Final = 12
"""Most edges of a detection; each takes some milliseconds (chosen: certainty against time)."""
_LEAST_CONTRAST_GREY: Final = 40.0
"""Smallest contrast of an edge, grey levels; below it the responses hardly differ (chosen: evidence
against noise)."""
_CLIPPED_GREY: Final = 250
"""Grey level from which on a pixel may be clipped; an edge with such a pixel is not used (chosen:
bias against edges lost)."""
_LEAST_EDGES: Final = 8
"""Fewest edges for a conclusion (chosen: early remarks against false ones)."""
_MAX_EDGES_IN_TOTAL: Final = 120
"""Number of edges after which no more are added (chosen: certainty of the mean against time)."""
_MIN_STANDARD_ERRORS: Final = 4.0
"""Standard errors by which the mean ratio must exceed 0 for a remark (chosen: missed against false
remarks)."""
_MIN_MEAN_LOG_RATIO: Final = 0.03
"""Mean ratio that must be exceeded as well; no public set of grey photographs reaches it, nor does
a lens out of focus (measured: benchmarks.responses)."""


class LinearResponseCheck:
    """Tells by edges if levels stated as linear look encoded as sRGB; not the reverse."""

    def __init__(self) -> None:
        self._ratios: list[float] = []

    def add(
        self, image: ArrayLike, detections: Iterable[Detection], stated_response: CameraResponse
    ) -> None:
        """Add the edges of an image, read with the stated response, until there are enough."""
        if stated_response == LINEAR and len(self._ratios) < _MAX_EDGES_IN_TOTAL:
            self._ratios += srgb_fit_log_ratios(measurement_channel(image), detections)

    def notes(self) -> list[str]:
        """One line if the edges contradict a linear response, else none."""
        count = len(self._ratios)
        if count < _LEAST_EDGES:
            return []
        mean, spread = float(np.mean(self._ratios)), float(np.std(self._ratios, ddof=1))
        if not mean > max(_MIN_MEAN_LOG_RATIO, _MIN_STANDARD_ERRORS * spread / np.sqrt(count)):
            return []
        return [
            f"{count} edges look as if the camera's response were srgb, not linear: state it by "
            "--response, or as `response` of the eye in the head's file"
        ]


def srgb_fit_log_ratios(image: NDArray[np.uint8], detections: Iterable[Detection]) -> list[float]:
    """By edge, log ratio of residual squares of "linear" to "srgb"; above 0 if sRGB fits better."""
    ratios = []
    for found in detections:
        corners = found.corners_px[neighbour_pairs(found.target)]
        long = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1) >= _LEAST_EDGE_PX
        chosen = corners[long]  # without edges that have a corner of nan
        for start, end in chosen[:: max(len(chosen) // _MAX_EDGES_PER_TARGET, 1)][
            :_MAX_EDGES_PER_TARGET
        ]:
            strip = _strip(image, start, end)
            if strip is not None:
                squares = [_residual_squares(*strip, one) for one in (LINEAR, SRGB)]
                if min(squares) > 0.0:
                    ratios.append(float(np.log(squares[0] / squares[1])))
    return ratios


def _strip(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Pixels along an edge: signed distances from it, px, positive towards white, and levels."""
    height, width = image.shape
    low = np.maximum(np.floor(np.minimum(start, end) - _STRIP_HALF_WIDTH_PX).astype(int), 0)
    high = np.minimum(
        np.ceil(np.maximum(start, end) + _STRIP_HALF_WIDTH_PX).astype(int) + 1, (width, height)
    )
    if (high - low < 2).any():
        return None
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    along = end - start
    length = float(np.hypot(*along))
    along = along / length
    du, dv = u - start[0], v - start[1]
    share = (du * along[0] + dv * along[1]) / length
    across = dv * along[0] - du * along[1]
    near = (
        (share > _EDGE_END_FRACTION)
        & (share < 1.0 - _EDGE_END_FRACTION)
        & (np.abs(across) <= _STRIP_HALF_WIDTH_PX)
    )
    away, level = across[near], image[v[near], u[near]].astype(float)
    far = np.abs(away) > 0.6 * _STRIP_HALF_WIDTH_PX
    one, two = level[far & (away < 0.0)], level[far & (away > 0.0)]
    if min(len(one), len(two)) < 4:
        return None
    if np.median(one) > np.median(two):
        away = -away
    contrast = abs(float(np.median(one)) - float(np.median(two)))
    if contrast < _LEAST_CONTRAST_GREY or (level >= _CLIPPED_GREY).any():
        return None
    return away, level


def _residual_squares(away: FloatArray, level: FloatArray, response: CameraResponse) -> float:
    """Residual sum of squares of levels after the fit of a blurred step; 0 if it does not fit."""
    light = light_table(response)
    dark, bright = np.interp(np.percentile(level, (10, 90)), np.arange(256), light)

    def residuals(values: FloatArray) -> FloatArray:
        z = (away - values[2]) / np.exp(values[3])
        height = np.exp(-0.5 * z * z)
        # any symmetric blur: the even terms of a Gram-Charlier series, whose integrals are odd
        odd = values[4] * (z**3 - 3.0 * z) + values[5] * (z**5 - 10.0 * z**3 + 15.0 * z)
        light_here = values[0] + values[1] * (ndtr(z) + height * odd)
        return np.asarray(np.interp(light_here, light, np.arange(256.0)) - level)

    first = [dark, bright - dark, 0.0, 0.0, 0.0, 0.0]
    found = least_squares(residuals, first, method="lm", max_nfev=120)
    blur = float(np.exp(found.x[3]))
    if not (
        0.2 < blur < 0.6 * _STRIP_HALF_WIDTH_PX and abs(found.x[2]) < 0.5 * _STRIP_HALF_WIDTH_PX
    ):
        return 0.0
    return float(2.0 * found.cost)
