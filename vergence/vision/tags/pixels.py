"""Gather the pixels near a tag's edges, which take part in a fit."""

from math import gcd, sqrt
from typing import Final

from vergence.kernels import subroutine
from vergence.models.parts import FloatArray
from vergence.vision.plane import transform_point
from vergence.vision.tags.workspace import FitState, SearchRegion, TagPrint, side_lengths

_LEAST_SCALE: Final = 0.4
"""Lower bound of the image scale at the far end of an edge, as a fraction of the mean scale of the
shortest edge (chosen: perspective does not reach it)."""
_CLIPPED_GREY: Final = 254
"""Grey level from which on a pixel may be clipped (chosen: just below 255, the largest level)."""
_MAX_CLIPPED_FRACTION: Final = 0.02
"""Fraction of clipped pixels above which white as a whole counts as clipped, not single pixels
(chosen: bias by clipped white against pixels lost)."""
_BESIDE_CLIPPED_GREY: Final = 240
"""Grey level from which on pixels are left out if white is clipped (measured:
benchmarks.real_light)."""
_DRAWN_BLACK_GREY: Final = 3
"""Grey level up to which black is a drawing's (chosen: just above 0; file formats round)."""
_LEAST_DRAWN_BLACK_FRACTION: Final = 0.2
"""Fraction of such pixels above which the image is a drawing (chosen: drawings that are blurred
against photographs with deep shadows)."""
_LEAST_QUIET_FRACTION: Final = 0.45
"""Fraction of the quiet zone's width that is always used (chosen: evidence on the outer edges
against objects behind the zone)."""


@subroutine
def gather_edge_pixels(
    region: SearchRegion,
    tag: TagPrint,
    state: FitState,
    band_half_width_px: float,
    excluded_quiet_px: float,
    whole_square: bool,
    cell_edges: bool,
    max_pixels: int,
    samples: FloatArray,
) -> int:
    """Gather the pixels near the edges, evenly subsampled to at most `max_pixels`.

    Args:
        region: the image.
        tag: the print.
        state: the tag's approximate pose.
        band_half_width_px: half width of the band along the edges, px.
        excluded_quiet_px: width of the outer part of the quiet zone that is left out, px.
        whole_square: True to take all pixels within the square.
        cell_edges: True to take pixels near the edges of the cells within the square.
        max_pixels: most pixels.
        samples: (most, 3) result: undistorted position and light.

    Returns:
        Number of pixels.
    """
    image, light, rays, view = (
        region.image,
        region.light_by_grey,
        region.rays,
        region.undistorted_view,
    )
    G, cells, border, quiet = state.G, tag.cells, tag.side_cells, tag.quiet_zone_cells
    height, width = image.shape
    left, right = max(region.left, 0), min(region.right, width - 1)
    top, bottom = max(region.top, 0), min(region.bottom, height - 1)
    half = 0.5 * border
    shortest, _, perimeter = side_lengths(state.corners)
    expected = 2.0 * band_half_width_px * perimeter
    area = 1.5 * (0.25 * perimeter + 2.0) ** 2
    if cell_edges:
        expected *= _edges_of(cells) / (4.0 * border)
        expected = min(expected, area)
    if whole_square:
        expected = max(expected, area)
    stride = int(expected / max_pixels) + 1
    phase = int(0.618 * stride + 0.5)
    while gcd(phase, stride) > 1:  # it would leave out columns, perhaps all beside sharp edges
        phase += 1
    # a cheap bound, loose enough for any perspective, rejects most pixels: they are far from edges
    away = band_half_width_px / (_LEAST_SCALE * 0.5 * shortest)
    nearest, farthest = 0.0 if whole_square or cell_edges else 1.0 - away, 1.0 + away
    start = 0.5 * (len(cells) - border)
    count = 0
    for row in range(top, bottom + 1):
        first = left + (-(left + phase * row)) % stride
        for column in range(first, right + 1, stride):
            u, v = float(column), float(row)
            if view.has_lens:
                x, y = rays[row, column, 0], rays[row, column, 1]
                u, v = transform_point(view.plane_from_ray, x, y)
            w = G[2, 0] * u + G[2, 1] * v + G[2, 2]
            x = (G[0, 0] * u + G[0, 1] * v + G[0, 2]) / w
            y = (G[1, 0] * u + G[1, 1] * v + G[1, 2]) / w
            # px per unit of the plane, across the edges along x and along y
            if not nearest <= max(abs(x), abs(y)) <= farthest:
                continue
            a, b = G[0, 0] - x * G[2, 0], G[0, 1] - x * G[2, 1]
            c, d = G[1, 0] - y * G[2, 0], G[1, 1] - y * G[2, 1]
            px_x, px_y = abs(w) / sqrt(a * a + b * b), abs(w) / sqrt(c * c + d * d)
            out_x, out_y = (abs(x) - 1.0) * px_x, (abs(y) - 1.0) * px_y
            out = max(out_x, out_y)
            quiet_x, quiet_y = quiet * px_x / half, quiet * px_y / half
            if out_x > max(quiet_x - excluded_quiet_px, _LEAST_QUIET_FRACTION * quiet_x):
                continue
            if out_y > max(quiet_y - excluded_quiet_px, _LEAST_QUIET_FRACTION * quiet_y):
                continue
            if out > band_half_width_px or count == max_pixels:
                continue
            if not whole_square and out < -band_half_width_px:
                if not cell_edges:
                    continue
                at_x, at_y = (x + 1.0) * half + start, (y + 1.0) * half + start
                if not _near_edge(
                    cells,
                    at_x,
                    at_y,
                    band_half_width_px * half / px_x,
                    band_half_width_px * half / px_y,
                ):
                    continue
            samples[count, 0], samples[count, 1], samples[count, 2] = (
                u,
                v,
                light[image[row, column]],
            )
            count += 1
    return count


