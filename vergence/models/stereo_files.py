"""Calibrated cameras and stereo pairs from the files of other tools."""

import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.calibration_files import (
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
    READ_FORMATS,
    RECTIFICATION,
    REGION,
    ROTATION,
    SHAPE,
    SIZE,
    SQUARE,
    TRANSLATION,
    UNIT,
    WIDTH,
    CalibrationValues,
    FoundValue,
    flat_array_of,
    parse_numbers,
    read_calibration,
    refuse_unused_files,
)
from vergence.models.camera import Camera, CameraResponse, Lens, camera_matrix
from vergence.models.geometry import inverse_pose
from vergence.models.head_file import camera_fields, check_head_name, eye_tables
from vergence.models.head_joints import pose_fields
from vergence.models.lens import BROWN_CONRADY
from vergence.models.parts import EYE_NAMES, CalibrationRecord, FloatArray

_MODELS: Final[dict[str, str | None]] = {
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
class ReadCameras:
    """Left and right camera of calibration files; one object if one stands for both eyes.

    Of a pair that does not move, the right one's pose is that in the left one's frame.
    """

    left: Camera
    right: Camera
    lens_assumptions: tuple[str, str] = ("", "")
    """What was assumed about each lens because the files do not say it; empty for nothing."""
    notes: tuple[str, ...] = ()
    """Assumptions about the files, one phrase each."""

    @property
    def guesses(self) -> tuple[str, ...]:
        """Doubtful or assumed values that the user should check, one phrase each."""
        own = [
            _guesses(camera, said)
            for camera, said in zip((self.left, self.right), self.lens_assumptions, strict=True)
        ]
        if self.left is self.right:
            return (*own[0], *self.notes)
        said = (
            f"{eye} camera: {one}"
            for eye, found in zip(EYE_NAMES, own, strict=True)
            for one in found
        )
        return (*said, *self.notes, *_mounting_guesses(self.right.pose))


def _guesses(camera: Camera, lens_assumption: str) -> list[str]:
    said = [lens_assumption] if lens_assumption else []
    if np.abs(_offset(camera.principal, *camera.size)).max() > _MAX_CENTRE_OFFSET:
        u, v = camera.principal
        said.append(
            f"principal point ({u:.0f}, {v:.0f}) far from the middle of {camera.width} x "
            f"{camera.height} px: was the camera calibrated at this size?"
        )
    return said


def _mounting_guesses(pose: FloatArray) -> list[str]:
    """Doubts about where the right camera is mounted, from its pose in the left one's frame."""
    said = []
    across, along, _ = np.abs(pose[:3, 3])
    if along > across:
        said.append(
            "the cameras stand one above the other: N is turned so that its x axis points "
            "from the left one to the right one (are both turned about their optical axes?)"
        )
    roll = np.degrees(np.arctan2(pose[0, 1], pose[0, 0]))
    if abs(roll) > _ODD_ROLL_DEG:
        said.append(
            f"the right camera is turned by {abs(roll):.0f} degrees about its optical axis "
            "against the left one: is that how it is mounted, and are its images as it "
            "delivers them?"
        )
    return said


def _offset(principal: FloatArray, width: float, height: float) -> FloatArray:
    """(2,) distance of a principal point from the image centre, as a fraction of the sides."""
    size = np.array([width, height])
    return np.asarray((principal - (size - 1.0) / 2.0) / size)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraFiles:
    """Cameras that calibration files hold, and the values to look their places up in."""

    names: Sequence[str]
    values: CalibrationValues
    cameras: Sequence[
        tuple[Camera, str]
    ]  # one or two, left first, with what is assumed of the lens
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
    lens: str | None = None,
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
    lens: str | None = None,
) -> ReadCameras:
    """Read the left and the right camera: from one file, two (left first), or one for both eyes."""
    found = read_camera_files(paths, size=size, lens=lens)
    if found.apart is not found.values:
        _refuse_swapped(*(keys for keys, _ in found.keys))
    for keys, side in found.keys:  # their places are the robot's, and a head's own
        for stems in (ROTATION, TRANSLATION, CHAINED, BODY_IN_CAMERA, CAMERA_IN_BODY, UNIT):
            keys.find(stems, side, shared=True)
    return _read(found, found.notes())


