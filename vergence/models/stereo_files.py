"""Calibrated cameras and stereo pairs from the files of other tools."""

import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.assumed import PAIR, PAIR_REASONS
from vergence.models.calibration_files import (
    MATRIX,
    READ_FORMATS,
    CalibrationValues,
    FoundValue,
    parse_numbers,
    read_calibration,
    unexpected,
)
from vergence.models.camera import Camera, CameraResponse, Lens, camera_matrix
from vergence.models.geometry import inverse_pose
from vergence.models.head_file import camera_fields, check_head_name, eye_tables
from vergence.models.head_joints import pose_fields
from vergence.models.lens import BROWN_CONRADY
from vergence.models.parts import EYE_NAMES, CalibrationRecord, FloatArray

# Known spellings of each key, lower-case without punctuation, in order of lookup.
_DISTORTION: Final = (
    "distortioncoefficients", "distcoeffs", "d", "distortioncoeffs", "distortioncoefs",
    "distortioncoeff", "distortionvector", "distortion", "distcoeff", "distcoefs", "distcoef",
    "distortions", "dist", "kc",
)  # fmt: skip
_MODEL: Final = (
    "distortionmodel", "lensmodel", "cameramodel", "projectionmodel", "modeltype", "distortiontype",
    "lenstype", "lens", "model", "cameratype", "camtype", "type", "modelname", "cameramodelname",
    "lensname", "lensmodelname", "distortionmodelname",
)  # fmt: skip
_FISHEYE: Final = ("fisheyemodel", "isfisheye", "usefisheye", "fisheye")
_SIZE: Final = ("imagesize", "imgsize", "resolution", "imageresolution", "size")
_SHAPE: Final = ("imageshape", "imgshape", "shape")
"""Rows by columns, as NumPy's `shape`."""
_WIDTH: Final = ("imagewidth", "width", "imgwidth", "imagecols", "imgcols", "cols")
_HEIGHT: Final = ("imageheight", "height", "imgheight", "imagerows", "imgrows", "rows")
_BINNING: Final = (("binningx",), ("binningy",))
_REGION: Final = (("roiwidth",), ("roiheight",), ("roixoffset",), ("roiyoffset",))
_ROTATION: Final = (
    "r", "rotation", "rotationmatrix", "rmat", "rot", "stereor", "extrinsicr", "extrinsicsr",
)  # fmt: skip
_TRANSLATION: Final = (
    "t", "translation", "translationvector", "tvec", "trans", "stereot", "extrinsict",
    "extrinsicst",
)  # fmt: skip
_UNIT: Final = ("unit", "units", "lengthunit", "translationunit", "tunit", "squaresizeunit")
_SQUARE: Final = ("squaresize", "square", "squarelength", "squarewidth", "sizeofsquare")
_CHAINED: Final = ("tcncnm1",)
"""kalibr's T_cn_cnm1, the transform from the previous camera's frame to this one's."""
_BODY_IN_CAMERA: Final = ("tcamimu", "tcambody", "tcb")
"""Transform from the frame of a body, such as an IMU, to the camera's (kalibr)."""
_CAMERA_IN_BODY: Final = ("tbs", "timucam", "tbodycam", "bodyt", "tbc", "tic")
"""Transform from the camera's frame to that of a body (EuRoC, OpenVINS, VINS, ORB-SLAM3)."""
_RECTIFICATION: Final = ("rectificationmatrix", "rectification", "r")
_PROJECTION: Final = ("projectionmatrix", "projection", "p")
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
_UNITS: Final = {"mm": (0.001, "millimetres"), "cm": (0.01, "centimetres"), "m": (1.0, "metres")}
"""Metres per unit (physical), and its name."""

# Range of plausible baselines; others suggest a wrong unit (chosen).
LEAST_BASELINE_M: Final = 0.01
GREATEST_BASELINE_M: Final = 1.0

