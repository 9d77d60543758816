"""Software rasteriser: shaded triangles to pixels with a depth buffer, without OpenGL."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.models.parts import FloatArray

_NEAR_M: Final = 0.01
"""Depth before which a triangle is left out, m (numerical)."""


class Triangles(NamedTuple):
    """Triangles with a brightness at each corner."""

    corners: FloatArray
    """(t, 3, 3) corners, counterclockwise as seen from outside, m."""
    shades: FloatArray
    """(t, 3) factor of the colour at each corner."""
    colours: FloatArray
    """(t, 3) RGB, 0 to 255."""


def paint_triangles(
    image: NDArray[np.uint8], seen: Triangles, focal: float, centre: tuple[float, float]
) -> None:
    """Paint the triangles that face a camera, the nearest one at each pixel.

    Args:
        image: (height, width, 3) RGB, changed in place.
        seen: triangles in the camera's frame: x right, y down, z forward.
        focal: focal length, px.
        centre: principal point, (u, v) px, from the upper left pixel's centre.
    """
    corners, normals = seen.corners, _normals(seen.corners)
    front = (np.einsum("ti,ti->t", normals, corners[:, 0]) < 0.0) & (
        corners[..., 2].min(axis=1) > _NEAR_M
    )
    corners, shades = corners[front], seen.shades[front]
    nearness = 1.0 / corners[..., 2]
    u = focal * corners[..., 0] * nearness + centre[0]
    v = focal * corners[..., 1] * nearness + centre[1]
    height, width = image.shape[:2]
    of_row, row, first, count = _spans(u, v, width, height)
    span = _repeated(count)
    x = (first[span] + _within(count)).astype(np.intp)
    of, y = of_row[span], row[span]
    place = y * width + x
    depth = _interpolated(u, v, nearness, of, x, y)
    nearest = np.zeros(height * width)
    np.maximum.at(nearest, place, depth)
    won = depth == nearest[place]
    of, place = of[won], place[won]
    shade = _interpolated(u, v, shades, of, x[won], y[won])
    painted = np.minimum(seen.colours[front][of] * shade[:, None], 255.0)
    image.reshape(-1, 3)[place] = np.maximum(painted, 0.0).astype(np.uint8)


def _normals(corners: FloatArray) -> FloatArray:
    """(t, 3) outward normals of triangles, as long as twice their area."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _spans(
    u: FloatArray, v: FloatArray, width: int, height: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Triangle, row, first pixel and count of pixels of each run of pixels in a triangle."""
    top = np.clip(np.ceil(v.min(axis=1)), 0, height).astype(np.intp)
    bottom = np.clip(np.floor(v.max(axis=1)), -1, height - 1).astype(np.intp)
    rows = np.maximum(bottom - top + 1, 0)
    of = _repeated(rows)
    row = top[of] + _within(rows)
    low, high = np.full(len(of), 0.0), np.full(len(of), width - 1.0)
    for k in range(3):
        u0, v0 = u[:, k], v[:, k]
        along, across = np.roll(v, -1, axis=1)[:, k] - v0, np.roll(u, -1, axis=1)[:, k] - u0
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = across / along
            edge = u0[of] + slope[of] * (row - v0[of])
        rising, falling = along[of] > 0.0, along[of] < 0.0
        low = np.where(rising, np.maximum(low, edge), low)
        high = np.where(falling, np.minimum(high, edge), high)
    first = np.ceil(low).astype(np.intp)
    count = np.maximum(np.floor(high).astype(np.intp) - first + 1, 0)
    return of, row, first, count


def _interpolated(
    u: FloatArray, v: FloatArray, values: FloatArray,
    of: NDArray[np.intp], x: NDArray[np.intp], y: NDArray[np.intp],
) -> FloatArray:  # fmt: skip
    """Values at pixels, linear between those at the corners of the pixels' triangles."""
    du, dv, dw = (a[:, 1:] - a[:, :1] for a in (u, v, values))
    area = du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0]
    area = np.where(area == 0.0, -1.0, area)
    by_u = (dw[:, 0] * dv[:, 1] - dw[:, 1] * dv[:, 0]) / area
    by_v = (du[:, 0] * dw[:, 1] - du[:, 1] * dw[:, 0]) / area
    base = values[:, 0] - by_u * u[:, 0] - by_v * v[:, 0]
    return np.asarray(base[of] + by_u[of] * x + by_v[of] * y)


def _repeated(counts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Each index as often as its count."""
    return np.repeat(np.arange(len(counts)), counts)


def _within(counts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Numbers from zero to below each count, one run after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)