def _read(found: CameraFiles, notes: tuple[str, ...]) -> ReadCameras:
    (left, said), (right, other) = found.cameras[0], found.cameras[-1]
    return ReadCameras(left=left, right=right, lens_assumptions=(said, other), notes=notes)


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
    lens: str | None = None,
) -> tuple[Camera, str]:
    """One camera of calibration files, by its label in a pair or "", and what is assumed of it."""
    _named_lens(keys, side)  # an unsupported one explains what else is odd
    matrix = keys.find(MATRIX, side)
    if matrix is None:
        raise ConfigurationError(f"{keys.name}: expected a camera matrix, got none")
    focal, principal = _pinhole(matrix)
    width, height = _image_size(keys, side, size)
    _check_principal(principal, matrix.label, width, height)
    _refuse_part(keys, side, (width, height))
    found, guess = _lens(keys, side, lens)
    return Camera(size=(width, height), matrix=camera_matrix(focal, principal), lens=found), guess


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


def _lens(keys: CalibrationValues, side: str, given: str | None) -> tuple[Lens, str]:
    named = _named_lens(keys, side)
    if given is not None and named is not None and given != named:
        raise ConfigurationError(
            f"{keys.name}: expected the lens that was given, {given}, got {named}"
        )
    lens = given or named
    found = keys.find(DISTORTION, side)
    if found is None or (parse_numbers(found.value) is not None and not np.size(found.value)):
        return Lens(lens or BROWN_CONRADY), "" if found else "no distortion coefficients"
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
        return Lens(lens, values), guess
    if np.any(values[8:]):
        raise ConfigurationError(
            f"{found.label}: expected no thin prism and no tilt of the sensor (coefficients 9 to "
            f"{values.size} at zero), got {values[8:].tolist()}: these lenses are not supported"
        )
    rational = np.zeros(8)
    rational[: min(values.size, 8)] = values[:8]
    if lens != "rational" and not rational[5:].any():
        return Lens(BROWN_CONRADY, rational[:5]), guess
    if lens == "brown-conrady":
        raise ConfigurationError(
            f"{found.label}: expected 4 or 5 coefficients of the model brown-conrady, got "
            f"{values.size}"
        )
    return Lens("rational", rational), guess


def _named_lens(keys: CalibrationValues, side: str) -> str | None:
    """Lens model named in the files; None if there is none."""
    named: dict[str, str] = {}
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


_METRES: Final = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres per unit (physical)."""
_UNIT: Final = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)?\s*(mm|cm|m)\s*")
"""A unit of length, or a length, such as that of a board's squares."""
_UNIT_NAMES: Final = {
    f"{prefix}{metre}{end}": f"{short}m"
    for prefix, short in (("", ""), ("centi", "c"), ("milli", "m"))
    for metre in ("metre", "meter")
    for end in ("", "s")
}
"""Units by their names in files."""

# Range of plausible baselines; others suggest a wrong unit (chosen).
LEAST_BASELINE_M: Final = 0.01
GREATEST_BASELINE_M: Final = 1.0

_LEAST_SQUARES: Final = 0.2
"""Shortest baseline in squares of a board (chosen: a shorter one is in metres)."""
_ODD_ROLL_DEG: Final = 45.0
"""Roll of one camera against the other above which the mounting is doubted (chosen)."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Tolerance on the singular values of a rotation; files have as few as four decimals (chosen)."""


