"""Camera intrinsics from files of OpenCV, ROS and kalibr: pinhole, lens and image size."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.calibration_keys import (
    BINNING,
    BODY_IN_CAMERA,
    CAMERA_IN_BODY,
    CHAINED,
    DISTORTION,
    FISHEYE,
    HEIGHT,
    MATRIX,
    MODEL,
    PROJECTION,
    REGION,
    ROTATION,
    SHAPE,
    SIZE,
    TRANSLATION,
    UNIT,
    WIDTH,
    CalibrationValues,
    FoundValue,
    flat_array_of,
    refuse_unused_files,
)
from vergence.models.files.calibration_text import READ_FORMATS, parse_numbers, read_calibration
from vergence.models.parts import FloatArray

Lens = Literal["brown-conrady", "rational", "fisheye"]
"""OpenCV's lens models with 5 and 8 coefficients, and its fisheye model with 4."""
COEFFICIENTS: Final[dict[Lens, int]] = {"brown-conrady": 5, "rational": 8, "fisheye": 4}
"""Number of distortion coefficients by lens model."""

_MODELS: Final[dict[str, Lens | None]] = {
    **dict.fromkeys(
        ("plumbbob", "radtan", "radialtangential", "brownconrady", "brown", "opencv"),
        "brown-conrady",
    ),
    **dict.fromkeys(("rational", "rationalpolynomial", "fullopencv"), "rational"),
    **dict.fromkeys(
        ("fisheye", "equidistant", "equi", "kannalabrandt", "kannalabrandt4", "kannalabrandt8",
         "kb4", "kb8", "opencvfisheye", "cv2fisheye"),
        "fisheye",
    ),
    **dict.fromkeys(("none", "pinhole", "perspective", "rectilinear", ""), None),
}  # fmt: skip
"""Lens model by the name that files use; None if the number of coefficients must decide."""
_NAMES_A_LENS: Final = {
    "distortionmodel", "lensmodel", "projectionmodel", "distortiontype", "lensmodelname",
    "distortionmodelname",
}  # fmt: skip
"""Keys whose value can be nothing but a lens model; of others, an unknown one may be a product."""
_UNSUPPORTED: Final = re.compile(
    r"omni(?!vision)|^mei|ucm|unified|^ds$|doublesphere|catadioptric|ocam|scaramuzza|^fov|ftheta|thinprism"
    r"|division|inverse|polynomial|stereographic|equisolid|orthographic|spherical"
    r"|equirectangular|panoram|brown|conrady|radial|fisheye|brandt"
)
"""Part of a lens model's name that none of the supported ones has."""
_MAX_CENTRE_OFFSET: Final = 0.2
"""Distance of a principal point from the image centre, as a fraction of the image side, above
which it is doubted (chosen: false doubts against missed wrong image sizes)."""
_SWAPPED_OFFSET: Final = 0.1
"""Such a distance above which the sides of an image may be swapped, if these fit twice as well
(chosen: a 5:4 image with swapped sides has 0.125)."""
_MAX_UNREAD: Final = 6
"""Most keys that are named as not read (chosen)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Intrinsics:
    """Intrinsics of one calibrated camera."""

    width: int
    """Image width, in pixels."""
    height: int
    """Image height, in pixels."""
    focal: FloatArray
    """(2,) f_u and f_v, in pixels."""
    principal: FloatArray
    """(2,) u_0 and v_0, in pixels, pixel centres at integers as in OpenCV."""
    lens: Lens
    """Lens model."""
    distortion: FloatArray
    """(5,), (8,) or (4,) coefficients of the lens, in OpenCV's order."""
    lens_assumption: str = ""
    """Assumption made about the lens because the file does not specify it; empty if none."""

    def size_fields(self) -> dict[str, int]:
        """Fields of the image size in a head file, for `[image]` or, if eyes differ, `[[eyes]]`."""
        return {"width_px": self.width, "height_px": self.height}

    def fields(self) -> dict[str, Any]:
        """Fields of the other intrinsics in a head file, for `[[eyes]]`."""
        return {
            "focal_px": self.focal.tolist(),
            "principal_px": self.principal.tolist(),
            **({} if self.lens == "brown-conrady" else {"lens": self.lens}),
            "distortion": self.distortion.tolist(),
        }

    @property
    def guesses(self) -> tuple[str, ...]:
        """Assumed or doubtful values, one phrase each."""
        off = np.abs(_offset(self.principal, self.width, self.height)).max() > _MAX_CENTRE_OFFSET
        doubt = (
            f"principal point ({self.principal[0]:.0f}, {self.principal[1]:.0f}) far from the "
            f"middle of {self.width} x {self.height} px: was the camera calibrated at this size?"
        )
        return tuple(text for text in (self.lens_assumption, doubt if off else "") if text)


