"""Compare calibrations by OpenCV's procedure and by the package on held-out photographs.

    python -m benchmarks.calibration_photographs --set FOLDER TARGET LENS [...] [--csv FILE]

A folder has left*.jpg and right*.jpg of a pair, or any images of one camera. A random half of the
views is used for calibration and the other half for evaluation, then the other way round, several
times. The evaluation of a view uses only its corners: it fits the flat board's pose, one for both
images of a pair, without weights, and the residual is the error. To favour neither procedure,
both are evaluated on OpenCV's corners and on the package's corners, in the views in which both
found them.

OpenCV's procedure is that of its samples and its documentation: `findChessboardCorners`,
`cornerSubPix` in a window of 11 x 11 pixels, `calibrateCamera` for each camera and
`stereoCalibrate` with `CALIB_FIX_INTRINSIC`; `cv2.fisheye` for that lens.

The columns are root mean square residuals in px, means over all halves:

opencv            OpenCV's procedure, evaluated on the package's corners
opencv_ours       OpenCV's solvers on the package's corners, evaluated likewise
ours              the package with the same lens model, evaluated likewise
ratio             ours / opencv, the geometric mean over all halves
ratio_error       relative standard error of ratio, as if halves were independent
*_by_theirs       evaluated on OpenCV's corners
*_failed          halves whose calibration failed; they count in no mean
*_bent            evaluation also fits the board's curvature, one for all views: the evaluation of a
                  bent board as a flat one favours lenses with errors that compensate the bend

For boards other than checkerboards, which OpenCV's sample cannot find, the columns of OpenCV's
procedure and corners are missing, and ratio is ours / opencv_ours.
"""

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vergence.calibration.adjustment import BundleAdjustment, CameraRig
from vergence.calibration.cameras import (
    estimate_board_poses,
    fit_camera,
    fit_camera_pair,
    fit_consistent_views,
)
from vergence.calibration.observations import BoardObservations, detect_board_corners, parse_board
from vergence.errors import ConfigurationError
from vergence.models.parts import FloatArray
from vergence.perception.photographs import photographs_in_folder
from vergence.vision import read_image
from vergence.vision.targets import Checkerboard

HALF_WINDOW: Final = 5
"""Half window of `cornerSubPix`, px (chosen: that of OpenCV's samples/python/calibrate.py)."""
_STOP: Final = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.01)
SPLITS: Final = 5
"""Random splits in halves, each of which is used for calibration (chosen: run time)."""
_BENDINGS: Final = 4
"""Gauss-Newton steps for the curvature, on which pixels depend almost linearly (numerical)."""
_NO_GUESS: Final[Any] = None
_FISHEYE: Final = "fisheye"
_SUFFIXES: Final = {
    "ours": "",
    "ours_bent": "_bent",
    "theirs": "_by_theirs",
    "theirs_bent": "_bent_by_theirs",
}
"""Suffixes of columns, by the corners and the board model of the evaluation."""


class Corners(NamedTuple):
    """Corners of each view found by a procedure, and the image sizes."""

    pixels: FloatArray
    """(c, v, n, 2) px; nan for views without a board."""
    sizes: tuple[tuple[int, int], ...]
    """(c) width and height, px."""

    def of(self, views: NDArray[np.bool_]) -> "Corners":
        """Corners of some views."""
        return self._replace(pixels=self.pixels[:, views])


def files_of(folder: Path) -> list[list[Path]]:
    """(c, v) images of a folder by camera; views are in the order of the numbers in their names."""

    def number(path: Path) -> tuple[int, ...]:
        return tuple(map(int, re.findall(r"\d+", path.stem)))

    files = sorted(photographs_in_folder(folder), key=lambda path: (number(path), path.name))
    eyes = [[path for path in files if path.stem.startswith(eye)] for eye in ("left", "right")]
    if not all(eyes):
        return [files]
    views = [{number(path): path for path in each} for each in eyes]
    both = [key for key in views[0] if key in views[1]]
    return [[each[key] for key in both] for each in views]


def opencv_corners(
    board: Checkerboard, files: Sequence[Sequence[Path]], like: FloatArray, half_window: int
) -> FloatArray:
    """(c, v, n, 2) corners found as in OpenCV's sample, reordered to match the corners `like`."""
    pixels = np.full_like(like, np.nan)
    for camera, row in enumerate(files):
        for view, path in enumerate(row):
            image = read_image(path)
            found, corners = cv2.findChessboardCorners(image, (board.columns, board.rows))
            if not found:
                continue
            corners = cv2.cornerSubPix(
                image, corners, (half_window, half_window), (-1, -1), _STOP
            ).reshape(-1, 2)
            there = like[camera, view]
            apart = [np.abs(each - there).max() for each in (corners, corners[::-1])]
            pixels[camera, view] = corners[::-1] if apart[1] < apart[0] else corners
    return pixels


