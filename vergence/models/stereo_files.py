"""Calibrated cameras and stereo pairs from the files of other tools."""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.calibration_files import (
    SPELLINGS,
    CalibrationValues,
    FoundValue,
    parse_numbers,
    unexpected,
)
from vergence.models.camera import Camera, CameraResponse, Cameras, Lens, camera_matrix
from vergence.models.geometry import inverse_pose
from vergence.models.head_file import (
    PAIR,
    PAIR_REASONS,
    camera_fields,
    check_head_name,
    eye_tables,
)
from vergence.models.head_joints import pose_fields
from vergence.models.lens import BROWN_CONRADY
from vergence.models.parts import EYE_NAMES, CalibrationRecord, FloatArray

_LENSES: Final = {
    name: lens
    for lens, names in {
        "brown-conrady": "plumbbob radtan radialtangential brownconrady brown opencv",
        "rational": "rational rationalpolynomial fullopencv",
        "fisheye": "fisheye equidistant equi kannalabrandt kannalabrandt4 kannalabrandt8 kb4 kb8 "
        "opencvfisheye cv2fisheye",
        "": " none pinhole perspective rectilinear",
    }.items()
    for name in names.split(" ")
}
"""Lens model by the name that files use; empty if the number of coefficients must decide."""
_NAMES_A_LENS: Final = re.compile("(distortion|lens|projection)model|distortiontype")
"""Keys whose value can be nothing but a lens model; of others, an unknown one may be a product."""
_UNSUPPORTED: Final = re.compile(
    r"omni(?!vision)|^mei|ucm|unified|^ds$|doublesphere|catadioptric|ocam|scaramuzza|^fov|ftheta|thinprism"
    r"|division|inverse|polynomial|stereographic|equisolid|orthographic|spherical"
    r"|equirectangular|panoram|brown|conrady|radial|fisheye|brandt"
)
"""Part of a lens model's name that none of the supported ones has."""
# Distances of a principal point from the image centre, as a fraction of the image side (chosen).
_MAX_CENTRE_OFFSET: Final = 0.2  # doubted above: false doubts against missed wrong image sizes
_SWAPPED_OFFSET: Final = 0.1  # with half of it, swapped sides fit: a swapped 5:4 image has 0.125
_UNITS: Final = {"mm": (0.001, "millimetres"), "cm": (0.01, "centimetres"), "m": (1.0, "metres")}
"""Metres per unit (physical), and its name."""

# Range of plausible baselines; others suggest a wrong unit (chosen).
LEAST_BASELINE_M: Final = 0.01
GREATEST_BASELINE_M: Final = 1.0
_LEAST_SQUARES: Final = 0.2  # baseline in squares of a board; a shorter one is in metres (chosen)
_ODD_ROLL_DEG: Final = 45.0  # of one camera against the other, doubted above (chosen)
_ROTATION_TOLERANCE: Final = 1e-3  # on singular values; files have as few as 4 decimals (chosen)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadCameras(Cameras):
    """Cameras of calibration files; left and right are one object if one stands for both eyes.

    Of a pair that does not move, the right one's pose is that in the left one's frame.
    """

    lens_assumptions: tuple[str, str] = ("", "")
    """Assumption about each lens that the files do not tell; empty for none."""
    notes: tuple[str, ...] = ()  # assumptions about the files, one phrase each

    @property
    def assumed(self) -> dict[str, str]:
        """Assumptions about the lenses by key of a head file."""
        lenses = zip(EYE_NAMES, self.lens_assumptions, strict=True)
        return {f"eyes.{eye}.distortion": said for eye, said in lenses if said}

    @property
    def guesses(self) -> tuple[str, ...]:
        """Doubtful or assumed values that the user should check, one phrase each."""
        said = [
            [phrase for phrase in (assumed, _principal_doubt(camera)) if phrase]
            for camera, assumed in zip(self, self.lens_assumptions, strict=True)
        ]
        if self.left is self.right:
            return (*said[0], *self.notes)
        eyes = zip(EYE_NAMES, said, strict=True)
        named = [f"{eye} camera: {phrase}" for eye, phrases in eyes for phrase in phrases]
        return (*named, *self.notes, *_mounting_doubts(self.right.pose))


def _principal_doubt(camera: Camera) -> str:
    if _off_centre(camera.principal, *camera.size) <= _MAX_CENTRE_OFFSET:
        return ""
    u, v = camera.principal
    return (
        f"principal point ({u:.0f}, {v:.0f}) far from the middle of {camera.width} x "
        f"{camera.height} px: was the camera calibrated at this size?"
    )


