"""What an eye's images say of a target, and lines of sight in the fixed frame 0."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import Camera
from vergence.models.parts import FloatArray


class Found(NamedTuple):
    """What an eye's newest image says about the target."""

    detection: Any
    """The detection, see `Detection`; None if the target is not in the image."""


class SeenImage(NamedTuple):
    """An image with its camera's pose and the time of its exposure."""

    image: NDArray[np.uint8]
    T_0_C: FloatArray
    time_s: float


class EyeSearch:
    """Search of one eye's images for the target, in the order of their exposures."""

    _found: Found | None = None

    def look(self, image: Any, T_0_C: FloatArray, time_s: float, *, search: bool = True) -> None:
        """Take an image.

        Args:
            image: grey levels, or blue, green and red.
            T_0_C: (4, 4) pose of the camera at the exposure in the fixed frame, m.
            time_s: time of the exposure, s.
            search: False if the image shows nothing but background.

        Raises:
            ConfigurationError: a user's detector raises, or a point cannot be followed.
        """
        raise NotImplementedError

    def found(self) -> Found | None:
        """What the newest image says; None for nothing yet, or once it has been asked."""
        found, self._found = self._found, None
        return found

    def forget(self) -> None:
        """Drop this eye's track of the target."""


class SharedSearch:
    """What both eyes' searches share; their threads may call it at any time.

    Attributes:
        refused: number of jumps to another object that were refused.
        remark: why an eye has not seen the target, in words; empty if both have, or for a board.
    """

    refused: int = 0
    remark: str = ""

    def forget(self) -> None:
        """Drop what is known of the target, and name a point anew."""

    def click(self, eye: int, pixel: ArrayLike) -> None:
        """Follow the point at a pixel (u, v) of an eye from its next image on.

        Raises:
            ConfigurationError: the target is no point, or `pixel` is no pixel.
        """
        raise ConfigurationError("click: expected --target point, got another target")

    def rehearse(self, images: Sequence[Any]) -> None:
        """Call an object's detector once on both eyes' images, blue, green and red, and wait.

        Raises:
            ConfigurationError: a user's detector raises.
        """

    def close(self) -> None:
        """End the detector's threads and processes."""


def line_of_sight(camera: Camera, T_0_C: FloatArray, pixel: FloatArray) -> FloatArray:
    """Unit vector in frame 0 along which a camera sees a pixel, (3,)."""
    ray = T_0_C[:3, :3] @ np.append(camera.rays(pixel[None])[0], 1.0)
    return np.asarray(ray / np.linalg.norm(ray))


def pixel_of(camera: Camera, T_0_C: FloatArray, place: FloatArray) -> FloatArray:
    """Pixel at which a camera sees a place in frame 0, m, (2,); nan if it cannot."""
    return np.asarray(camera.project((T_0_C[:3, :3].T @ (place - T_0_C[:3, 3]))[None])[0])


def crossing(starts: Sequence[FloatArray], rays: Sequence[FloatArray]) -> tuple[Any, FloatArray]:
    """Depths at which two lines of sight are nearest to each other, and the place between them.

    Args:
        starts: (3,) of either line in frame 0, m.
        rays: unit vector along either line, (3,).

    Returns:
        Depths (2,) along the lines, m, and the middle of their common perpendicular, (3,).
    """
    across = np.column_stack([rays[0], -rays[1]])
    depths = np.linalg.lstsq(across, starts[1] - starts[0], rcond=None)[0]
    ends = [start + depth * ray for start, depth, ray in zip(starts, depths, rays, strict=True)]
    return depths, 0.5 * (ends[0] + ends[1])