def read_stereo(
    paths: Sequence[str | os.PathLike[str]],
    *,
    unit: str | None = None,
    size: tuple[int, int] | None = None,
    lens: str | None = None,
    swap: bool = False,
) -> ReadCameras:
    """Read a calibrated stereo pair.

    The files are OpenCV's (`cameraMatrix1`, `distCoeffs1`, ..., `R`, `T`, or `M1`, `D1`, ... in
    one file and `R`, `T` in another), two camera_info files of ROS, left first, a camchain of
    kalibr, two sensor.yaml files of EuRoC, or settings of ORB-SLAM2. For ROS and ORB-SLAM2,
    rotation and baseline follow from the rectification and projection matrices:
    `R = R_right^T R_left`, `T = R_right^T (P_right[:, 3] / f' - P_left[:, 3] / f')`; for poses of
    both cameras at a body they are those of `T_right_body T_left_body^-1`.

    Args:
        paths: the files, which together hold both cameras and their relative pose.
        unit: unit of the translation in the files, `m`, `cm` or `mm`, or a length such as `25mm`
            for a translation in squares of the calibration board; None for that in the files, else
            metres.
        size: (width, height) in pixels, for files that do not give it.
        lens: the lens model, for files that do not name it.
        swap: true if the first camera of the files is the right one.

    Returns:
        The pair; the right camera's pose is that in the left one's frame.

    Raises:
        ConfigurationError: a file cannot be read or is unused, a value is missing, or the pair
            is implausible.
    """
    metres = None if unit is None else parse_unit(unit, "unit")
    files = read_camera_files(paths, size=size, lens=lens)
    if len(files.cameras) != 2:
        raise ConfigurationError(
            f"{files.values.name}: expected the camera matrices of a pair (such as cameraMatrix1 "
            "and cameraMatrix2, or camera_matrix in a file for each), got 1 of them"
        )
    placed = _place(files)
    if placed is None:
        one = files.values.find(ROTATION) or files.values.find(TRANSLATION)
        raise ConfigurationError(
            f"{files.values.name}: expected the rotation R and the translation T from the left to "
            f"the right camera, got {f'{one.label} alone' if one else 'neither'}"
        )
    rotation, translation, label = placed
    scale, doubts = _scale(files.values, metres, float(np.abs(translation).max()))
    pose = np.eye(4)  # of the right camera in the left one's frame
    pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ (scale * translation)
    pair = _read(files, (*doubts, *files.notes()))
    if swap:
        pose = inverse_pose(pose)
        pair = ReadCameras(
            left=pair.right, right=pair.left, lens_assumptions=pair.lens_assumptions[::-1],
            notes=pair.notes,
        )  # fmt: skip
    pair = replace(pair, right=replace(pair.right, pose=pose))
    _check(pose, label, scale, swap)
    return pair


def parse_unit(text: str, owner: str) -> float:
    """Metres of a unit such as `mm`, or of a length such as `25mm`."""
    match = _UNIT.fullmatch(text)
    metres = _METRES[match[2]] * float(match[1] or 1.0) if match else 0.0
    if not metres > 0.0:
        raise ConfigurationError(
            f"{owner}: expected m, cm or mm, or the length of a square such as 25mm, got {text!r}"
        )
    return metres


def _scale(
    keys: CalibrationValues, given: float | None, length: float
) -> tuple[float, tuple[str, ...]]:
    """Metres of a translation's unit, and doubts about it."""
    said, square = keys.find(UNIT), keys.find(SQUARE)
    if said is not None:
        stated = parse_unit(
            _UNIT_NAMES.get(str(said.value).lower(), str(said.value).lower()), said.label
        )
        if given is not None and given != stated:
            raise ConfigurationError(
                f"{said.label}: expected the unit that was given, {given:g} m, got {said.value}"
            )
        return stated, ()
    sides = None if square is None else parse_numbers(square.value)
    sizeless = sides is not None and bool((sides == 1.0).all()) and length > _LEAST_SQUARES
    if square is None or not sizeless or given not in (None, *_METRES.values()):
        return given or 1.0, ()
    if given is None:
        raise ConfigurationError(
            f"{square.label}: expected the size of the board's squares, got 1: the translation, "
            f"{length:.4g} long, seems to be in squares: give the length of one as --unit, such as "
            f"--unit 25mm ({0.025 * length:.4g} m), or --unit m, cm or mm if it is in that"
        )
    return given, (f"{square.label} is 1: is the translation in squares of the board?",)


_Place = tuple[FloatArray, FloatArray, str]
"""R, T in the files' unit, and the label of T's source for messages."""