def _offset(principal: FloatArray, width: float, height: float) -> FloatArray:
    """(2,) distance of a principal point from the image centre, as a fraction of the sides."""
    size = np.array([width, height])
    offset: FloatArray = (principal - (size - 1.0) / 2.0) / size
    return offset


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedCameras:
    """Cameras of the left and the right eye; one object if a single camera stands for both."""

    left: Intrinsics
    right: Intrinsics
    notes: tuple[str, ...] = ()
    """Assumptions about the files, one phrase each."""

    @property
    def guesses(self) -> tuple[str, ...]:
        """Doubtful or assumed values that the user should check, one phrase each."""
        if self.left is self.right:
            return (*self.left.guesses, *self.notes)
        cameras = {"left": self.left, "right": self.right}
        said = (f"{eye} camera: {one}" for eye, camera in cameras.items() for one in camera.guesses)
        return (*said, *self.notes)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraFiles:
    """Cameras that calibration files hold, and the values to look their places up in."""

    names: Sequence[str]
    values: CalibrationValues
    cameras: Sequence[Intrinsics]  # one or two, left first
    keys: Sequence[tuple[CalibrationValues, str]]  # of each camera, with its label or ""
    apart: CalibrationValues  # values of files without a camera, else all

    def notes(self) -> tuple[str, ...]:
        """Refuse files that nothing was read of, and name keys that nothing asked for."""
        refuse_unused_files(self.names, self.values)
        unread = self.values.unread()
        if not unread:
            return ()
        more = f" and {len(unread) - _MAX_UNREAD} more" if len(unread) > _MAX_UNREAD else ""
        return (f"these keys are not read: {', '.join(unread[:_MAX_UNREAD])}{more}",)


