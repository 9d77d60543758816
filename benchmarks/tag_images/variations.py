"""Variations of a tag cut out of a photograph, with the exact mapping of its points.

A variation maps the photograph by a homography and then changes the grey values. The homography is
known exactly, and the later changes move no points, as blur kernels are symmetric. If the map
shrinks, every pixel is the mean over its area: the image is drawn at an integer multiple of its
size, so large that no pixel of the photograph is skipped, and then averaged. A variation that only
changes grey values maps by whole pixels, without resampling.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.tag_images.photographs import KnownTag

MARGIN = 1.5
"""Margin kept around a tag on each side, in tag edges."""
_VIEW = 6.0
"""Viewing distance of a tilted tag, in tag edges."""
_PENUMBRA_PX = 1.0
Image = NDArray[np.uint8]
Matrix = NDArray[np.float64]
Geometry = Callable[[float, np.random.Generator], Matrix]
"""Function from a tag's edge, px, to a homography about its centre, shape (3, 3)."""
Change = Callable[[Image, np.random.Generator], Image]
"""Function from an image to one with other grey values."""


@dataclass(frozen=True)
class Variation:
    """One variation of the appearance of a tag."""

    name: str
    geometry: Geometry | None = None
    """Homography; None for a shift by whole pixels."""
    changes: tuple[Change, ...] = ()
    """Changes of grey values, in order."""
    least_edge_px: float = 0.0
    """Smallest edge of a tag, px; smaller tags would be enlarged and are left out."""
    quick: bool = False
    """True if --quick includes it."""