def _place(files: CameraFiles) -> _Place | None:
    """R and T from the left camera to the right one; None if the files do not have them."""
    sides = [side for _, side in files.keys]
    if sides[1] and (chain := files.values.find(CHAINED, sides[1])) is not None:
        pose = _transform(chain)
        return _rotation(pose[:3, :3], chain.label), pose[:3, 3], chain.label
    both = files.apart.has(ROTATION) and files.apart.has(TRANSLATION)
    rotation, translation = (
        files.apart.find(stems) if both else None for stems in (ROTATION, TRANSLATION)
    )
    if rotation is not None and translation is not None:
        values = flat_array_of(
            rotation, (3, 9), "a rotation of 3 x 3 numbers, or a rotation vector"
        )
        shift = flat_array_of(translation, (3,), "a translation of 3 numbers")
        if values.size == 3:
            from scipy.spatial.transform import Rotation

            return Rotation.from_rotvec(values).as_matrix(), shift, translation.label
        return _rotation(values.reshape(3, 3), rotation.label), shift, translation.label
    return _at_body(files) or _rectified(files)


def _transform(found: FoundValue) -> FloatArray:
    """(4, 4) pose, its rotation orthonormal."""
    pose = flat_array_of(found, (16,), "a transform of 4 x 4 numbers").reshape(4, 4)
    if np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > _ROTATION_TOLERANCE:
        raise ConfigurationError(
            f"{found.label}: expected a transform with the last row 0 0 0 1, got {pose[3].tolist()}"
        )
    return np.block([[_rotation(pose[:3, :3], found.label), pose[:3, 3:]], [pose[3:]]])


def _at_body(files: CameraFiles) -> _Place | None:
    """R and T from the poses of both cameras at a body, if present."""
    from_body = []
    for keys, side in files.keys:
        own = keys.find(BODY_IN_CAMERA, side)
        its = None if own else keys.find(CAMERA_IN_BODY, side)
        found = own or its
        if found is None:
            return None
        pose = _transform(found)
        from_body.append(pose if own else inverse_pose(pose))
        label = found.label
    pose = from_body[1] @ inverse_pose(from_body[0])
    return pose[:3, :3], pose[:3, 3], label


def _rectified(files: CameraFiles) -> _Place | None:
    """R and T from rectification and projection matrices of both cameras, if present."""
    turns, shifts, label = [], [], ""
    for keys, side in files.keys:
        turn, projection = keys.find(RECTIFICATION, side), keys.find(PROJECTION, side)
        if turn is None or projection is None:
            return None
        values = flat_array_of(turn, (9,), "a rectification of 3 x 3 numbers").reshape(3, 3)
        turns.append(_rotation(values, turn.label))
        shifts.append(_shift(projection))
        label = projection.label
    if not np.any(shifts[0] - shifts[1]):
        raise ConfigurationError(
            f"{label}: expected the baseline by the focal length in P[0, 3] (a calibration of "
            f"both cameras together), got {float(shifts[1][0]):g} as in the left camera's"
        )
    turn_back = turns[1].T
    return turn_back @ turns[0], turn_back @ (shifts[1] - shifts[0]), label


def _shift(projection: FoundValue) -> FloatArray:
    """(3,) offset of a camera's rectified frame: last column of its projection by focal length."""
    matrix = flat_array_of(projection, (12,), "a projection of 3 x 4 numbers").reshape(3, 4)
    focal = matrix[[0, 1], [0, 1]]
    if not (focal > 0.0).all():
        raise ConfigurationError(
            f"{projection.label}: expected focal lengths above 0, got {focal.tolist()}"
        )
    return np.array([matrix[0, 3] / focal[0], matrix[1, 3] / focal[1], matrix[2, 3]])


def _rotation(matrix: FloatArray, label: str) -> FloatArray:
    """Orthonormal rotation nearest to a rounded one."""
    u, scales, vt = np.linalg.svd(matrix)
    nearest: FloatArray = u @ vt
    if np.abs(scales - 1.0).max() > _ROTATION_TOLERANCE or np.linalg.det(nearest) < 0.0:
        raise ConfigurationError(
            f"{label}: expected a rotation matrix, orthonormal to {_ROTATION_TOLERANCE:g} with "
            f"determinant 1, got {matrix.tolist()!r:.120}"
        )
    return nearest