_LEAST_SQUARES: Final = 0.2
"""Shortest baseline in squares of a board (chosen: a shorter one is in metres)."""
_ODD_ROLL_DEG: Final = 45.0
"""Roll of one camera against the other above which the mounting is doubted (chosen)."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Tolerance on the singular values of a rotation; files have as few as four decimals (chosen)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadCameras:
    """Left and right camera of calibration files; one object if one stands for both eyes.

    Of a pair that does not move, the right one's pose is that in the left one's frame.
    """

    left: Camera
    right: Camera
    lens_assumptions: tuple[str, str] = ("", "")
    """Assumption about each lens that the files do not tell; empty for none."""
    notes: tuple[str, ...] = ()
    """Assumptions about the files, one phrase each."""

    @property
    def guesses(self) -> tuple[str, ...]:
        """Doubtful or assumed values that the user should check, one phrase each."""
        own = [
            ([assumed] if assumed else []) + _principal_doubts(camera)
            for camera, assumed in zip((self.left, self.right), self.lens_assumptions, strict=True)
        ]
        if self.left is self.right:
            return (*own[0], *self.notes)
        said = [f"{EYE_NAMES[eye]} camera: {one}" for eye in range(2) for one in own[eye]]
        return (*said, *self.notes, *_mounting_doubts(self.right.pose))


def _principal_doubts(camera: Camera) -> list[str]:
    if np.abs(_offset(camera.principal, *camera.size)).max() <= _MAX_CENTRE_OFFSET:
        return []
    u, v = camera.principal
    return [
        f"principal point ({u:.0f}, {v:.0f}) far from the middle of {camera.width} x "
        f"{camera.height} px: was the camera calibrated at this size?"
    ]


def _mounting_doubts(pose: FloatArray) -> list[str]:
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


class _Files(NamedTuple):
    """Cameras that calibration files hold, and the values to look their places up in."""

    cameras: list[tuple[Camera, str]]  # one or two, left first, with what is assumed of the lens
    keys: list[CalibrationValues]  # of each camera
    apart: CalibrationValues  # of the files without a camera if each has a file, else of all
    values: CalibrationValues

    def read(self, notes: tuple[str, ...]) -> ReadCameras:
        """Refuse files that nothing was read of; else the cameras."""
        (left, said), (right, other) = self.cameras[0], self.cameras[-1]
        notes = (*notes, *self.values.notes())
        return ReadCameras(left=left, right=right, lens_assumptions=(said, other), notes=notes)


def _read_files(
    paths: Sequence[str | os.PathLike[str]], size: tuple[int, int] | None, lens: str | None
) -> _Files:
    names = [os.fspath(path) for path in paths]
    files = {name: read_calibration(name) for name in names}
    if len(files) < len(names):
        raise unexpected(", ".join(names), "different files", "one of them twice")
    values = apart = CalibrationValues(files)
    values.refuse_other_meanings()
    keys = values.cameras()
    if not keys:
        own = [name for name in names if values.of_files([name]).has(MATRIX)]
        keys = [values.of_files([name]) for name in own]
        if len(keys) == 2:
            apart = values.of_files([name for name in names if name not in own])
    if len(keys) not in (1, 2):
        raise ConfigurationError(
            f"{values.name}: expected the camera matrices of one or two cameras (such as "
            f"cameraMatrix1 and cameraMatrix2, or camera_matrix in a file for each), got "
            f"{len(keys)} of them; {READ_FORMATS}"
        )
    return _Files([_camera(each, size, lens) for each in keys], keys, apart, values)


def read_intrinsics(
    paths: Sequence[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    lens: str | None = None,
) -> ReadCameras:
    """Read the left and the right camera: from one file, two (left first), or one for both eyes."""
    files = _read_files(paths, size, lens)
    if files.apart is not files.values:
        _refuse_swapped(files.keys)
    for keys in files.keys:  # their places are the robot's, and a head's own
        for stems in (_ROTATION, _TRANSLATION, _CHAINED, _BODY_IN_CAMERA, _CAMERA_IN_BODY, _UNIT):
            keys.find(stems, shared=True)
    return files.read(())


def _refuse_swapped(cameras: Sequence[CalibrationValues]) -> None:
    """Refuse camera_info files of ROS given right camera first."""
    found = [one for keys in cameras if (one := keys.find(_PROJECTION))]
    values = [p for one in found if (p := parse_numbers(one.value)) is not None and p.size == 12]
    if len(values) == 2 and values[0].flat[3] < 0.0 == values[1].flat[3]:
        raise found[0].error(
            "the right camera on the right of the left one",
            "the baseline, P[0, 3], in the left camera's file (are left and right swapped: give "
            "the files the other way round?)",
        )


def _camera(
    keys: CalibrationValues, size: tuple[int, int] | None, lens: str | None
) -> tuple[Camera, str]:
    """One camera, and the assumption about its lens."""
    named = _named_lens(keys)  # an unsupported one explains what else is odd
    matrix = keys.find(MATRIX)
    if matrix is None:
        raise unexpected(keys.name, "a camera matrix", "none")
    focal, principal = _pinhole(matrix)
    size = _image_size(keys, size)
    _check_principal(principal, matrix, *size)
    _refuse_part(keys, size)
    if None not in (lens, named) and lens != named:
        raise unexpected(keys.name, f"the lens that was given, {lens}", named)
    found, guess = _lens(keys, lens or named)
    return Camera(size=size, matrix=camera_matrix(focal, principal), lens=found), guess


def _pinhole(found: FoundValue) -> tuple[FloatArray, FloatArray]:
    values = found.numbers((4, 9), "a camera matrix of 3 x 3 numbers, or f_u, f_v, u_0, v_0")
    if values.size == 4:  # kalibr's form of a pinhole
        focal, principal = values[:2], values[2:]
    else:
        matrix = values.reshape(3, 3)
        zeros = matrix[[1, 2, 2], [0, 0, 1]]
        if np.abs(zeros).max() > 1e-9 or abs(matrix[2, 2] - 1.0) > 1e-9:
            raise found.error(
                "rows f_u 0 u_0, 0 f_v v_0, 0 0 1",
                f"{matrix.tolist()} (is it transposed, as MATLAB has it?)",
            )
        focal, principal = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if abs(matrix[0, 1]) > 1e-6 * abs(focal[0]):
            raise found.error("no skew", f"{matrix[0, 1]:g} (calibrate with it fixed)")
    if not (focal > 10.0).all():
        raise found.error("focal lengths in pixels above 10", focal.tolist())
    return focal, principal


def _image_size(keys: CalibrationValues, given: tuple[int, int] | None) -> tuple[int, int]:
    if found := keys.find(_SIZE, shared=True):
        sides = found.numbers((2,), "an image size, width and height in pixels")
    elif found := keys.find(_SHAPE, shared=True):
        sides = found.numbers((2, 3), "an image's shape, its rows and columns")[1::-1]
    else:
        found, other = (keys.find(stems, shared=True) for stems in (_WIDTH, _HEIGHT))
        if found is None or other is None:
            if given is None:
                raise ConfigurationError(
                    f"{keys.name}: expected the image size (image_width and image_height), got "
                    "none: write these two into it, or give --size WIDTHxHEIGHT"
                )
            return given
        both = [one.numbers((1,), "an image's side in pixels") for one in (found, other)]
        sides = np.concatenate(both)
    if not ((sides >= 16) & (sides <= 20_000) & (sides == np.round(sides))).all():
        raise found.error("an image size in whole pixels, 16 to 20000", sides.tolist())
    width, height = map(int, sides)
    if given is not None and given != (width, height):
        raise found.error(
            f"the size that was given, {given[0]} x {given[1]} px",
            f"{width} x {height} (the calibration is of that size)",
        )
    return width, height


def _check_principal(principal: FloatArray, found: FoundValue, width: int, height: int) -> None:
    """Refuse an image size that the principal point contradicts."""
    off, swapped = (
        np.abs(_offset(principal, *sides)).max() for sides in ((width, height), (height, width))
    )
    if off > _SWAPPED_OFFSET and swapped < off / 2.0:
        raise found.error(
            f"a principal point near the middle of {width} x {height} px",
            f"{principal.tolist()}, that of {height} x {width}: is the image size written as rows "
            "by columns? It is (width, height)",
        )
    if off >= 0.5:
        raise found.error(
            f"a principal point inside the image of {width} x {height} px",
            f"{principal.tolist()} (is the image size (width, height)?)",
        )


def _refuse_part(keys: CalibrationValues, size: tuple[int, int]) -> None:
    """Refuse a camera_info of binned or cropped images."""
    full = "a calibration of the full image, which is that of a head"
    advice = "if the images are full ones, else calibrate at the size that they have"
    found, factors = _counts(keys, _BINNING)
    if found and not set(factors) <= {0.0, 1.0}:
        x, y = (max(factor, 1.0) for factor in factors)
        raise found.error(full, f"binning {x:g} x {y:g}: set both to 1 {advice}")
    found, (width, height, x, y) = _counts(keys, _REGION)
    width, height = width or size[0], height or size[1]
    if found and (width, height, x, y) != (*size, 0.0, 0.0):
        region = f"a region of {width:g} x {height:g} px at ({x:g}, {y:g})"
        raise found.error(full, f"{region}: set all of it to 0 {advice}")


def _counts(
    keys: CalibrationValues, every: Sequence[Sequence[str]]
) -> tuple[FoundValue | None, list[float]]:
    """The largest of some counts of pixels, for messages, and all of them; 0 for missing keys."""
    found = [keys.find(stems, shared=True) for stems in every]
    values = [float(one.numbers((1,), "a number of pixels")[0]) if one else 0.0 for one in found]
    return found[int(np.argmax(np.abs(values)))], values


def _lens(keys: CalibrationValues, lens: str | None) -> tuple[Lens, str]:
    found = keys.find(_DISTORTION)
    if found is None:
        return Lens(lens or BROWN_CONRADY), "no distortion coefficients"
    if parse_numbers(found.value) is not None and not np.size(found.value):
        return Lens(lens or BROWN_CONRADY), ""
    values = found.numbers((1, 2, 4, 5, 8, 12, 14), "4, 5, 8, 12 or 14 distortion coefficients")
    guess = ""
    if lens is None and values.size == 4:
        guess = (
            "4 distortion coefficients without a model are taken for k1, k2, p1, p2 of "
            "brown-conrady (--lens fisheye if they are of cv2.fisheye)"
        )
    if lens == "fisheye":
        if values.size != 4:
            raise found.error("4 coefficients of a fisheye lens", values.size)
        return Lens(lens, values), guess
    if np.any(values[8:]):
        raise found.error(
            f"no thin prism and no tilt of the sensor (coefficients 9 to {values.size} at zero)",
            f"{values[8:].tolist()}: these lenses are not supported",
        )
    rational = np.append(values, np.zeros(8))[:8]
    if lens != "rational" and not rational[5:].any():
        return Lens(BROWN_CONRADY, rational[:5]), guess
    if lens == BROWN_CONRADY:
        raise found.error("4 or 5 coefficients of the model brown-conrady", values.size)
    return Lens("rational", rational), guess


def _named_lens(keys: CalibrationValues) -> str | None:
    """Lens model named in the files; None if there is none."""
    named: dict[str, str] = {}
    if flag := keys.find(_FISHEYE, shared=True):
        number = parse_numbers(flag.value)
        if flag.value is True or (number is not None and number.size == 1 and number.item()):
            named["fisheye"] = flag.label
    for stem in _MODEL:
        found = keys.find((stem,), shared=True)
        if found is None:
            continue
        plain = re.sub(r"[^a-z0-9]", "", str(found.value).lower())
        if plain not in _MODELS:  # such as pinhole-radtan
            plain = plain.removeprefix("pinhole")
        if plain in _MODELS:
            if (lens := _MODELS[plain]) is not None:
                named[lens] = found.label
        elif stem in _NAMES_A_LENS or _UNSUPPORTED.search(plain):
            raise found.error(
                "a lens model such as plumb_bob, radtan, rational_polynomial, fisheye or "
                "equidistant",
                f"{found.value!r:.80}, which is not supported",
            )
        else:
            del keys.used[found.label]
    if len(named) > 1:
        raise unexpected(" and ".join(named.values()), "one lens model", " and ".join(named))
    return next(iter(named), None)


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
    files = _read_files(paths, size, lens)
    name = files.values.name
    if len(files.cameras) != 2:
        raise ConfigurationError(
            f"{name}: expected the camera matrices of a pair (such as cameraMatrix1 and "
            "cameraMatrix2, or camera_matrix in a file for each), got 1 of them"
        )
    placed = _place(files)
    if placed is None:
        one = files.values.find(_ROTATION) or files.values.find(_TRANSLATION)
        raise unexpected(
            name,
            "the rotation R and the translation T from the left to the right camera",
            f"{one.label} alone" if one else "neither",
        )
    rotation, shift, source = placed
    scale, doubts = _scale(files.values, metres, float(np.abs(shift).max()))
    pair = files.read(doubts)
    pose = np.eye(4)  # of the right camera in the left one's frame
    pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ (scale * shift)
    left, right = pair.left, pair.right
    if swap:
        pose, left, right = inverse_pose(pose), right, left
        pair = replace(pair, lens_assumptions=pair.lens_assumptions[::-1])
    _check(pose, source, scale, swap)
    return replace(pair, left=left, right=replace(right, pose=pose))


def parse_unit(text: str, owner: str) -> float:
    """Metres of a unit such as `mm`, or of a length such as `25mm`."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)?\s*(mm|cm|m)\s*", text)
    metres = _UNITS[match[2]][0] * float(match[1] or 1.0) if match else 0.0
    if not metres > 0.0:
        expected = "m, cm or mm, or the length of a square such as 25mm"
        raise unexpected(owner, expected, repr(text))
    return metres


