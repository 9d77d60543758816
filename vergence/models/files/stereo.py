"""Calibrated stereo pairs from files of OpenCV, ROS, kalibr, EuRoC and ORB-SLAM2."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.calibration_keys import (
    BODY_IN_CAMERA,
    CAMERA_IN_BODY,
    CHAINED,
    PROJECTION,
    RECTIFICATION,
    ROTATION,
    SQUARE,
    TRANSLATION,
    UNIT,
    CalibrationValues,
    FoundValue,
    flat_array_of,
)
from vergence.models.files.calibration_text import parse_numbers
from vergence.models.files.intrinsics import CalibratedCameras, CameraFiles, Lens, read_camera_files
from vergence.models.links import inverse_pose
from vergence.models.parts import FloatArray

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


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoPair(CalibratedCameras):
    """Two calibrated cameras that do not move: `x_right = R x_left + T`, as in OpenCV."""

    rotation: FloatArray
    """(3, 3) R, orthonormal."""
    translation_m: FloatArray
    """(3,) T, metres."""

    @property
    def baseline_m(self) -> FloatArray:
        """(3,) position of the right camera in the left one's frame, metres."""
        return -self.rotation.T @ self.translation_m

    @property
    def guesses(self) -> tuple[str, ...]:
        """Doubtful or assumed values that the user should check, one phrase each."""
        said = list(super().guesses)
        across, along, _ = np.abs(self.baseline_m)
        if along > across:
            said.append(
                "the cameras stand one above the other: N is turned so that its x axis points "
                "from the left one to the right one (are both turned about their optical axes?)"
            )
        roll = np.degrees(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))
        if abs(roll) > _ODD_ROLL_DEG:
            said.append(
                f"the right camera is turned by {abs(roll):.0f} degrees about its optical axis "
                "against the left one: is that how it is mounted, and are its images as it "
                "delivers them?"
            )
        return tuple(said)


def read_stereo(
    paths: Sequence[str | os.PathLike[str]],
    *,
    unit: str | None = None,
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
    swap: bool = False,
) -> StereoPair:
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
        The pair.

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
    pair = StereoPair(
        left=files.cameras[0],
        right=files.cameras[1],
        rotation=rotation,
        translation_m=scale * translation,
        notes=(*doubts, *files.notes()),
    )
    if swap:
        pair = replace(
            pair, left=pair.right, right=pair.left, rotation=rotation.T,
            translation_m=pair.baseline_m,
        )  # fmt: skip
    _check(pair, label, scale, swap)
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


def _check(pair: StereoPair, label: str, scale: float, swap: bool) -> None:
    """Refuse a pair whose geometry no head can have."""
    with np.errstate(over="ignore"):  # an infinite baseline is refused as too long
        right = pair.baseline_m
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
    between = np.degrees(np.arccos(np.clip(pair.rotation[2, 2], -1.0, 1.0)))
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
