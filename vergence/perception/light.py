"""A camera's response by the edges of targets: the one that makes them even.

A lens blurs an edge between black and white evenly to both sides, in light, whatever the shape of
its blur. In levels that are encoded otherwise than stated, the brighter side looks wider.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from vergence.models.parts import FloatArray
from vergence.models.response import LINEAR, SRGB, Response, light_of_levels
from vergence.perception.spacing import neighbours
from vergence.vision import Detection
from vergence.vision.image import measured_levels

_REACH_PX: Final = 4.0
"""Numerical: half width of the strip along an edge."""
_LEAST_EDGE_PX: Final = 16.0
"""Numerical: shorter edges have no 8 px apart from their ends."""
_ENDS: Final = 0.22
"""Numerical: share of an edge at each end that other edges blur into."""
_MOST_EDGES: Final = 12
"""Numerical: of a detection; they take some milliseconds each."""
_LEAST_CONTRAST_GREY: Final = 40.0
"""Numerical: below it the responses hardly differ over an edge."""
_CLIPPED_GREY: Final = 250
"""Numerical: an edge with brighter pixels tells nothing."""
_LEAST_EDGES: Final = 8
"""Numerical: fewer tell nothing."""
_ENOUGH_EDGES: Final = 120
"""Numerical: more make a mean no surer than it has to be."""
_SURE: Final = 4.0
"""Numerical: standard errors of the mean ratio from 0, from which on another response is named."""
_CLEARLY: Final = 0.03
"""Measured: as well as this mean ratio, which no public set of grey photographs reaches
(`benchmarks.responses`), nor a lens out of focus."""


class ResponseCheck:
    """Whether levels that are taken for light look encoded as sRGB, by edges of found targets.

    The reverse is not told: cameras that encode also sharpen, which edges show as well.
    """

    def __init__(self) -> None:
        self._ratios: list[float] = []

    def add(self, image: ArrayLike, detections: Iterable[Detection], stated: Response) -> None:
        """Take an image into account, until there are edges enough.

        Args:
            image: any that `as_grey` takes.
            detections: of targets in it.
            stated: the response that it was read with.
        """
        if stated == LINEAR and len(self._ratios) < _ENOUGH_EDGES:
            self._ratios += edge_ratios(measured_levels(image), detections)

    def notes(self) -> list[str]:
        """A line where edges speak against it, or none."""
        count = len(self._ratios)
        if count < _LEAST_EDGES:
            return []
        mean, spread = float(np.mean(self._ratios)), float(np.std(self._ratios, ddof=1))
        if not mean > max(_CLEARLY, _SURE * spread / np.sqrt(count)):
            return []
        return [
            f"{count} edges look as if the camera's response were srgb, not linear: state it by "
            "--response, or as `response` of the eye in the head's file"
        ]


def edge_ratios(image: NDArray[np.uint8], detections: Iterable[Detection]) -> list[float]:
    """Compare linear levels and sRGB by the edges of targets.

    Args:
        image: (height, width) levels.
        detections: of targets in it.

    Returns:
        For each edge the log of the squares that "linear" leaves of the levels, by those that
        "srgb" leaves: above 0 where sRGB fits better.
    """
    ratios = []
    for found in detections:
        corners = found.corners_px[neighbours(found.target)]
        long = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1) >= _LEAST_EDGE_PX
        chosen = corners[long]  # never where one is nan
        for start, end in chosen[:: max(len(chosen) // _MOST_EDGES, 1)][:_MOST_EDGES]:
            strip = _strip(image, start, end)
            if strip is not None:
                left = [_left(*strip, one) for one in (LINEAR, SRGB)]
                if min(left) > 0.0:
                    ratios.append(float(np.log(left[0] / left[1])))
    return ratios


def _strip(
    image: NDArray[np.uint8], start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """The pixels along an edge: distances across it, px, rising to white, and levels."""
    height, width = image.shape
    low = np.maximum(np.floor(np.minimum(start, end) - _REACH_PX).astype(int), 0)
    high = np.minimum(np.ceil(np.maximum(start, end) + _REACH_PX).astype(int) + 1, (width, height))
    if (high - low < 2).any():
        return None
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    along = end - start
    length = float(np.hypot(*along))
    along = along / length
    du, dv = u - start[0], v - start[1]
    share = (du * along[0] + dv * along[1]) / length
    across = dv * along[0] - du * along[1]
    near = (share > _ENDS) & (share < 1.0 - _ENDS) & (np.abs(across) <= _REACH_PX)
    away, level = across[near], image[v[near], u[near]].astype(float)
    far = np.abs(away) > 0.6 * _REACH_PX
    one, two = level[far & (away < 0.0)], level[far & (away > 0.0)]
    if min(len(one), len(two)) < 4:
        return None
    if np.median(one) > np.median(two):
        away = -away
    contrast = abs(float(np.median(one)) - float(np.median(two)))
    if contrast < _LEAST_CONTRAST_GREY or (level >= _CLIPPED_GREY).any():
        return None
    return away, level


def _left(away: FloatArray, level: FloatArray, response: Response) -> float:
    """Squares of levels that a blurred step of light leaves; 0 where it does not fit at all."""
    light = light_of_levels(response)
    dark, bright = np.interp(np.percentile(level, (10, 90)), np.arange(256), light)

    def residuals(values: FloatArray) -> FloatArray:
        z = (away - values[2]) / np.exp(values[3])
        height = np.exp(-0.5 * z * z)
        # any even blur: Gram and Charlier's terms of even order, whose integrals are odd
        odd = values[4] * (z**3 - 3.0 * z) + values[5] * (z**5 - 10.0 * z**3 + 15.0 * z)
        light_here = values[0] + values[1] * (ndtr(z) + height * odd)
        return np.asarray(np.interp(light_here, light, np.arange(256.0)) - level)

    first = [dark, bright - dark, 0.0, 0.0, 0.0, 0.0]
    found = least_squares(residuals, first, method="lm", max_nfev=120)
    blur = float(np.exp(found.x[3]))
    if not (0.2 < blur < 0.6 * _REACH_PX and abs(found.x[2]) < 0.5 * _REACH_PX):
        return 0.0
    return float(2.0 * found.cost)