def _mounting_doubts(pose: FloatArray) -> Iterator[str]:
    across, along, _ = np.abs(pose[:3, 3])
    if along > across:
        yield (
            "the cameras stand one above the other: N is turned so that its x axis points "
            "from the left one to the right one (are both turned about their optical axes?)"
        )
    roll = np.degrees(np.arctan2(pose[0, 1], pose[0, 0]))
    if abs(roll) > _ODD_ROLL_DEG:
        yield (
            f"the right camera is turned by {abs(roll):.0f} degrees about its optical axis "
            "against the left one: is that how it is mounted, and are its images as it "
            "delivers them?"
        )


def _off_centre(principal: FloatArray, *size: int) -> float:
    """Distance of a principal point from the image centre, as a fraction of the sides."""
    return float(np.max(np.abs((principal - (np.array(size) - 1.0) / 2.0) / size)))


def read_intrinsics(
    paths: Sequence[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    lens: str | None = None,
) -> ReadCameras:
    """Read the left and the right camera: from one file, two (left first), or one for both eyes."""
    values = CalibrationValues.read(paths)
    cameras, apart = values.cameras()
    read = [_camera(keys, size, lens) for keys in cameras]
    if apart is not values:
        _refuse_swapped(cameras)
    place = ("ROTATION", "TRANSLATION", "CHAINED", "BODY_IN_CAMERA", "CAMERA_IN_BODY", "UNIT")
    for keys, name in product(cameras, place):  # that of the robot, or a head's own
        keys.find(name, shared=True)
    (left, said), (right, other) = read[0], read[-1]
    return ReadCameras(left, right, lens_assumptions=(said, other), notes=values.notes())


def _refuse_swapped(cameras: Sequence[CalibrationValues]) -> None:
    """Refuse camera_info files of ROS given right camera first."""
    found = [one for keys in cameras if (one := keys.find("PROJECTION"))]
    values = [p for one in found if (p := parse_numbers(one.value)) is not None and p.size == 12]
    if len(values) == 2:
        found[0].expect(
            not values[0].flat[3] < 0.0 == values[1].flat[3],
            "the right camera on the right of the left one",
            "the baseline, P[0, 3], in the left camera's file (are left and right swapped: give "
            "the files the other way round?)",
        )


def _camera(
    keys: CalibrationValues, size: tuple[int, int] | None, lens: str | None
) -> tuple[Camera, str]:
    """One camera, and the assumption about its lens."""
    named = _named_lens(keys)  # an unsupported one explains what else is odd
    (matrix,) = keys.find_all("MATRIX")
    focal, principal = _pinhole(matrix)
    size = _image_size(keys, size)
    _check_principal(principal, matrix, *size)
    _refuse_part(keys, size)
    if lens is not None and named is not None and lens != named:
        raise unexpected(keys.name, f"the lens that was given, {lens}", named)
    found, guess = _lens(keys, lens or named)
    return Camera(size=size, matrix=camera_matrix(focal, principal), lens=found), guess


def _pinhole(found: FoundValue) -> tuple[FloatArray, FloatArray]:
    values = found.numbers((4, 9), "a camera matrix of 3 x 3 numbers, or f_u, f_v, u_0, v_0")
    focal, principal = values[:2], values[2:]  # kalibr's form of a pinhole
    if values.size == 9:
        matrix = values.reshape(3, 3)
        zeros = [*matrix[[1, 2, 2], [0, 0, 1]], matrix[2, 2] - 1.0]
        got = f"{matrix.tolist()} (is it transposed, as MATLAB has it?)"
        found.expect(np.abs(zeros).max() <= 1e-9, "rows f_u 0 u_0, 0 f_v v_0, 0 0 1", got)
        focal, principal, skew = matrix[[0, 1], [0, 1]], matrix[:2, 2], matrix[0, 1]
        got = f"{skew:g} (calibrate with it fixed)"
        found.expect(abs(skew) <= 1e-6 * abs(focal[0]), "no skew", got)
    found.expect((focal > 10.0).all(), "focal lengths in pixels above 10", focal.tolist())
    return focal, principal


def _image_size(keys: CalibrationValues, given: tuple[int, int] | None) -> tuple[int, int]:
    if found := keys.find("SIZE", shared=True):
        sides = found.numbers((2,), "an image size, width and height in pixels")
    elif found := keys.find("SHAPE", shared=True):
        sides = found.numbers((2, 3), "an image's shape, its rows and columns")[1::-1]
    else:
        found, other = (keys.find(name, shared=True) for name in ("WIDTH", "HEIGHT"))
        if not found or not other:
            if given is None:
                got = "none: write these two into it, or give --size WIDTHxHEIGHT"
                raise unexpected(keys.name, "the image size (image_width and image_height)", got)
            return given
        both = [one.numbers((1,), "an image's side in pixels") for one in (found, other)]
        sides = np.concatenate(both)
    whole = (sides >= 16) & (sides <= 20_000) & (sides == np.round(sides))
    found.expect(whole.all(), "an image size in whole pixels, 16 to 20000", sides.tolist())
    size = int(sides[0]), int(sides[1])
    if given is not None:
        expected = f"the size that was given, {given[0]} x {given[1]} px"
        got = f"{size[0]} x {size[1]} (the calibration is of that size)"
        found.expect(given == size, expected, got)
    return size


def _check_principal(principal: FloatArray, found: FoundValue, width: int, height: int) -> None:
    """Refuse an image size that the principal point contradicts."""
    off, swapped = _off_centre(principal, width, height), _off_centre(principal, height, width)
    found.expect(
        off <= _SWAPPED_OFFSET or swapped >= off / 2.0,
        f"a principal point near the middle of {width} x {height} px",
        f"{principal.tolist()}, that of {height} x {width}: is the image size written as rows "
        "by columns? It is (width, height)",
    )
    found.expect(
        off < 0.5,
        f"a principal point inside the image of {width} x {height} px",
        f"{principal.tolist()} (is the image size (width, height)?)",
    )


def _refuse_part(keys: CalibrationValues, size: tuple[int, int]) -> None:
    """Refuse a camera_info of binned or cropped images."""
    full = "a calibration of the full image, which is that of a head"
    advice = "if the images are full ones, else calibrate at the size that they have"
    found, factors = _counts(keys, "binningx", "binningy")
    if found and not set(factors) <= {0.0, 1.0}:
        x, y = (max(factor, 1.0) for factor in factors)
        raise unexpected(found.label, full, f"binning {x:g} x {y:g}: set both to 1 {advice}")
    names = ("roiwidth", "roiheight", "roixoffset", "roiyoffset")
    found, (width, height, x, y) = _counts(keys, *names)
    region = width or size[0], height or size[1], x, y
    if found and region != (*size, 0.0, 0.0):
        got = "a region of {:g} x {:g} px at ({:g}, {:g})".format(*region)
        raise unexpected(found.label, full, f"{got}: set all of it to 0 {advice}")


def _counts(keys: CalibrationValues, *names: str) -> tuple[FoundValue | None, list[float]]:
    """The largest of some counts of pixels, for messages, and all of them; 0 for missing keys."""
    found = [keys.find(name, shared=True) for name in names]
    values = [float(one.numbers((1,), "a number of pixels")[0]) if one else 0.0 for one in found]
    return found[int(np.argmax(np.abs(values)))], values


def _lens(keys: CalibrationValues, lens: str | None) -> tuple[Lens, str]:
    found = keys.find("DISTORTION")
    if found is None or (parse_numbers(found.value) is not None and not np.size(found.value)):
        return Lens(lens or BROWN_CONRADY), "" if found else "no distortion coefficients"
    values = found.numbers((1, 2, 4, 5, 8, 12, 14), "4, 5, 8, 12 or 14 distortion coefficients")
    if lens == "fisheye":
        found.expect(values.size == 4, "4 coefficients of a fisheye lens", values.size)
        return Lens(lens, values), ""
    found.expect(
        not np.any(values[8:]),
        f"no thin prism and no tilt of the sensor (coefficients 9 to {values.size} at zero)",
        f"{values[8:].tolist()}: these lenses are not supported",
    )
    rational = np.append(values, np.zeros(8))[:8]
    if lens == "rational" or rational[5:].any():
        expected = "4 or 5 coefficients of the model brown-conrady"
        found.expect(lens != BROWN_CONRADY, expected, values.size)
        return Lens("rational", rational), ""
    guess = (
        "4 distortion coefficients without a model are taken for k1, k2, p1, p2 of brown-conrady "
        "(--lens fisheye if they are of cv2.fisheye)"
    )
    return Lens(BROWN_CONRADY, rational[:5]), guess if lens is None and values.size == 4 else ""


def _named_lens(keys: CalibrationValues) -> str | None:
    """Lens model named in the files; None if there is none."""
    named: dict[str, str] = {}
    if flag := keys.find("FISHEYE", shared=True):
        number = parse_numbers(flag.value)
        if flag.value is True or (number is not None and number.size == 1 and number.item()):
            named["fisheye"] = flag.label
    for stem in SPELLINGS["MODEL"]:
        found = keys.find(stem, shared=True)
        if found is None:
            continue
        plain = re.sub(r"[^a-z0-9]", "", str(found.value).lower())
        if plain not in _LENSES:  # such as pinhole-radtan
            plain = plain.removeprefix("pinhole")
        if lens := _LENSES.get(plain):
            named[lens] = found.label
        elif lens is None:
            found.expect(
                not (_NAMES_A_LENS.match(stem) or _UNSUPPORTED.search(plain)),
                "a lens model such as plumb_bob, radtan, rational_polynomial, fisheye or "
                "equidistant",
                f"{found.value!r:.80}, which is not supported",
            )
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
    values = CalibrationValues.read(paths)
    cameras, apart = values.cameras()
    read = [_camera(keys, size, lens) for keys in cameras]
    if len(read) != 2:
        raise ConfigurationError(
            f"{values.name}: expected the camera matrices of a pair (such as cameraMatrix1 and "
            "cameraMatrix2, or camera_matrix in a file for each), got 1 of them"
        )
    rotation, shift, found = _place(values, cameras, apart)
    scale, doubts = _scale(values, metres, float(np.abs(shift).max()))
    pose = np.eye(4)  # of the right camera in the left one's frame
    pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ (scale * shift)
    notes = (*doubts, *values.notes())
    if swap:
        pose, read = inverse_pose(pose), read[::-1]
    _check(pose, found, scale, swap)
    (left, said), (right, other) = read
    right = replace(right, pose=pose)
    return ReadCameras(left, right, lens_assumptions=(said, other), notes=notes)


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
    said, square = keys.find("UNIT"), keys.find("SQUARE")
    if said:
        name = r"\A(?:(c)enti|(m)illi)?met(?:re|er)s?\Z"
        stated = parse_unit(re.sub(name, r"\1\2m", str(said.value).lower()), said.label)
        if given is not None:
            said.expect(given == stated, f"the unit that was given, {given:g} m", said.value)
        return stated, ()
    sides = parse_numbers(square.value) if square else None
    sizeless = sides is not None and (sides == 1.0).all() and length > _LEAST_SQUARES
    if square is None or not sizeless or given not in (None, 1.0, 0.01, 0.001):
        return given or 1.0, ()
    if given is None:
        got = (
            f"1: the translation, {length:.4g} long, seems to be in squares: give the length of "
            f"one as --unit, such as --unit 25mm ({0.025 * length:.4g} m), or --unit m, cm or mm "
            "if it is in that"
        )
        raise unexpected(square.label, "the size of the board's squares", got)
    return given, (f"{square.label} is 1: is the translation in squares of the board?",)


def _place(
    values: CalibrationValues, cameras: Sequence[CalibrationValues], apart: CalibrationValues
) -> tuple[FloatArray, FloatArray, FoundValue]:
    """R, T from the left camera to the right one in the files' unit, and the value T is from."""
    left, right = cameras
    if right.side and (chain := right.find("CHAINED")):
        pose = _transform(chain)
        return _rotation(pose[:3, :3], chain), pose[:3, 3], chain
    if both := apart.find_all("ROTATION", "TRANSLATION"):
        turn, found = both
        rotation = turn.numbers((3, 9), "a rotation of 3 x 3 numbers, or a rotation vector")
        shift = found.numbers((3,), "a translation of 3 numbers")
        if rotation.size == 3:
            from scipy.spatial.transform import Rotation

            return Rotation.from_rotvec(rotation).as_matrix(), shift, found
        return _rotation(rotation, turn), shift, found
    if (one := _from_body(left)) and (other := _from_body(right)):
        pose = other[0] @ inverse_pose(one[0])
        return pose[:3, :3], pose[:3, 3], other[1]
    if (from_left := _rectified(left)) and (from_right := _rectified(right)):
        (turn_left, shift_left, _), (turn_right, shift_right, found) = from_left, from_right
        found.expect(
            np.any(shift_left - shift_right),
            "the baseline by the focal length in P[0, 3] (a calibration of both cameras together)",
            f"{float(shift_right[0]):g} as in the left camera's",
        )
        return turn_right.T @ turn_left, turn_right.T @ (shift_right - shift_left), found
    alone = values.find("ROTATION") or values.find("TRANSLATION")
    raise unexpected(
        values.name,
        "the rotation R and the translation T from the left to the right camera",
        f"{alone.label} alone" if alone else "neither",
    )


def _transform(found: FoundValue) -> FloatArray:
    """(4, 4) pose, its rotation orthonormal."""
    pose = found.numbers((16,), "a transform of 4 x 4 numbers").reshape(4, 4)
    near = np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() <= _ROTATION_TOLERANCE
    found.expect(near, "a transform with the last row 0 0 0 1", pose[3].tolist())
    return np.block([[_rotation(pose[:3, :3], found), pose[:3, 3:]], [pose[3:]]])


def _from_body(keys: CalibrationValues) -> tuple[FloatArray, FoundValue] | None:
    """Pose of a body in a camera's frame, if present."""
    if found := keys.find("BODY_IN_CAMERA"):
        return _transform(found), found
    found = keys.find("CAMERA_IN_BODY")
    return (inverse_pose(_transform(found)), found) if found else None


def _rectified(keys: CalibrationValues) -> tuple[FloatArray, FloatArray, FoundValue] | None:
    """Rotation to a camera's rectified frame, and its offset in that, if present."""
    both = keys.find_all("RECTIFICATION", "PROJECTION")
    if not both:
        return None
    turn, found = both
    rotation = _rotation(turn.numbers((9,), "a rectification of 3 x 3 numbers"), turn)
    matrix = found.numbers((12,), "a projection of 3 x 4 numbers").reshape(3, 4)
    focal = matrix[[0, 1], [0, 1]]
    found.expect((focal > 0.0).all(), "focal lengths above 0", focal.tolist())
    return rotation, matrix[:, 3] / [*focal, 1.0], found


def _rotation(values: FloatArray, found: FoundValue) -> FloatArray:
    """Orthonormal rotation nearest to a rounded one of 9 numbers."""
    matrix = values.reshape(3, 3)
    u, scales, vt = np.linalg.svd(matrix)
    nearest: FloatArray = u @ vt
    found.expect(
        np.abs(scales - 1.0).max() <= _ROTATION_TOLERANCE and np.linalg.det(nearest) >= 0.0,
        f"a rotation matrix, orthonormal to {_ROTATION_TOLERANCE:g} with determinant 1",
        f"{matrix.tolist()!r:.120}",
    )
    return nearest


def _check(pose: FloatArray, found: FoundValue, scale: float, swap: bool) -> None:
    """Refuse a pair whose geometry no head can have."""
    with np.errstate(over="ignore"):  # an infinite baseline is refused as too long
        baseline = float(np.linalg.norm(pose[:3, 3]))
    got = f"{baseline:.4g} m{_unit_hint(baseline / scale, scale)}"
    plausible = LEAST_BASELINE_M <= baseline <= GREATEST_BASELINE_M
    found.expect(plausible, "a baseline of 0.01 to 1 m", got)
    x, _, z = pose[:3, 3]
    back = " without --swap" if swap else ": give --swap, or the files the other way round"
    found.expect(
        x >= -0.5 * baseline,
        "the right camera on the right of the left one",
        f"it {-1000.0 * x:.1f} mm on its left (are left and right swapped{back}?)",
    )
    found.expect(
        abs(z) <= 0.9 * baseline,
        "two cameras side by side",
        f"the right one {1000.0 * z:.1f} mm along the left one's optical axis",
    )
    between = np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))
    got = f"{between:.0f} degrees between their optical axes"
    found.expect(between <= 90.0, "two cameras that look the same way", got)


def _unit_hint(baseline: float, scale: float) -> str:
    """Unit in which a baseline would be plausible."""
    for unit, (metres, name) in _UNITS.items():
        length = metres * baseline
        if metres != scale and LEAST_BASELINE_M <= length <= GREATEST_BASELINE_M:
            return (
                f" (is it in {name}? give --unit {unit}: {length:.4g} m; in squares of the board? "
                "give --unit with the length of one, such as 25mm)"
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
    own = {} if response is None else {"response": response}
    fields = [
        own | camera_fields(camera) | pose_fields("position_m", camera.pose) for camera in pair
    ]
    tables = eye_tables(pair, fields)
    noise = {} if noise_px is None else {"detection_noise_px": noise_px}
    reasons = {
        key: why for key, why in PAIR_REASONS.items() if key.removeprefix("sensor.") not in noise
    }
    document = {
        "name": name,
        "image": tables.get("image"),
        **PAIR,
        "sensor": PAIR["sensor"] | noise,
        "eyes": tables["eyes"],
        "assumptions": reasons | pair.assumed,
        "calibration": asdict(calibration) if calibration else None,
    }
    return {key: value for key, value in document.items() if value}
