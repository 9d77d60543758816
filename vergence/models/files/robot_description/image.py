"""Intrinsics of an imported head's cameras: from a calibration, from an MJCF, or assumed."""

import os
from collections.abc import Sequence
from math import radians, tan
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.intrinsics import (
    CalibratedCameras,
    Intrinsics,
    Lens,
    read_intrinsics,
)
from vergence.models.files.robot_description.mechanism import MjcfCamera
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

_ASSUMED_SIZE_PX: Final = (640, 480)
"""Image size of a camera without a given one, px (chosen: common with webcams)."""
_ASSUMED_FOV_DEG: Final = 60.0
"""Horizontal field of view of a camera without a given one, degrees (chosen)."""


def find_eye_intrinsics(
    cameras: Sequence[MjcfCamera | None],
    files: Sequence[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
) -> tuple[CalibratedCameras, dict[str, str]]:
    """Intrinsics of both eyes, files before cameras, and reasons of assumptions by dotted key."""
    for eye, camera in zip(EYE_NAMES, cameras, strict=True):
        if camera is not None and camera.fault:
            raise ConfigurationError(
                f"{eye}-camera: expected a camera that is fixed to its body and sees in "
                f"perspective, got one that {camera.fault}"
            )
    if files:
        calibrated = read_intrinsics(files, size=size, lens=lens)
        return calibrated, _assumed(calibrated)
    for option, given in (("size", size), ("lens", lens)):
        if given is not None:
            raise ConfigurationError(f"{option}: expected --intrinsics beside it, got none")
    images: list[Intrinsics] = []
    assumed: dict[str, str] = {}
    for eye, camera in zip(EYE_NAMES, cameras, strict=True):
        image, reasons = _image(camera)
        images.append(image)
        assumed |= {f"eyes.{eye}.{key}": why for key, why in reasons.items()}
    return CalibratedCameras(left=images[0], right=images[1]), assumed


def _assumed(cameras: CalibratedCameras) -> dict[str, str]:
    """Reasons for the assumptions about calibrated cameras, by their dotted keys."""
    if cameras.left is cameras.right:
        one = {"eyes.right.focal_px": "one calibration was given for both cameras"}
    else:
        one = {}
    eyes = zip(EYE_NAMES, (cameras.left, cameras.right), strict=True)
    lenses = {f"eyes.{eye}.distortion": camera.lens_assumption for eye, camera in eyes}
    return {key: why for key, why in lenses.items() if why} | one


def _image(camera: MjcfCamera | None) -> tuple[Intrinsics, dict[str, str]]:
    lens = {"distortion": "not in the file: no distortion"}
    size = _ASSUMED_SIZE_PX if camera is None or camera.size is None else camera.size
    unsaid = f"not in the file: {_ASSUMED_SIZE_PX[0]} x {_ASSUMED_SIZE_PX[1]}"
    resolution = {"width_px": unsaid, "height_px": unsaid}
    if camera is None:
        focal = _ASSUMED_SIZE_PX[0] / 2.0 / tan(radians(_ASSUMED_FOV_DEG) / 2.0)
        field = f"not in the file: a field of view of {_ASSUMED_FOV_DEG:g} degrees horizontally"
        return _pinhole(size, focal), {**resolution, "focal_px": field, **lens}
    if camera.focal is not None and camera.principal is not None:
        return _pinhole(size, camera.focal, camera.principal), lens
    focal = size[1] / 2.0 / tan(radians(camera.fovy_deg) / 2.0)
    return _pinhole(size, focal), (resolution if camera.size is None else {}) | lens


def _pinhole(
    size: tuple[int, int], focal: FloatArray | float, principal: FloatArray | None = None
) -> Intrinsics:
    """Camera without distortion, its principal point in the middle unless given."""
    middle = (np.array(size) - 1.0) / 2.0
    return Intrinsics(
        width=size[0],
        height=size[1],
        focal=np.broadcast_to(np.asarray(focal, dtype=float), 2),
        principal=middle if principal is None else np.asarray(principal, dtype=float),
        lens="brown-conrady",
        distortion=np.zeros(5),
    )