def read_camera_files(
    paths: Sequence[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
) -> CameraFiles:
    """Read the cameras in calibration files, for `read_intrinsics` and `read_stereo`."""
    names = [os.fspath(path) for path in paths]
    files = {name: read_calibration(name) for name in names}
    if len(files) < len(names):
        raise ConfigurationError(
            f"{', '.join(names)}: expected different files, got one of them twice"
        )
    values = CalibrationValues(files)
    values.refuse_other_meanings()
    sides = values.sides()
    apart = values
    if sides is not None:
        keys = [(values, side) for side in sides]
    else:
        own = [name for name in names if values.only([name]).has(MATRIX)]
        keys = [(values.only([name]), "") for name in own]
        if len(keys) == 2:
            apart = values.only([name for name in names if name not in own])
    if len(keys) not in (1, 2):
        raise ConfigurationError(
            f"{values.name}: expected the camera matrices of one or two cameras (such as "
            f"cameraMatrix1 and cameraMatrix2, or camera_matrix in a file for each), got "
            f"{len(keys)} of them; {READ_FORMATS}"
        )
    cameras = [find_intrinsics(each, side, size=size, lens=lens) for each, side in keys]
    return CameraFiles(names=names, values=values, cameras=cameras, keys=keys, apart=apart)


def read_intrinsics(
    paths: Sequence[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
) -> CalibratedCameras:
    """Read the left and the right camera: from one file, two (left first), or one for both eyes."""
    found = read_camera_files(paths, size=size, lens=lens)
    if found.apart is not found.values:
        _refuse_swapped(*(keys for keys, _ in found.keys))
    for keys, side in found.keys:  # their places are the robot's, and a head's own
        for stems in (ROTATION, TRANSLATION, CHAINED, BODY_IN_CAMERA, CAMERA_IN_BODY, UNIT):
            keys.find(stems, side, shared=True)
    return CalibratedCameras(left=found.cameras[0], right=found.cameras[-1], notes=found.notes())


def _refuse_swapped(left: CalibrationValues, right: CalibrationValues) -> None:
    """Refuse camera_info files of ROS given right camera first."""
    found = [one for keys in (left, right) if (one := keys.find(PROJECTION))]
    values = [p for one in found if (p := parse_numbers(one.value)) is not None and p.size == 12]
    if len(values) == 2 and values[0].flat[3] < 0.0 == values[1].flat[3]:
        raise ConfigurationError(
            f"{found[0].label}: expected the right camera on the right of the left one, got the "
            "baseline, P[0, 3], in the left camera's file (are left and right swapped: give the "
            "files the other way round?)"
        )


def find_intrinsics(
    keys: CalibrationValues,
    side: str = "",
    *,
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
) -> Intrinsics:
    """Intrinsics of one camera in calibration files; `side` is its label in a pair, or empty."""
    _named_lens(keys, side)  # an unsupported one explains what else is odd
    matrix = keys.find(MATRIX, side)
    if matrix is None:
        raise ConfigurationError(f"{keys.name}: expected a camera matrix, got none")
    focal, principal = _pinhole(matrix)
    width, height = _image_size(keys, side, size)
    _check_principal(principal, matrix.label, width, height)
    _refuse_part(keys, side, (width, height))
    model, distortion, guess = _lens(keys, side, lens)
    return Intrinsics(
        width=width, height=height, focal=focal, principal=principal, lens=model,
        distortion=distortion, lens_assumption=guess,
    )  # fmt: skip


def _pinhole(found: FoundValue) -> tuple[FloatArray, FloatArray]:
    values = flat_array_of(found, (4, 9), "a camera matrix of 3 x 3 numbers, or f_u, f_v, u_0, v_0")
    if values.size == 4:  # kalibr's form of a pinhole
        focal, principal = values[:2], values[2:]
    else:
        matrix = values.reshape(3, 3)
        zeros = matrix[[1, 2, 2], [0, 0, 1]]
        if np.abs(zeros).max() > 1e-9 or abs(matrix[2, 2] - 1.0) > 1e-9:
            raise ConfigurationError(
                f"{found.label}: expected rows f_u 0 u_0, 0 f_v v_0, 0 0 1, got "
                f"{matrix.tolist()} (is it transposed, as MATLAB has it?)"
            )
        focal, principal = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if abs(matrix[0, 1]) > 1e-6 * abs(focal[0]):
            raise ConfigurationError(
                f"{found.label}: expected no skew, got {matrix[0, 1]:g} (calibrate with it fixed)"
            )
    if not (focal > 10.0).all():
        raise ConfigurationError(
            f"{found.label}: expected focal lengths in pixels above 10, got {focal.tolist()}"
        )
    return focal, principal


def _image_size(
    keys: CalibrationValues, side: str, given: tuple[int, int] | None
) -> tuple[int, int]:
    found = keys.find(SIZE, side, shared=True)
    shape = None if found else keys.find(SHAPE, side, shared=True)
    if found is not None:
        sides = flat_array_of(found, (2,), "an image size, width and height in pixels")
        label = found.label
    elif shape is not None:
        expected = "an image's shape, its rows and columns"
        sides, label = flat_array_of(shape, (2, 3), expected)[1::-1], shape.label
    else:
        width, height = (keys.find(stems, side, shared=True) for stems in (WIDTH, HEIGHT))
        if width is None or height is None:
            if given is None:
                raise ConfigurationError(
                    f"{keys.name}: expected the image size (image_width and image_height), got "
                    "none: write these two into it, or give --size WIDTHxHEIGHT"
                )
            return given
        parts = [flat_array_of(one, (1,), "an image's side in pixels") for one in (width, height)]
        sides, label = np.concatenate(parts), width.label
    if not ((sides >= 16) & (sides <= 20_000) & (sides == np.round(sides))).all():
        raise ConfigurationError(
            f"{label}: expected an image size in whole pixels, 16 to 20000, got {sides.tolist()}"
        )
    size = int(sides[0]), int(sides[1])
    if given is not None and size != given:
        raise ConfigurationError(
            f"{label}: expected the size that was given, {given[0]} x {given[1]} px, got "
            f"{size[0]} x {size[1]} (the calibration is of that size)"
        )
    return size


def _check_principal(principal: FloatArray, label: str, width: int, height: int) -> None:
    """Refuse an image size that the principal point contradicts."""
    off, swapped = (
        np.abs(_offset(principal, *sides)).max() for sides in ((width, height), (height, width))
    )
    if off > _SWAPPED_OFFSET and swapped < off / 2.0:
        raise ConfigurationError(
            f"{label}: expected a principal point near the middle of {width} x {height} px, got "
            f"{principal.tolist()}, that of {height} x {width}: is the image size written as rows "
            "by columns? It is (width, height)"
        )
    if off >= 0.5:
        raise ConfigurationError(
            f"{label}: expected a principal point inside the image of {width} x {height} px, got "
            f"{principal.tolist()} (is the image size (width, height)?)"
        )


def _refuse_part(keys: CalibrationValues, side: str, size: tuple[int, int]) -> None:
    """Refuse a camera_info of binned or cropped images."""
    advice = "if the images are full ones, else calibrate at the size that they have"
    where, factors = _counts(keys, side, BINNING)
    if not set(factors) <= {0.0, 1.0}:
        x, y = (max(factor, 1.0) for factor in factors)
        raise ConfigurationError(
            f"{where}: expected a calibration of the full image, which is that of a head, got "
            f"binning {x:g} x {y:g}: set both to 1 {advice}"
        )
    where, (width, height, x, y) = _counts(keys, side, REGION)
    width, height = width or size[0], height or size[1]
    if (width, height, x, y) != (*size, 0.0, 0.0):
        raise ConfigurationError(
            f"{where}: expected a calibration of the full image, which is that of a head, got a "
            f"region of {width:g} x {height:g} px at ({x:g}, {y:g}): set all of it to 0 {advice}"
        )


def _counts(
    keys: CalibrationValues, side: str, every: Sequence[Sequence[str]]
) -> tuple[str, list[float]]:
    """Label of the largest value for messages, and the pixel counts; 0 for missing keys."""
    found = [keys.find(stems, side, shared=True) for stems in every]
    values = [
        float(flat_array_of(one, (1,), "a number of pixels")[0]) if one is not None else 0.0
        for one in found
    ]
    named = found[int(np.argmax(np.abs(values)))]
    return "" if named is None else named.label, values


def _lens(keys: CalibrationValues, side: str, given: Lens | None) -> tuple[Lens, FloatArray, str]:
    named = _named_lens(keys, side)
    if given is not None and named is not None and given != named:
        raise ConfigurationError(
            f"{keys.name}: expected the lens that was given, {given}, got {named}"
        )
    lens = given or named
    found = keys.find(DISTORTION, side)
    if found is None or (parse_numbers(found.value) is not None and not np.size(found.value)):
        lens = lens or "brown-conrady"
        return lens, np.zeros(COEFFICIENTS[lens]), "" if found else "no distortion coefficients"
    values = flat_array_of(
        found, (1, 2, 4, 5, 8, 12, 14), "4, 5, 8, 12 or 14 distortion coefficients"
    )
    guess = ""
    if lens is None and values.size == 4:
        guess = (
            "4 distortion coefficients without a model are taken for k1, k2, p1, p2 of "
            "brown-conrady (--lens fisheye if they are of cv2.fisheye)"
        )
    if lens == "fisheye":
        if values.size != 4:
            raise ConfigurationError(
                f"{found.label}: expected 4 coefficients of a fisheye lens, got {values.size}"
            )
        return lens, values, guess
    if np.any(values[8:]):
        raise ConfigurationError(
            f"{found.label}: expected no thin prism and no tilt of the sensor (coefficients 9 to "
            f"{values.size} at zero), got {values[8:].tolist()}: these lenses are not supported"
        )
    rational = np.zeros(8)
    rational[: min(values.size, 8)] = values[:8]
    if lens != "rational" and not rational[5:].any():
        return "brown-conrady", rational[:5], guess
    if lens == "brown-conrady":
        raise ConfigurationError(
            f"{found.label}: expected 4 or 5 coefficients of the model brown-conrady, got "
            f"{values.size}"
        )
    return "rational", rational, guess


def _named_lens(keys: CalibrationValues, side: str) -> Lens | None:
    """Lens model named in the files; None if there is none."""
    named: dict[Lens, str] = {}
    flag = keys.find(FISHEYE, side, shared=True)
    if flag is not None:
        number = parse_numbers(flag.value)
        if flag.value is True or (number is not None and number.size == 1 and number.item()):
            named["fisheye"] = flag.label
    for stem in MODEL:
        found = keys.find((stem,), side, shared=True)
        if found is None:
            continue
        plain = re.sub(r"[^a-z0-9]", "", str(found.value).lower())
        if plain not in _MODELS:  # such as pinhole-radtan
            plain = plain.removeprefix("pinhole")
        if plain in _MODELS:
            if (lens := _MODELS[plain]) is not None:
                named[lens] = found.label
        elif stem in _NAMES_A_LENS or _UNSUPPORTED.search(plain):
            raise ConfigurationError(
                f"{found.label}: expected a lens model such as plumb_bob, radtan, "
                f"rational_polynomial, fisheye or equidistant, got {found.value!r:.80}, which is "
                "not supported"
            )
        else:
            del keys.used[found.label]
    if len(named) > 1:
        raise ConfigurationError(
            f"{' and '.join(named.values())}: expected one lens model, got {' and '.join(named)}"
        )
    return next(iter(named), None)
