"""Software rasteriser: shaded triangles to pixels with a depth buffer, without OpenGL."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.models.parts import FloatArray

_NEAR_M: Final = 0.01
"""Depth of the nearest triangles that are painted, m (numerical)."""

Indices = NDArray[np.intp]


class Triangles(NamedTuple):
    """Triangles with a brightness at each corner."""

    corners: FloatArray
    """(t, 3, 3) corners, counterclockwise as seen from outside, m."""
    shades: FloatArray
    """(t, 3) factor of the colour at each corner."""
    colours: FloatArray
    """(t, 3) RGB, 0 to 255."""


def paint_triangles(
    image: NDArray[np.uint8], seen: Triangles, focal_px: float, centre: tuple[float, float]
) -> None:
    """Paint the triangles that face a camera, the nearest one at each pixel.

    Args:
        image: (height, width, 3) RGB, changed in place.
        seen: triangles in the camera's frame: x right, y down, z forward.
        focal_px: focal length, px.
        centre: principal point, (u, v) px, where the upper left pixel's centre is (0, 0).
    """
    before = (seen.corners[..., 2] > _NEAR_M).all(axis=1)
    corners, shades, colours = (part[before] for part in seen)
    nearness = 1.0 / corners[..., 2]
    u = focal_px * corners[..., 0] * nearness + centre[0]
    v = focal_px * corners[..., 1] * nearness + centre[1]
    front = _doubled_area(u, v) < 0.0  # v points down
    u, v, nearness, shades, colours = (part[front] for part in (u, v, nearness, shades, colours))
    height, width = image.shape[:2]
    of, x, y = _pixels_of_triangles(u, v, width, height)
    place = y * width + x
    depth = _interpolate(u, v, nearness, of, x, y)
    nearest = np.zeros(height * width)
    np.maximum.at(nearest, place, depth)
    won = depth == nearest[place]
    of, x, y, place = of[won], x[won], y[won], place[won]
    shade = _interpolate(u, v, shades, of, x, y).astype(np.float32)
    painted = colours.astype(np.float32)[of] * shade[:, None]
    image.reshape(-1, 3)[place] = np.clip(painted, 0.0, 255.0, out=painted).astype(np.uint8)


def _doubled_area(u: FloatArray, v: FloatArray) -> FloatArray:
    """(t,) twice the area of triangles, negative if they run the other way round."""
    return np.asarray(
        (u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) - (u[:, 2] - u[:, 0]) * (v[:, 1] - v[:, 0])
    )


def _pixels_of_triangles(
    u: FloatArray, v: FloatArray, width: int, height: int
) -> tuple[Indices, Indices, Indices]:
    """All pairs of a triangle and a pixel in it: triangle, x and y."""
    top = np.clip(np.ceil(v.min(axis=1)), 0, height).astype(np.intp)
    bottom = np.clip(np.floor(v.max(axis=1)), -1, height - 1).astype(np.intp)
    of, row = _expand(top, np.maximum(bottom - top + 1, 0))
    low, high = np.zeros(len(of)), np.full(len(of), width - 1.0)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        rise = v[:, b] - v[:, a]
        slope = (u[:, b] - u[:, a]) / np.where(rise == 0.0, 1.0, rise)
        edge = u[of, a] + slope[of] * (row - v[of, a])
        low = np.where(rise[of] > 0.0, np.maximum(low, edge), low)
        high = np.where(rise[of] < 0.0, np.minimum(high, edge), high)
    first = np.ceil(np.minimum(low, width)).astype(np.intp)
    last = np.floor(np.maximum(high, -1.0)).astype(np.intp)
    run, x = _expand(first, np.maximum(last - first + 1, 0))
    return of[run], x, row[run]


def _expand(first: Indices, counts: Indices) -> tuple[Indices, Indices]:
    """Index and value of all numbers in runs that begin at `first`."""
    index = np.repeat(np.arange(len(counts)), counts)
    begin = np.cumsum(counts) - counts
    return index, np.arange(len(index)) + (first - begin)[index]


def _interpolate(
    u: FloatArray, v: FloatArray, values: FloatArray, of: Indices, x: Indices, y: Indices
) -> FloatArray:
    """Values at pixels, linear between those at the corners of the pixels' triangles."""
    area = _doubled_area(u, v)
    by_u = _doubled_area(values, v) / area
    by_v = _doubled_area(u, values) / area
    base = values[:, 0] - by_u * u[:, 0] - by_v * v[:, 0]
    return np.asarray(base[of] + by_u[of] * x + by_v[of] * y)
