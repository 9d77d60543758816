"""Calibrated stereo pairs from files of OpenCV, ROS and kalibr."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from vergence.errors import ConfigurationError
from vergence.models.files.calibration_keys import (
    KALIBR_TRANSFORM,
    MATRIX,
    PROJECTION,
    RECTIFICATION,
    ROTATION,
    TRANSLATION,
    CalibrationValues,
    FoundValue,
    flat_array_of,
    refuse_unused_files,
)
from vergence.models.files.calibration_text import read_calibration
from vergence.models.files.intrinsics import Intrinsics, Lens, find_intrinsics
from vergence.models.parts import FloatArray

Unit = Literal["m", "cm", "mm"]
METRES: Final[dict[Unit, float]] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres per unit."""

# Range of plausible baselines; others suggest a wrong unit (chosen).
LEAST_BASELINE_M: Final = 0.01
GREATEST_BASELINE_M: Final = 1.0

_MAX_CENTRE_OFFSET: Final = 0.2
"""Distance of a principal point from the image centre, as a fraction of the image side, above
which it is doubted (chosen: false doubts against missed wrong image sizes)."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Tolerance on the singular values of a rotation; files have as few as four decimals (chosen)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoPair:
    """Two calibrated cameras that do not move: `x_right = R x_left + T`, as in OpenCV."""

    left: Intrinsics
    right: Intrinsics
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
        cameras = {"left": self.left, "right": self.right}
        said = [
            f"{eye} camera: {guess}"
            for eye, camera in cameras.items()
            for guess in (camera.lens_assumption, _far_from_middle(camera))
            if guess
        ]
        across, along, _ = np.abs(self.baseline_m)
        if along > across:
            said.append(
                "the cameras stand one above the other: N is turned so that its x axis points "
                "from the left one to the right one"
            )
        return tuple(said)


def _far_from_middle(camera: Intrinsics) -> str:
    """Doubt about the image size if the principal point is far from the image centre."""
    size = np.array([camera.width, camera.height])
    if (np.abs(camera.principal - (size - 1.0) / 2.0) <= _MAX_CENTRE_OFFSET * size).all():
        return ""
    u, v = camera.principal
    return (
        f"principal point ({u:.0f}, {v:.0f}) far from the middle of {camera.width} x "
        f"{camera.height} px: was the camera calibrated at this size?"
    )


def read_stereo(
    paths: Sequence[str | os.PathLike[str]],
    *,
    unit: Unit = "m",
    size: tuple[int, int] | None = None,
    lens: Lens | None = None,
    swap: bool = False,
) -> StereoPair:
    """Read a calibrated stereo pair.

    The files are OpenCV's (`cameraMatrix1`, `distCoeffs1`, ..., `R`, `T`, or `M1`, `D1`, ... in
    one file and `R`, `T` in another), two camera_info files of ROS, left first, or a camchain of
    kalibr. For ROS, rotation and baseline follow from the rectification and projection matrices:
    `R = R_right^T R_left`, `T = R_right^T (P_right[:, 3] / f' - P_left[:, 3] / f')`.

    Args:
        paths: the files, which together hold both cameras and their relative pose.
        unit: unit of the translation in the files, given by the square size at calibration.
        size: (width, height) in pixels, for files that do not give it.
        lens: the lens model, for files that do not name it.
        swap: true if the first camera of the files is the right one.

    Returns:
        The pair.

    Raises:
        ConfigurationError: a file cannot be read or is unused, a value is missing, or the pair
            is implausible.
    """
    names = [os.fspath(path) for path in paths]
    files = {name: read_calibration(name) for name in names}
    if len(files) < len(names):
        raise ConfigurationError(
            f"{', '.join(names)}: expected different files, got one of them twice"
        )
    together = CalibrationValues(files)
    sides = together.sides()
    if sides is not None:
        left, right = (find_intrinsics(together, side, size=size, lens=lens) for side in sides)
        placed = _placed(together)
        used = together.used
    else:
        left_keys, right_keys = _single_cameras(files)
        left, right = (
            find_intrinsics(keys, size=size, lens=lens) for keys in (left_keys, right_keys)
        )  # fmt: skip
        others = {n: f for n, f in files.items() if not CalibrationValues({n: f}).find(MATRIX)}
        apart = CalibrationValues(others)
        placed = _placed(apart)
        used = left_keys.used | right_keys.used | (apart.used if placed else set())
        placed = placed or _rectified(left_keys, right_keys)
    if placed is None:
        raise ConfigurationError(
            f"{together.name}: expected the rotation R and the translation T from the left to "
            f"the right camera, got {_without_place(together)}"
        )
    refuse_unused_files(names, used)
    rotation, translation, label = placed
    pair = StereoPair(
        left=left, right=right, rotation=rotation, translation_m=METRES[unit] * translation
    )
    if swap:
        pair = replace(
            pair, left=right, right=left, rotation=rotation.T, translation_m=pair.baseline_m
        )
    _check(pair, label, unit, swap)
    return pair


def _without_place(keys: CalibrationValues) -> str:
    one = keys.find(ROTATION) or keys.find(TRANSLATION)
    return f"{one.label} alone" if one else "neither"


def _single_cameras(
    files: Mapping[str, Mapping[str, Any]],
) -> tuple[CalibrationValues, CalibrationValues]:
    """Values of the left and right camera from files with one camera each."""
    singles = [
        keys for name in files if (keys := CalibrationValues({name: files[name]})).find(MATRIX)
    ]
    if len(singles) != 2:
        raise ConfigurationError(
            f"{', '.join(files)}: expected the camera matrices of a pair (such as cameraMatrix1 "
            f"and cameraMatrix2, or camera_matrix in a file for each), got {len(singles)} of them"
        )
    return singles[0], singles[1]


_Placed = tuple[FloatArray, FloatArray, str]
"""R, T in the files' unit, and the label of T's source for messages."""


def _placed(keys: CalibrationValues) -> _Placed | None:
    """R and T from the first camera to the second, by their keys or kalibr's chain, if present."""
    chain = keys.find(KALIBR_TRANSFORM)
    if chain is not None:
        if keys.find(MATRIX, "2"):
            raise ConfigurationError(f"{keys.name}: expected two cameras, got cam2 as well")
        pose = flat_array_of(chain, (16,), "a transform of 4 x 4 numbers").reshape(4, 4)
        return _rotation(pose[:3, :3], chain.label), pose[:3, 3], chain.label
    rotation, translation = keys.find(ROTATION), keys.find(TRANSLATION)
    if rotation is None or translation is None:
        return None
    values = flat_array_of(rotation, (3, 9), "a rotation of 3 x 3 numbers, or a rotation vector")
    shift = flat_array_of(translation, (3,), "a translation of 3 numbers")
    if values.size == 3:
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(values).as_matrix(), shift, translation.label
    return _rotation(values.reshape(3, 3), rotation.label), shift, translation.label