def opencv_calibrated(board: FloatArray, corners: Corners, lens: str) -> CameraRig:
    """Calibrate a camera or a pair by OpenCV's procedure."""
    lists = [
        [
            (board[there].astype(np.float32), view[there].astype(np.float32))
            for view, there in zip(each, np.isfinite(each).all(axis=-1), strict=True)
            if there.any()
        ]
        for each in corners.pixels
    ]
    alone = [
        _opencv_camera([b for b, _ in views], [p for _, p in views], size, lens)
        for views, size in zip(lists, corners.sizes, strict=True)
    ]
    values = tuple(np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *np.ravel(d)]) for k, d in alone)
    if len(alone) == 1:
        return CameraRig.single(lens, values[0])
    boards, left, right = [], [], []
    for one, other in zip(*corners.pixels, strict=True):
        there = np.isfinite(one).all(axis=-1) & np.isfinite(other).all(axis=-1)
        if there.sum() > 3:
            boards.append(board[there].astype(np.float32))
            left.append(one[there].astype(np.float32))
            right.append(other[there].astype(np.float32))
    (k1, d1), (k2, d2) = alone
    if lens == _FISHEYE:
        shaped: Any = [[each[None].astype(float) for each in row] for row in (boards, left, right)]
        fisheye: Any = cv2.fisheye
        place: Any = cv2 if hasattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC") else fisheye
        found: Any = fisheye.stereoCalibrate(
            *shaped, k1, d1, k2, d2, corners.sizes[0], flags=place.CALIB_FIX_INTRINSIC
        )
    else:
        found = cv2.stereoCalibrate(
            boards, left, right, k1, d1, k2, d2, corners.sizes[0], flags=cv2.CALIB_FIX_INTRINSIC
        )
    return CameraRig((lens, lens), values, np.asarray(found[5]), np.ravel(found[6]), np.zeros(3))


def _opencv_camera(
    boards: list[NDArray[np.float32]],
    points: list[NDArray[np.float32]],
    size: tuple[int, int],
    lens: str,
) -> tuple[FloatArray, FloatArray]:
    """Camera matrix and distortion coefficients."""  # fmt: skip
    if lens == _FISHEYE:
        fisheye: Any = cv2.fisheye
        place: Any = cv2 if hasattr(cv2, "CALIB_RECOMPUTE_EXTRINSIC") else fisheye
        shaped: Any = [[each[None].astype(float) for each in row] for row in (boards, points)]
        flags = place.CALIB_RECOMPUTE_EXTRINSIC | place.CALIB_FIX_SKEW
        try:
            found: Any = fisheye.calibrate(*shaped, size, np.eye(3), np.zeros(4), flags=flags)
        except cv2.error:  # its own initial guess leads to boards without a pose: retry with ours
            guess: Any = np.diag([max(size) / np.pi] * 2 + [1.0])
            guess[:2, 2] = 0.5 * np.array(size)
            flags |= place.CALIB_USE_INTRINSIC_GUESS
            found = fisheye.calibrate(*shaped, size, guess, np.zeros(4), flags=flags)
        return found[1], found[2]
    rational = cv2.CALIB_RATIONAL_MODEL if lens == "rational" else 0
    found = cv2.calibrateCamera(boards, points, size, _NO_GUESS, _NO_GUESS, flags=rational)
    return found[1], np.ravel(found[2])[: 8 if rational else 5]


def our_calibrated(seen: BoardObservations, lens: str) -> CameraRig:
    """Calibrate a camera or a pair by the package; the fitted curvature of the board is dropped."""
    alone = [
        fit_camera(seen.select_camera(i), lens, fit_consistent_views(seen.select_camera(i)))
        for i in range(len(seen.image_sizes))
    ]
    fit = alone[0] if len(alone) == 1 else fit_camera_pair(seen, *alone)[1]
    return fit.solution.rig._replace(board_curvatures=np.zeros(3))


def judged(board: FloatArray, rig: CameraRig, corners: Corners, *, bent: bool) -> FloatArray:
    """(v) root mean square residual of the board's best pose in each view, px.

    Args:
        board: (n, 3) corners of the flat board, m.
        rig: calibrated cameras.
        corners: corners of the evaluated views.
        bent: True to fit the board's curvature as well, one for all views.
    """
    problem = BundleAdjustment(board, corners.pixels, np.ones_like(corners.pixels))
    start = estimate_board_poses(problem.select_camera(0), rig.alone(0))
    rig = rig._replace(board_curvatures=np.zeros(3))
    fitted = problem.fit_poses(rig, start)
    for _ in range(_BENDINGS if bent else 0):
        now, bend = problem.linearised(rig, fitted.poses), rig.blocks[-1]
        step = -np.linalg.lstsq(now.matrix[bend, bend], now.gradient[bend], rcond=None)[0]
        rig = rig._replace(board_curvatures=rig.board_curvatures + step)
        fitted = problem.fit_poses(rig, fitted.poses)
    return np.asarray(
        np.sqrt((fitted.residuals**2).sum(axis=(0, 2, 3)) / problem.seen.sum(axis=(0, 2)))
    )