def _scale(
    keys: CalibrationValues, given: float | None, length: float
) -> tuple[float, tuple[str, ...]]:
    """Metres of a translation's unit, and doubts about it."""
    said, square = keys.find(_UNIT), keys.find(_SQUARE)
    if said is not None:
        name = r"\A(?:(c)enti|(m)illi)?met(?:re|er)s?\Z"
        stated = parse_unit(re.sub(name, r"\1\2m", str(said.value).lower()), said.label)
        if given not in (None, stated):
            raise said.error(f"the unit that was given, {given:g} m", said.value)
        return stated, ()
    sides = None if square is None else parse_numbers(square.value)
    sizeless = sides is not None and bool((sides == 1.0).all()) and length > _LEAST_SQUARES
    if square is None or not sizeless or given not in (None, 1.0, 0.01, 0.001):
        return given or 1.0, ()
    if given is None:
        raise square.error(
            "the size of the board's squares",
            f"1: the translation, {length:.4g} long, seems to be in squares: give the length of "
            f"one as --unit, such as --unit 25mm ({0.025 * length:.4g} m), or --unit m, cm or mm "
            "if it is in that",
        )
    return given, (f"{square.label} is 1: is the translation in squares of the board?",)


_Place = tuple[FloatArray, FloatArray, FoundValue]
"""R, T in the files' unit, and the value that T is from for messages."""