def _check(pose: FloatArray, label: str, scale: float, swap: bool) -> None:
    """Refuse a pair whose geometry no head can have."""
    with np.errstate(over="ignore"):  # an infinite baseline is refused as too long
        right = pose[:3, 3]
        baseline = float(np.linalg.norm(right))
    if not LEAST_BASELINE_M <= baseline <= GREATEST_BASELINE_M:
        raise ConfigurationError(
            f"{label}: expected a baseline of 0.01 to 1 m, got {baseline:.4g} m"
            + _other_unit(baseline / scale, scale)
        )
    along = right / baseline
    if along[0] < 0.0 and abs(along[0]) > 0.5:
        back = " without --swap" if swap else ": give --swap, or the files the other way round"
        raise ConfigurationError(
            f"{label}: expected the right camera on the right of the left one, got it "
            f"{1000.0 * abs(right[0]):.1f} mm on its left (are left and right swapped{back}?)"
        )
    if abs(along[2]) > 0.9:
        raise ConfigurationError(
            f"{label}: expected two cameras side by side, got the right one "
            f"{1000.0 * right[2]:.1f} mm along the left one's optical axis"
        )
    between = np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))
    if between > 90.0:
        raise ConfigurationError(
            f"{label}: expected two cameras that look the same way, got {between:.0f} degrees "
            f"between their optical axes"
        )


def _other_unit(baseline: float, scale: float) -> str:
    """Hint at the unit in which a baseline would be plausible."""
    for unit, name in (("mm", "millimetres"), ("cm", "centimetres"), ("m", "metres")):
        metres = _METRES[unit] * baseline
        if _METRES[unit] != scale and LEAST_BASELINE_M <= metres <= GREATEST_BASELINE_M:
            return (
                f" (is it in {name}? give --unit {unit}: {metres:.4g} m; in squares of the board? "
                "give --unit with the length of one, such as 25mm)"
            )
    return " (was the calibration told how large the squares are?)"


_ASSUMED: Final[dict[str, dict[str, float | int]]] = {
    "timing": {
        "control_rate_hz": 30.0,
        "frame_rate_hz": 30.0,
        "latency_s": 0.0,
        "exposure_s": 0.0,
        "lag_s": 0.0,
    },
    "sensor": {
        "detection_noise_px": 0.1,
        "encoder_resolution_rad": 0.0,
        "velocity_resolution_rad_s": 0.0,
        "dropped_frame_probability": 0.0,
        "max_smear_px": 6.0,
    },
    "rendering": {
        "blur_px": 0.7,
        "noise_grey": 2.0,
        "supersampling": 2,
        "black_grey": 40.0,
        "white_grey": 210.0,
        "background_grey": 120.0,
    },
}
"""Assumed values for the parts of a head that a stereo calibration does not contain."""
_REASONS: Final = {
    "timing": "not in a calibration: 30 frames a second without delay",
    "sensor.detection_noise_px": (
        "not in a calibration: 0.1 px is what detectors of printed boards scatter by"
    ),
    "rendering": "not in a calibration: a webcam's blur, noise and contrast",
}


def document_of_pair(
    pair: ReadCameras,
    name: str,
    *,
    noise_px: float | None = None,
    calibration: CalibrationRecord | None = None,
    response: CameraResponse | None = None,
) -> dict[str, Any]:
    """Tables of the head file of a pair; N is midway between the cameras, z along the mean axis."""
    check_head_name(name)
    cameras = (pair.left, pair.right)
    eyes = [
        ({} if response is None else {"response": response})
        | camera_fields(camera)
        | pose_fields("position_m", camera.pose)
        for camera in cameras
    ]
    guesses = {
        f"eyes.{eye}.distortion": said
        for eye, said in zip(EYE_NAMES, pair.lens_assumptions, strict=True)
        if said
    }
    sensor, reasons = dict(_ASSUMED["sensor"]), dict(_REASONS)
    if noise_px is not None:
        sensor["detection_noise_px"] = noise_px
        del reasons["sensor.detection_noise_px"]
    return (
        {"name": name}
        | eye_tables(cameras, eyes)
        | _ASSUMED
        | {"sensor": sensor, "assumptions": {**reasons, **guesses}}
        | ({"calibration": asdict(calibration)} if calibration else {})
    )