def _halves(views: int) -> list[NDArray[np.bool_]]:
    """Masks (v) of the views used for calibration; each is followed by its complement."""
    rng = np.random.default_rng(0)
    halves = []
    for _ in range(SPLITS):
        half = np.zeros(views, bool)
        half[rng.permutation(views)[: views // 2]] = True
        halves += [half, ~half]
    return halves


def compared(folder: Path, target: str, lens: str, half_window: int) -> dict[str, Any]:
    """Row of the table: results of one data set."""
    board, files = parse_board(target), files_of(folder)
    points = np.insert(board.corners_m, 2, 0.0, axis=1)
    seen, _ = detect_board_corners(board, files)
    ours = Corners(np.where(seen.usable[..., None, None], seen.pixels, np.nan), seen.image_sizes)
    corners = {"ours": ours}
    if isinstance(board, Checkerboard):
        theirs = opencv_corners(board, files, ours.pixels, half_window)
        corners["theirs"] = Corners(theirs, seen.image_sizes)
    # a view is evaluated if both finders found corners in all of its images
    judges = np.logical_and.reduce(
        [
            np.isfinite(each.pixels).all(axis=-1).any(axis=-1).all(axis=0)
            for each in corners.values()
        ]
    )
    ways: dict[str, Callable[[NDArray[np.bool_]], CameraRig]] = {
        "opencv_ours": lambda views: opencv_calibrated(points, ours.of(views), lens),
        "ours": lambda views: our_calibrated(seen.select(views), lens),
    }
    if "theirs" in corners:
        ways["opencv"] = lambda views: opencv_calibrated(points, corners["theirs"].of(views), lens)
    row: dict[str, Any] = {
        "data_set": folder.name,
        "target": str(board),
        "lens": lens,
        "cameras": len(files),
        "views": len(files[0]),
        "judges": int(judges.sum()),
        **{f"found_{name}": int(np.isfinite(each.pixels).all(axis=-1).any(axis=-1).sum())
           for name, each in corners.items()},
    }  # fmt: skip
    halves = _halves(len(judges))
    by_half: dict[str, FloatArray] = {}
    for way, calibrated in ways.items():
        failed = 0
        for number, half in enumerate(halves):
            try:
                rig = calibrated(half)
            except (ConfigurationError, cv2.error) as refused:
                print(f"{folder.name}, {way}: {str(refused).strip()[:200]}")
                failed += 1
                continue
            for name, each in corners.items():
                for bent in (False, True):
                    column = way + _SUFFIXES[name + "_bent" * bent]
                    errors = by_half.setdefault(column, np.full(len(halves), np.nan))
                    left = judged(points, rig, each.of(~half & judges), bent=bent)
                    errors[number] = np.sqrt(np.mean(left**2))
        row[f"{way}_failed"] = failed
    row |= {column: _mean(errors) for column, errors in by_half.items()}
    other = "opencv" if "opencv" in ways else "opencv_ours"
    for suffix in ("", "_bent"):
        of_way = [by_half.get(f"{way}{suffix}", np.full(1, np.nan)) for way in ("ours", other)]
        logs = np.log(of_way[0] / of_way[1])
        logs = logs[np.isfinite(logs)]
        row[f"ratio{suffix}"] = float(np.exp(_mean(logs)))
        row[f"ratio_error{suffix}"] = float(np.std(logs) / np.sqrt(max(len(logs), 1)))
    return row


def _mean(values: FloatArray) -> float:
    """Mean of the finite values; nan if there are none."""
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if len(known) else np.nan


def main(arguments: list[str] | None = None) -> None:
    """Compare, and print a row for each set of photographs."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument(
        "--set", nargs=3, action="append", required=True, metavar=("FOLDER", "TARGET", "LENS")
    )
    parser.add_argument("--half-window", type=int, default=HALF_WINDOW, help="of cornerSubPix, px")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table")
    options = parser.parse_args(arguments)
    table = pd.DataFrame(
        [
            compared(Path(folder), target, lens, options.half_window)
            for folder, target, lens in options.set
        ]
    )
    print(table.T.to_string(float_format="{:.4f}".format))
    if options.csv:
        table.to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
