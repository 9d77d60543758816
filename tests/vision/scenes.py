"""Drawn images whose truth is known, and what light, lenses and files do to them."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence import load_head
from vergence.models.parts import Rendering
from vergence.vision import BoardDetection, Camera, TargetRenderer
from vergence.vision.targets import PlanarTarget

Image = NDArray[np.uint8]
Change = Callable[[Image, np.ndarray], Image]
"""From an image and the middle of the target to another image."""


@lru_cache
def rig(name: str) -> tuple[Camera, Rendering]:
    """The left eye of a preset, and how it renders."""
    head = load_head(name)
    return Camera.of(head, 0), head.rendering


CAMERA, RENDERING = rig("simulated")


class Scene(NamedTuple):
    """An image, and where the target is in it."""

    image: Image
    corners: np.ndarray
    """(n, 2) px."""
    point: np.ndarray
    """(2,) px."""


def in_space(target: PlanarTarget, T_C_T: np.ndarray, size: float = 1.0) -> np.ndarray:
    """(n, 3) where the target's corners are in the camera's frame, m."""
    flat = np.column_stack([size * target.corners_m, np.zeros(len(target.corners_m))])
    return flat @ T_C_T[:3, :3].T + T_C_T[:3, 3]


@lru_cache(maxsize=16)
def _drawing(camera: Camera, target: PlanarTarget, rendering: Rendering) -> TargetRenderer:
    return TargetRenderer(camera, target, rendering)


def scene(
    camera: Camera,
    target: PlanarTarget,
    T_C_T: np.ndarray,
    rendering: Rendering,
    rng: np.random.Generator | None = None,
    smear_px: Sequence[float] = (0.0, 0.0),
) -> Scene:
    """One target before a plain background."""
    drawing = _drawing(camera, target, rendering)
    drawing.draw(T_C_T, rng, smear_px)
    point = camera.project(T_C_T[None, :3, 3])[0]
    return Scene(drawing.frame.copy(), camera.project(in_space(target, T_C_T)), point)


def cropped(one: Scene, room_px: int = 70) -> Scene:
    """The part of an image about the target: far less to search where nothing is to be found."""
    x0, y0 = np.maximum(np.floor(one.corners.min(axis=0)).astype(int) - room_px, 0)
    x1, y1 = np.ceil(one.corners.max(axis=0)).astype(int) + room_px
    part = np.ascontiguousarray(one.image[y0:y1, x0:x1])
    return Scene(part, one.corners - (x0, y0), one.point - (x0, y0))


def several(
    camera: Camera, placed: Sequence[tuple[PlanarTarget, np.ndarray]], rendering: Rendering
) -> tuple[Image, list[Scene]]:
    """Targets beside each other in one image, and each by itself."""
    scenes, whole = [], None
    for target, T_C_T in placed:
        one = scene(camera, target, T_C_T, rendering)
        x0, y0, x1, y1 = _drawing(camera, target, rendering).region
        if whole is None:
            whole = one.image.copy()
        whole[y0:y1, x0:x1] = one.image[y0:y1, x0:x1]
        scenes.append(one)
    return whole, scenes


def levels(values: np.ndarray) -> Image:
    """Rounded to 8 bits."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _across(image: Image, middle: np.ndarray, angle: float) -> np.ndarray:
    """Pixels from the middle along a direction, of each pixel."""
    rows, columns = np.indices(image.shape)
    return (columns - middle[0]) * np.cos(angle) + (rows - middle[1]) * np.sin(angle)


def shadow(left: float = 0.5, angle: float = 0.5) -> Change:
    """The straight edge of a shadow through the target, as sharp as a lens makes it."""

    def change(image: Image, middle: np.ndarray) -> Image:
        lit = np.clip(0.5 + _across(image, middle, angle) / 2.0, 0.0, 1.0)
        return levels(image * (left + (1.0 - left) * lit))

    return change


def ramp(least: float = 0.2, angle: float = 0.5, across_px: float = 120.0) -> Change:
    """Light that falls off to a part of it over so many pixels."""

    def change(image: Image, middle: np.ndarray) -> Image:
        share = np.clip(0.5 + _across(image, middle, angle) / across_px, 0.0, 1.0)
        return levels(image * (1.0 - (1.0 - least) * share))

    return change


def glare(away_px: float, radius_px: float = 20.0, angle: float = 0.5) -> Change:
    """A light that blinds the camera beside the target, with a halo that reaches over it."""

    def change(image: Image, middle: np.ndarray) -> Image:
        place = middle + away_px * np.array([np.cos(angle), np.sin(angle)])
        x, y = _across(image, place, 0.0), _across(image, place, np.pi / 2)
        return levels(image + 400.0 * np.exp(-0.5 * (x**2 + y**2) / radius_px**2))

    return change


def jpeg(quality: int = 30) -> Change:
    """JPEG compression and decompression."""

    def change(image: Image, middle: np.ndarray) -> Image:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))

    return change


def defocus(sigma_px: float) -> Change:
    """Gaussian blur, as out of focus."""
    return lambda image, middle: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def rms(values: object) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def turned(rng: np.random.Generator, most_rad: float) -> tuple[float, float, float]:
    """A rotation vector of a random direction, up to an angle."""
    axis = rng.normal(size=3)
    return tuple(axis / np.linalg.norm(axis) * rng.uniform(0.0, most_rad))


def shifted(found: BoardDetection, by_px: ArrayLike) -> BoardDetection:
    """A detection predicted elsewhere."""
    return found._replace(point_px=found.point_px + by_px, corners_px=found.corners_px + by_px)
