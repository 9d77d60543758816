"""Locate candidate regions for checkerboards: connected clusters of corners where squares meet.

Such a corner is a saddle point of the grey levels: dark, light, dark and light on a circle around
it. Two saddles are neighbours on a board if the dark axis of one is the light axis of the other,
and if the line between them is an edge whose light side agrees with both. In photographs without a
board few saddles have a neighbour, and even fewer belong to a dozen. This leaves little to search
for squares, which takes ten times as long in regions full of corners.
"""

from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

_BLUR_PX: Final = 1.2
"""Standard deviation of the smoothing before derivatives, px (chosen: noise against small
squares)."""
_SADDLE_WINDOW_PX: Final = 5
"""Side of the square in which only the strongest saddle is kept, px (chosen)."""
_LEAST_SADDLE_STRENGTH: Final = 1.5
"""Least strength of a saddle: minus the determinant of the Hessian, (grey levels / px^2)^2
(chosen)."""
_MOST_SADDLES: Final = 4000
"""Most saddles that are kept, the strongest (chosen: time)."""
_CIRCLE_RADIUS_PX: Final = 4.0
"""Radius of the circle of samples around a saddle, px (chosen: inside the smallest squares)."""
_CIRCLE_SAMPLES: Final = 16
"""Samples on the circle (numerical)."""
_LEAST_RANGE_GREY: Final = 6
"""Least range of the samples on the circle, grey levels (chosen: above noise)."""
_LEAST_CROSS_RATIO: Final = 1.5
"""Least ratio of the contrast between crossed pairs of quadrants to that between opposite sides,
which is 0 at an ideal corner (chosen)."""
_NEIGHBOUR_COUNT: Final = 8
"""Number of nearest saddles that are considered as neighbours (chosen)."""
_MAX_AXIS_COSINE: Final = -0.5
"""Largest cosine of twice the angle between the light axes of neighbours; -1 if perpendicular
(chosen)."""
_MAX_EDGE_AXIS_COSINE: Final = 0.8
"""Largest absolute cosine of twice the angle between a light axis and the edge; 0 at 45 degrees
(chosen)."""
_EDGE_SAMPLE_FRACTIONS: Final = (0.3, 0.5, 0.7)
"""Positions of the samples along an edge, as fractions of its length (chosen)."""
_EDGE_SAMPLE_OFFSET: Final = 0.2
"""Distance of the samples from an edge, as a fraction of its length (chosen)."""
_LEAST_SAMPLE_OFFSET_PX: Final = 1.5
"""Least distance of the samples from an edge, px (chosen)."""
_LEAST_EDGE_CONTRAST: Final = 0.25
"""Least contrast across an edge, as a fraction of the range on the circles at its ends (chosen)."""
_LEAST_RANGE_RATIO: Final = 0.4
"""Least ratio of the smaller to the larger range on the circles of neighbours (chosen)."""
_LEAST_SIZE_RATIO: Final = 0.7
"""Least size of a cluster, as a fraction of the board's corners (chosen)."""
_MAX_SIZE_RATIO: Final = 4.0
"""Largest size of a cluster, as a ratio to the board's corners (chosen: tiled floors have more)."""
_MOST_CLUSTERS: Final = 3
"""Most clusters that are returned (chosen: search time)."""
_MARGIN_EDGES: Final = 2.0
"""Margin around a cluster in lengths of its edges, for the outermost squares and the light rim
(chosen)."""
_MARGIN_PX: Final = 6.0
"""Additional margin around a cluster, px (chosen)."""

Region = tuple[int, int, int, int]
"""Region of the pixels x0 <= u < x1, y0 <= v < y1 as (x0, y0, x1, y1)."""


class _Saddles(NamedTuple):
    """Saddle points of the grey levels."""

    places: NDArray[np.int64]
    """(n, 2) u and v, px."""
    hessians: NDArray[np.float64]
    """(n, 3) second derivatives d2/du2, d2/dudv, d2/dv2."""
    ranges: NDArray[np.int16]
    """(n,) range of grey levels on the circle around each; 0 if not sampled yet."""


