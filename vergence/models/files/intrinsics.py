"""Camera intrinsics from files of OpenCV, ROS and kalibr: pinhole, lens and image size."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.calibration_keys import (
    BINNING,
    CAMERA_MODEL,
    DISTORTION,
    FISHEYE,
    HEIGHT,
    MATRIX,
    MODEL,
    PROJECTION,
    REGION,
    SIZE,
    WIDTH,
    CalibrationValues,
    FoundValue,
    flat_array_of,
    refuse_unused_files,
)
from vergence.models.files.calibration_text import parse_numbers, read_calibration
from vergence.models.parts import FloatArray

Lens = Literal["brown-conrady", "rational", "fisheye"]
"""OpenCV's lens models with 5 and 8 coefficients, and its fisheye model with 4."""
COEFFICIENTS: Final[dict[Lens, int]] = {"brown-conrady": 5, "rational": 8, "fisheye": 4}
"""Number of distortion coefficients by lens model."""

_MODELS: Final[dict[str, Lens | None]] = {
    "plumbbob": "brown-conrady",
    "radtan": "brown-conrady",
    "radialtangential": "brown-conrady",
    "brownconrady": "brown-conrady",
    "rational": "rational",
    "rationalpolynomial": "rational",
    "fisheye": "fisheye",
    "equidistant": "fisheye",
    "equi": "fisheye",
    "kannalabrandt": "fisheye",
    "kannalabrandt4": "fisheye",
    "none": None,
    "pinhole": None,
    "": None,
}
"""Lens model by the name that files use; None if the number of coefficients must decide."""


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


def read_intrinsics(
    paths: Sequence[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
) -> tuple[Intrinsics, Intrinsics]:
    """Read the cameras of the left and the right eye.

    Args:
        paths: one file with both cameras; two files, left first; or one file with a single
            camera, used for both eyes.
        size: (width, height) in pixels, for files that do not give it.
        lens: the lens model, for files that do not name it; None to infer it from the number
            of coefficients.

    Returns:
        The left and the right camera.

    Raises:
        ConfigurationError: a file cannot be read or is unused, or the cameras or their order
            are invalid.
    """
    files = {os.fspath(path): read_calibration(path) for path in paths}
    together = CalibrationValues(files)
    sides = together.sides()
    if sides is not None:
        left, right = (find_intrinsics(together, side, size=size, lens=lens) for side in sides)
        refuse_unused_files(files, together.used)
        return left, right
    singles = [
        keys for name in files if (keys := CalibrationValues({name: files[name]})).find(MATRIX)
    ]
    if len(singles) not in (1, 2):
        raise ConfigurationError(
            f"{together.name}: expected the camera matrices of one or two cameras (such as "
            f"cameraMatrix1 and cameraMatrix2, or camera_matrix), got {len(singles)}"
        )
    cameras = [find_intrinsics(keys, size=size, lens=lens) for keys in singles]
    _refuse_swapped(singles[0], singles[-1])
    refuse_unused_files(files, set().union(*(keys.used for keys in singles)))
    return cameras[0], cameras[-1]


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
    """Intrinsics of one camera in calibration files.

    Args:
        keys: values of the files.
        side: label of the camera in a pair, see `SIDES`; empty for a single camera.
        size: see `read_intrinsics`.
        lens: see `read_intrinsics`.

    Raises:
        ConfigurationError: a value is missing or invalid.
    """
    matrix = keys.find(MATRIX, side)
    if matrix is None:
        raise ConfigurationError(f"{keys.name}: expected a camera matrix, got none")
    focal, principal = _pinhole(matrix)
    width, height = _image_size(keys, side, size)
    if not (0.0 < principal[0] < width and 0.0 < principal[1] < height):
        raise ConfigurationError(
            f"{matrix.label}: expected a principal point inside the image of {width} x {height} "
            f"px, got {principal.tolist()} (is the image size (width, height)?)"
        )
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
    found = keys.find(SIZE, side) or (keys.find(SIZE) if side else None)
    if found is not None:
        sides = flat_array_of(found, (2,), "an image size, width and height in pixels")
        label = found.label
    else:
        width = keys.find(WIDTH, side) or (keys.find(WIDTH) if side else None)
        height = keys.find(HEIGHT, side) or (keys.find(HEIGHT) if side else None)
        if width is None or height is None:
            if given is None:
                raise ConfigurationError(
                    f"{keys.name}: expected the image size (image_width and image_height), got "
                    "none: write these two into it, or give --size WIDTHxHEIGHT (of import stereo "
                    "and detect)"
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
    found = [keys.find(stems, side) or (keys.find(stems) if side else None) for stems in every]
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
    for stems in (FISHEYE, MODEL, CAMERA_MODEL):
        found = keys.find(stems, side) or (keys.find(stems) if side else None)
        if found is None:
            continue
        if stems is FISHEYE:
            flag = parse_numbers(found.value)
            if found.value is True or (flag is not None and flag.size == 1 and flag.item()):
                return "fisheye"
            continue
        plain = re.sub(r"[^a-z0-9]", "", str(found.value).lower())
        if plain not in _MODELS:
            raise ConfigurationError(
                f"{found.label}: expected a lens model such as plumb_bob, radtan, "
                f"rational_polynomial, fisheye or equidistant, got {found.value!r:.80}"
            )
        if _MODELS[plain] is not None:
            return _MODELS[plain]
    return None