def _place(files: _Files) -> _Place | None:
    """R and T from the left camera to the right one; None if the files do not have them."""
    right = files.keys[1]
    if right.side and (chain := right.find(_CHAINED)):
        pose = _transform(chain)
        return _rotation(pose[:3, :3], chain), pose[:3, 3], chain
    if files.apart.has(_ROTATION) and files.apart.has(_TRANSLATION):
        rotation, translation = files.apart.find(_ROTATION), files.apart.find(_TRANSLATION)
        assert rotation is not None and translation is not None  # noqa: PT018
        values = rotation.numbers((3, 9), "a rotation of 3 x 3 numbers, or a rotation vector")
        shift = translation.numbers((3,), "a translation of 3 numbers")
        if values.size == 3:
            from scipy.spatial.transform import Rotation

            return Rotation.from_rotvec(values).as_matrix(), shift, translation
        return _rotation(values.reshape(3, 3), rotation), shift, translation
    return _at_body(files) or _rectified(files)


def _transform(found: FoundValue) -> FloatArray:
    """(4, 4) pose, its rotation orthonormal."""
    pose = found.numbers((16,), "a transform of 4 x 4 numbers").reshape(4, 4)
    if np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > _ROTATION_TOLERANCE:
        raise found.error("a transform with the last row 0 0 0 1", pose[3].tolist())
    return np.block([[_rotation(pose[:3, :3], found), pose[:3, 3:]], [pose[3:]]])