class CornerCluster(NamedTuple):
    """A connected cluster of corners."""

    region: Region
    """Region of the board that the corners may belong to."""
    corners_px: NDArray[np.float64]
    """(n, 2) the corners, to one pixel, px."""


def find_corner_clusters(image: NDArray[np.uint8], board_corner_count: int) -> list[CornerCluster]:
    """Find a few clusters with about as many corners as a board.

    Args:
        image: grey levels, shape (height, width), without much noise.
        board_corner_count: number of corners of the board; clusters nearest to it in size come
            first.
    """
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR_PX), np.uint8)
    saddles = _crossed(smooth, _saddles(smooth))
    count = len(saddles.places)
    if count < _LEAST_SIZE_RATIO * board_corner_count:
        return []
    first, second = _of_squares(count, *_edges(smooth, saddles))
    # imported here so that commands that seek no board start sooner
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _number, cluster = connected_components(links, directed=False)
    sizes = np.bincount(cluster)
    alike = np.flatnonzero(
        (sizes >= _LEAST_SIZE_RATIO * board_corner_count)
        & (sizes <= _MAX_SIZE_RATIO * board_corner_count)
    )
    lengths = np.linalg.norm(saddles.places[first] - saddles.places[second], axis=1)
    height, width = image.shape
    out = []
    for k in alike[np.argsort(np.abs(sizes[alike] - board_corner_count), kind="stable")][
        :_MOST_CLUSTERS
    ]:
        places = saddles.places[cluster == k]
        margin = _MARGIN_EDGES * float(np.median(lengths[cluster[first] == k])) + _MARGIN_PX
        x0, y0 = np.floor(np.maximum(places.min(axis=0) - margin, 0)).astype(int).tolist()
        x1, y1 = np.ceil(np.minimum(places.max(axis=0) + margin + 1, (width, height))).tolist()
        out.append(CornerCluster((x0, y0, int(x1), int(y1)), places.astype(float)))
    return out


def _saddles(smooth: NDArray[np.uint8]) -> _Saddles:
    """Find the strongest saddles, one per neighbourhood."""
    second: Any = [
        cv2.Sobel(smooth, cv2.CV_32F, *orders, ksize=3, scale=0.25)
        for orders in ((2, 0), (1, 1), (0, 2))
    ]
    uu, uv, vv = second
    strength = uv * uv - uu * vv
    around = cv2.dilate(strength, np.ones((_SADDLE_WINDOW_PX, _SADDLE_WINDOW_PX), np.uint8))
    v, u = np.nonzero((strength >= around) & (strength > _LEAST_SADDLE_STRENGTH))
    if len(u) > _MOST_SADDLES:
        strongest = np.argpartition(strength[v, u], -_MOST_SADDLES)[-_MOST_SADDLES:]
        u, v = u[strongest], v[strongest]
    hessians = np.stack([uu[v, u], uv[v, u], vv[v, u]], axis=1).astype(float)
    return _Saddles(np.stack([u, v], axis=1), hessians, np.zeros(len(u), np.int16))