def _rectified(left: CalibrationValues, right: CalibrationValues) -> _Placed | None:
    """R and T from rectification and projection matrices of two camera_info files, if present."""
    turns, shifts, label = [], [], ""
    for keys in (left, right):
        turn, projection = keys.find(RECTIFICATION), keys.find(PROJECTION)
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


def _check(pair: StereoPair, label: str, unit: Unit, swap: bool) -> None:
    """Refuse a pair whose geometry no head can have."""
    with np.errstate(over="ignore"):  # an infinite baseline is refused as too long
        right = pair.baseline_m
        baseline = float(np.linalg.norm(right))
    if not LEAST_BASELINE_M <= baseline <= GREATEST_BASELINE_M:
        raise ConfigurationError(
            f"{label}: expected a baseline of 0.01 to 1 m, got {baseline:.4g} m"
            + _other_unit(baseline / METRES[unit], unit)
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


def _other_unit(baseline: float, unit: Unit) -> str:
    """Hint at the unit in which a baseline would be plausible."""
    fitting: list[Unit] = [
        other
        for other in ("mm", "cm", "m")
        if other != unit and LEAST_BASELINE_M <= METRES[other] * baseline <= GREATEST_BASELINE_M
    ]
    names = {"mm": "millimetres", "cm": "centimetres", "m": "metres"}
    if not fitting:
        return " (was the calibration told how large the squares are?)"
    first = fitting[0]
    return f" (is it in {names[first]}? give --unit {first}: {METRES[first] * baseline:.4g} m)"