def _at_body(files: _Files) -> _Place | None:
    """R and T from the poses of both cameras at a body, if present."""
    from_body = []
    for keys in files.keys:
        own = keys.find(_BODY_IN_CAMERA)
        found = own or keys.find(_CAMERA_IN_BODY)
        if found is None:
            return None
        from_body.append(_transform(found) if own else inverse_pose(_transform(found)))
        source = found
    pose = from_body[1] @ inverse_pose(from_body[0])
    return pose[:3, :3], pose[:3, 3], source


def _rectified(files: _Files) -> _Place | None:
    """R and T from rectification and projection matrices of both cameras, if present."""
    turns, shifts = [], []
    for keys in files.keys:
        turn, projection = keys.find(_RECTIFICATION), keys.find(_PROJECTION)
        if turn is None or projection is None:
            return None
        values = turn.numbers((9,), "a rectification of 3 x 3 numbers").reshape(3, 3)
        turns.append(_rotation(values, turn))
        matrix = projection.numbers((12,), "a projection of 3 x 4 numbers").reshape(3, 4)
        focal = matrix[[0, 1], [0, 1]]
        if not (focal > 0.0).all():
            raise projection.error("focal lengths above 0", focal.tolist())
        shifts.append(matrix[:, 3] / [*focal, 1.0])
        source = projection
    if not np.any(shifts[0] - shifts[1]):
        raise source.error(
            "the baseline by the focal length in P[0, 3] (a calibration of both cameras together)",
            f"{float(shifts[1][0]):g} as in the left camera's",
        )
    turn_back = turns[1].T
    return turn_back @ turns[0], turn_back @ (shifts[1] - shifts[0]), source