@subroutine
def drop_clipped_pixels(samples: FloatArray, pixel_count: int, light_by_grey: FloatArray) -> int:
    """Remove pixels that may be clipped, in place; return the number left.

    If white is clipped, demosaicking and compression have changed the neighbouring pixels as well.
    Nothing is removed from a drawing, which has the smallest and the largest grey level.
    """
    clipped = black = 0
    for n in range(pixel_count):
        if samples[n, 2] >= light_by_grey[_CLIPPED_GREY]:
            clipped += 1
        if samples[n, 2] <= light_by_grey[_DRAWN_BLACK_GREY]:
            black += 1
    if black > _LEAST_DRAWN_BLACK_FRACTION * pixel_count:
        return pixel_count
    limit = light_by_grey[
        _CLIPPED_GREY if clipped <= _MAX_CLIPPED_FRACTION * pixel_count else _BESIDE_CLIPPED_GREY
    ]
    left = 0
    for n in range(pixel_count):
        if samples[n, 2] < limit:
            for k in range(3):
                samples[left, k] = samples[n, k]
            left += 1
    return left


@subroutine
def _edges_of(cells: FloatArray) -> float:
    """Total length of the edges between cells of different colours, cells."""
    size = len(cells)
    edges = 0.0
    for j in range(size):
        for i in range(size - 1):
            if abs(cells[j, i + 1] - cells[j, i]) > 0.5:
                edges += 1.0
            if abs(cells[i + 1, j] - cells[i, j]) > 0.5:
                edges += 1.0
    return edges


@subroutine
def _near_edge(cells: FloatArray, x: float, y: float, reach_x: float, reach_y: float) -> bool:
    """True if an edge between cells of different colours is near a point, all in cells."""
    size = len(cells)
    column, row = min(max(int(x), 0), size - 1), min(max(int(y), 0), size - 1)
    edge = int(x + 0.5)
    if 0 < edge < size and abs(x - edge) <= reach_x:
        near = abs(cells[row, edge] - cells[row, edge - 1]) > 0.5
        if near:
            return True
    edge = int(y + 0.5)
    if 0 < edge < size and abs(y - edge) <= reach_y:
        return bool(abs(cells[edge, column] - cells[edge - 1, column]) > 0.5)
    return False