def _crossed(smooth: NDArray[np.uint8], saddles: _Saddles) -> _Saddles:
    """Select saddles with four changes between light and dark around them."""
    angles = 2.0 * np.pi * np.arange(_CIRCLE_SAMPLES) / _CIRCLE_SAMPLES
    circle = np.rint(_CIRCLE_RADIUS_PX * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(
        int
    )
    greys = _greys_at(smooth, saddles.places[:, None] + circle)
    high, low = greys.max(axis=1), greys.min(axis=1)
    light = 2 * greys > (high + low)[:, None]
    changes = (light != np.roll(light, 1, axis=1)).sum(axis=1)
    quarter = _CIRCLE_SAMPLES // 4
    both = greys[:, : 2 * quarter] + greys[:, 2 * quarter :]
    crossed = np.abs(both[:, :quarter] - both[:, quarter:]).sum(axis=1)
    opposite = np.abs(greys[:, : 2 * quarter] - greys[:, 2 * quarter :]).sum(axis=1)
    ranges = high - low
    kept = (changes == 4) & (ranges > _LEAST_RANGE_GREY) & (crossed > _LEAST_CROSS_RATIO * opposite)
    numbers = np.flatnonzero(kept)
    from scipy.spatial import cKDTree

    # a corner midway between pixels is equally strong in all of them
    same = cKDTree(saddles.places[numbers]).query_pairs(
        0.5 * _SADDLE_WINDOW_PX, output_type="ndarray"
    )
    numbers = np.delete(numbers, same[:, 1])
    return _Saddles(saddles.places[numbers], saddles.hessians[numbers], ranges[numbers])


def _edges(
    smooth: NDArray[np.uint8], saddles: _Saddles
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of saddles with an edge between them, as (m,) indices of the first and the second."""
    from scipy.spatial import cKDTree

    places, (uu, uv, vv) = saddles.places.astype(float), saddles.hessians.T
    near = min(_NEIGHBOUR_COUNT + 1, len(places))
    _distances, found = cKDTree(places).query(places, k=near)
    first = np.repeat(np.arange(len(places)), near - 1)
    second = np.reshape(found, (len(places), near))[:, 1:].ravel()
    axis = np.arctan2(2.0 * uv, uu - vv)  # twice the angle of the light axis
    along = places[second] - places[first]
    edge = 2.0 * np.arctan2(along[:, 1], along[:, 0])
    kept = np.cos(axis[first] - axis[second]) < _MAX_AXIS_COSINE
    kept &= np.abs(np.cos(edge - axis[first])) < _MAX_EDGE_AXIS_COSINE
    ranges = saddles.ranges[first], saddles.ranges[second]
    kept &= np.minimum(*ranges) > _LEAST_RANGE_RATIO * np.maximum(*ranges)
    first, second, along = first[kept], second[kept], along[kept]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / length
    # the sign of the mixed derivative along and across the edge gives its light side
    bend = along[:, 0] * (uu[first] * across[:, 0] + uv[first] * across[:, 1])
    bend += along[:, 1] * (uv[first] * across[:, 0] + vv[first] * across[:, 1])
    aside = (
        np.sign(bend)[:, None]
        * across
        * np.maximum(_EDGE_SAMPLE_OFFSET * length, _LEAST_SAMPLE_OFFSET_PX)
    )
    least = _LEAST_EDGE_CONTRAST * np.maximum(saddles.ranges[first], saddles.ranges[second])
    kept = np.ones(len(first), np.bool_)
    for share in _EDGE_SAMPLE_FRACTIONS:
        middle = places[first] + share * along
        step = _greys_at(smooth, middle + aside) - _greys_at(smooth, middle - aside)
        kept &= step > least
    return first[kept], second[kept]


def _of_squares(
    count: int, first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Select edges, see `_edges`, that close to a square by three more edges."""
    either = np.concatenate([first, second]), np.concatenate([second, first])
    from scipy.sparse import csr_array

    edges = csr_array((np.ones(2 * len(first), np.int32), either), shape=(count, count))
    edges.data[:] = 1
    # two corners with two common neighbours are opposite in a square
    opposite = edges @ edges
    opposite.setdiag(0)
    opposite.data = (opposite.data > 1).astype(np.int32)
    sides = edges.multiply(opposite @ edges).tocoo()
    kept = sides.data > 0
    return sides.row[kept].astype(np.int64), sides.col[kept].astype(np.int64)


def _greys_at(image: NDArray[np.uint8], places: NDArray[Any]) -> NDArray[np.int16]:
    """Grey levels of the nearest pixels, shape (...) for (..., 2)."""
    height, width = image.shape
    u, v = np.moveaxis(np.rint(places).astype(int), -1, 0)
    inside = image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    return np.asarray(inside, np.int16)