def _rotation(matrix: FloatArray, found: FoundValue) -> FloatArray:
    """Orthonormal rotation nearest to a rounded one."""
    u, scales, vt = np.linalg.svd(matrix)
    nearest: FloatArray = u @ vt
    if np.abs(scales - 1.0).max() > _ROTATION_TOLERANCE or np.linalg.det(nearest) < 0.0:
        raise found.error(
            f"a rotation matrix, orthonormal to {_ROTATION_TOLERANCE:g} with determinant 1",
            f"{matrix.tolist()!r:.120}",
        )
    return nearest


def _check(pose: FloatArray, source: FoundValue, scale: float, swap: bool) -> None:
    """Refuse a pair whose geometry no head can have."""
    with np.errstate(over="ignore"):  # an infinite baseline is refused as too long
        baseline = float(np.linalg.norm(pose[:3, 3]))
    if not LEAST_BASELINE_M <= baseline <= GREATEST_BASELINE_M:
        got = f"{baseline:.4g} m{_unit_hint(baseline / scale, scale)}"
        raise source.error("a baseline of 0.01 to 1 m", got)
    x, _, z = pose[:3, 3]
    if x < -0.5 * baseline:
        back = " without --swap" if swap else ": give --swap, or the files the other way round"
        raise source.error(
            "the right camera on the right of the left one",
            f"it {-1000.0 * x:.1f} mm on its left (are left and right swapped{back}?)",
        )
    if abs(z) > 0.9 * baseline:
        raise source.error(
            "two cameras side by side",
            f"the right one {1000.0 * z:.1f} mm along the left one's optical axis",
        )
    between = np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))
    if between > 90.0:
        raise source.error(
            "two cameras that look the same way",
            f"{between:.0f} degrees between their optical axes",
        )


def _unit_hint(baseline: float, scale: float) -> str:
    """Unit in which a baseline would be plausible."""
    for unit, (metres, name) in _UNITS.items():
        if metres != scale and LEAST_BASELINE_M <= metres * baseline <= GREATEST_BASELINE_M:
            return (
                f" (is it in {name}? give --unit {unit}: {metres * baseline:.4g} m; in squares of "
                "the board? give --unit with the length of one, such as 25mm)"
            )
    return " (was the calibration told how large the squares are?)"


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
    sensor, reasons = dict(PAIR["sensor"]), dict(PAIR_REASONS)
    if noise_px is not None:
        sensor["detection_noise_px"] = noise_px
        del reasons["sensor.detection_noise_px"]
    return (
        {"name": name}
        | eye_tables(cameras, eyes)
        | PAIR
        | {"sensor": sensor, "assumptions": {**reasons, **guesses}}
        | ({"calibration": asdict(calibration)} if calibration else {})
    )
