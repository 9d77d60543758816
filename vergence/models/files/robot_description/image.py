"""Intrinsics of an imported head's cameras: from a calibration, from an MJCF, or assumed."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians, tan
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.intrinsics import Intrinsics, read_intrinsics
from vergence.models.files.robot_description.mechanism import MjcfCamera
from vergence.models.joints import EYE_NAMES
from vergence.models.parts import FloatArray

_ASSUMED_SIZE_PX: Final = (640, 480)
"""Image size of a camera without a given one, px (chosen: common with webcams)."""
_ASSUMED_FOV_DEG: Final = 60.0
"""Horizontal field of view of a camera without a given one, degrees (chosen)."""
_PINHOLE: Final = "brown-conrady"


@dataclass(frozen=True, kw_only=True, eq=False)
class EyeIntrinsics:
    """Intrinsics of one camera.

    Attributes:
        size: width and height, pixels.
        focal: (2,) focal lengths, pixels.
        principal: (2,) principal point, pixels, pixel centres at integers.
        lens: name of the lens model.
        distortion: its coefficients.
    """

    size: tuple[int, int]
    focal: FloatArray
    principal: FloatArray
    lens: str = _PINHOLE
    distortion: FloatArray

    def size_fields(self) -> dict[str, int]:
        """Fields of the image size, for `[image]` or, if the eyes differ, `[[eyes]]`."""
        return {"width_px": self.size[0], "height_px": self.size[1]}

    def fields(self) -> dict[str, Any]:
        """Fields of the other intrinsics, for `[[eyes]]`."""
        return {
            "focal_px": np.asarray(self.focal, dtype=float).tolist(),
            "principal_px": np.asarray(self.principal, dtype=float).tolist(),
            **({} if self.lens == _PINHOLE else {"lens": self.lens}),
            "distortion": np.asarray(self.distortion, dtype=float).tolist(),
        }


def find_eye_intrinsics(
    cameras: Sequence[MjcfCamera | None], files: Sequence[str | os.PathLike[str]]
) -> tuple[list[EyeIntrinsics], dict[str, str]]:
    """Determine the intrinsics of both eyes.

    Args:
        cameras: image parameters in the robot's file, left and right.
        files: calibration files, which take precedence.

    Returns:
        The left and the right image, and the reason for each assumption by its dotted key.

    Raises:
        ConfigurationError: the calibration cannot be read, or a camera cannot serve as an eye.
    """
    for eye, camera in zip(EYE_NAMES, cameras, strict=True):
        if camera is not None and camera.fault:
            raise ConfigurationError(
                f"{eye}-camera: expected a camera that is fixed to its body and sees in "
                f"perspective, got one that {camera.fault}"
            )
    if files:
        return _calibrated(read_intrinsics(files))
    images: list[EyeIntrinsics] = []
    assumed: dict[str, str] = {}
    for eye, camera in zip(EYE_NAMES, cameras, strict=True):
        image, reasons = _image(camera)
        images.append(image)
        assumed |= {f"eyes.{eye}.{key}": why for key, why in reasons.items()}
    return images, assumed


def _calibrated(cameras: Sequence[Intrinsics]) -> tuple[list[EyeIntrinsics], dict[str, str]]:
    images = [
        EyeIntrinsics(
            size=(camera.width, camera.height),
            focal=camera.focal,
            principal=camera.principal,
            lens=camera.lens,
            distortion=camera.distortion,
        )
        for camera in cameras
    ]
    assumed = {
        f"eyes.{eye}.distortion": camera.lens_assumption
        for eye, camera in zip(EYE_NAMES, cameras, strict=True)
        if camera.lens_assumption
    }
    if cameras[0] is cameras[1]:
        assumed["eyes.right.focal_px"] = "one calibration was given for both cameras"
    return images, assumed


def _image(camera: MjcfCamera | None) -> tuple[EyeIntrinsics, dict[str, str]]:
    lens = {"distortion": "not in the file: no distortion"}
    size = _ASSUMED_SIZE_PX if camera is None or camera.size is None else camera.size
    unsaid = f"not in the file: {_ASSUMED_SIZE_PX[0]} x {_ASSUMED_SIZE_PX[1]}"
    resolution = {"width_px": unsaid, "height_px": unsaid}
    if camera is None:
        focal = _ASSUMED_SIZE_PX[0] / 2.0 / tan(radians(_ASSUMED_FOV_DEG) / 2.0)
        field = f"not in the file: a field of view of {_ASSUMED_FOV_DEG:g} degrees horizontally"
        return _centred(size, focal), {**resolution, "focal_px": field, **lens}
    if camera.focal is not None and camera.principal is not None:
        image = EyeIntrinsics(
            size=size, focal=camera.focal, principal=camera.principal, distortion=np.zeros(5)
        )
        return image, lens
    focal = size[1] / 2.0 / tan(radians(camera.fovy_deg) / 2.0)
    return _centred(size, focal), (resolution if camera.size is None else {}) | lens


def _centred(size: tuple[int, int], focal: float) -> EyeIntrinsics:
    return EyeIntrinsics(
        size=size,
        focal=np.array([focal, focal]),
        principal=(np.array(size) - 1.0) / 2.0,
        distortion=np.zeros(5),
    )