@dataclass(frozen=True)
class Varied:
    """A varied image."""

    image: Image
    T_image_photograph: Matrix
    """Homography from pixels of the photograph to those of the image, shape (3, 3)."""

    def mapped(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the photograph mapped to the image, shape (..., 2)."""
        homogeneous = np.concatenate([points_px, np.ones((*points_px.shape[:-1], 1))], axis=-1)
        mapped = homogeneous @ self.T_image_photograph.T
        return np.asarray(mapped[..., :2] / mapped[..., 2:])


def vary(image: Image, tag: KnownTag, variation: Variation, rng: np.random.Generator) -> Varied:
    """Cut out a tag with its surroundings and vary it.

    Args:
        image: the photograph, grey.
        tag: the tag in pixels of the photograph.
        variation: variation to apply.
        rng: draws directions, shifts and noise.
    """
    edge = tag.edge_px
    if variation.geometry is None:
        shape = np.eye(3)
        size = math.ceil((1.0 + 2.0 * MARGIN) * edge)
        # the photograph's pixels become the image's
        goal = np.round(tag.centre_px - 0.5 * size)
        matrix = _shift(-goal)
        drawn = cv2.warpPerspective(
            image, matrix, (size, size), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
        )
    else:
        shape = variation.geometry(edge, rng)
        local = edge * float(np.sqrt(abs(np.linalg.det(shape[:2, :2]))))
        size = math.ceil((1.0 + 2.0 * MARGIN) * local)
        goal = np.full(2, 0.5 * size) + rng.uniform(-0.5, 0.5, 2)
        matrix = _shift(goal) @ shape @ _shift(-tag.centre_px)
        drawn = resample(image, matrix, size)
    for change in variation.changes:
        drawn = change(np.asarray(drawn, dtype=np.uint8), rng)
    return Varied(np.asarray(drawn, dtype=np.uint8), matrix)


def resample(image: Image, T_image_photograph: Matrix, size: int) -> Image:
    """Map a photograph to a square image whose pixels are means over their areas.

    Args:
        image: the photograph.
        T_image_photograph: the homography, shape (3, 3).
        size: edge of the image, in pixels.
    """
    # the strongest local reduction near the tag, which is in the inner half of the image
    back = np.linalg.inv(T_image_photograph)
    spots = size * np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75], [0.5, 0.5]])
    shrinks = [np.linalg.norm(_jacobian(back, spot), ord=2) for spot in spots]
    times = min(max(1, math.ceil(max(shrinks) - 0.05)), 16)
    # pixel centres are integers: (0, 0) becomes the centre of its `times` by `times` pixels
    enlarge = np.diag([times, times, 1.0])
    enlarge[:2, 2] = 0.5 * (times - 1)
    drawn = cv2.warpPerspective(
        image,
        enlarge @ T_image_photograph,
        (size * times, size * times),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    if times > 1:
        drawn = cv2.resize(drawn, (size, size), interpolation=cv2.INTER_AREA)
    return np.asarray(drawn, dtype=np.uint8)


def _jacobian(homography: NDArray[np.floating], point: NDArray[np.floating]) -> Matrix:
    x, y, w = homography @ (*point, 1.0)
    moved = np.array([x, y]) / w
    return np.asarray((homography[:2, :2] - np.outer(moved, homography[2, :2])) / w)


def _shift(offset: NDArray[np.float64]) -> Matrix:
    matrix = np.eye(3)
    matrix[:2, 2] = offset
    return matrix


def still(edge_px: float, rng: np.random.Generator) -> Matrix:
    """Identity; only the sub-pixel shift that all geometries have remains."""
    return np.eye(3)


def turned(degrees: float) -> Geometry:
    """Rotation in the image plane, to a random side."""

    def geometry(edge_px: float, rng: np.random.Generator) -> Matrix:
        angle = math.radians(degrees) * rng.choice([-1.0, 1.0])
        return _turn(angle)

    return geometry


def tilted(degrees: float) -> Geometry:
    """Tilt about a random axis in the image plane, with perspective."""

    def geometry(edge_px: float, rng: np.random.Generator) -> Matrix:
        angle, direction = math.radians(degrees), rng.uniform(0.0, 2.0 * math.pi)
        perspective = np.diag([1.0, math.cos(angle), 1.0])
        perspective[2, 1] = math.sin(angle) / (_VIEW * edge_px)
        return _turn(direction) @ perspective @ _turn(-direction)

    return geometry


def shrunk(to_edge_px: float, first: Geometry = still) -> Geometry:
    """Geometry followed by the reduction that brings an unvaried tag to this edge."""

    def geometry(edge_px: float, rng: np.random.Generator) -> Matrix:
        scale = to_edge_px / edge_px
        return np.diag([scale, scale, 1.0]) @ first(edge_px, rng)

    return geometry


def _turn(angle: float) -> Matrix:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def blurred(sigma_px: float) -> Change:
    """Gaussian blur, as out of focus."""
    return lambda image, rng: cv2.GaussianBlur(image, (0, 0), sigma_px).astype(np.uint8)


def smeared(length_px: float) -> Change:
    """Motion blur along a random direction."""

    def change(image: Image, rng: np.random.Generator) -> Image:
        angle = rng.uniform(0.0, math.pi)
        reach = math.ceil(0.5 * length_px) + 1
        kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
        # points are spread over their four nearest pixels, so that the kernel is symmetric
        for along in np.linspace(-0.5 * length_px, 0.5 * length_px, 16 * reach + 1):
            x, y = reach + along * math.cos(angle), reach + along * math.sin(angle)
            left, top = math.floor(x), math.floor(y)
            for column, row in ((left, top), (left + 1, top), (left, top + 1), (left + 1, top + 1)):
                kernel[row, column] += (1.0 - abs(x - column)) * (1.0 - abs(y - row))
        return cv2.filter2D(
            image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE
        ).astype(np.uint8)

    return change


def noisy(sigma: float) -> Change:
    """Gaussian noise of this standard deviation, grey levels."""
    return lambda image, rng: _grey(image + rng.normal(0.0, sigma, image.shape))


def dimmed(factor: float) -> Change:
    """Uniform reduction of the light to a fraction."""
    return lambda image, rng: _grey(factor * image)


def ramped(least: float) -> Change:
    """Light that falls off linearly to a fraction, across the image in a random direction."""

    def change(image: Image, rng: np.random.Generator) -> Image:
        across = _across(image, rng)
        share = (across - across.min()) / np.ptp(across)
        return _grey(image * (1.0 - (1.0 - least) * share))

    return change


def shaded(factor: float, penumbra_edges: float = 0.0) -> Change:
    """Shadow with a straight edge through the middle, in a random direction.

    Args:
        factor: fraction of the light in the shadow.
        penumbra_edges: width of the shadow's edge, in tag edges; at least one pixel.
    """

    def change(image: Image, rng: np.random.Generator) -> Image:
        edge_px = len(image) / (1.0 + 2.0 * MARGIN)
        wide = max(penumbra_edges * edge_px, _PENUMBRA_PX)
        lit = np.clip(0.5 + _across(image, rng) / wide, 0.0, 1.0)
        return _grey(image * (factor + (1.0 - factor) * lit))

    return change


def compressed(quality: int) -> Change:
    """JPEG compression and decompression."""

    def change(image: Image, rng: np.random.Generator) -> Image:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)

    return change


def _across(image: Image, rng: np.random.Generator) -> NDArray[np.float64]:
    """Distance of every pixel from the middle along a random direction, px."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    rows, columns = np.indices(image.shape)
    height, width = image.shape
    return np.asarray(
        (columns - 0.5 * (width - 1)) * math.cos(angle)
        + (rows - 0.5 * (height - 1)) * math.sin(angle)
    )


def _grey(values: NDArray[np.floating]) -> Image:
    return np.asarray(np.clip(np.round(values), 0, 255), dtype=np.uint8)
