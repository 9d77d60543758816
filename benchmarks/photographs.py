"""Measure a board in held-out photographs of a real pair of cameras.

Run ``python benchmarks/photographs.py FOLDER`` on a folder with left1.jpg, right1.jpg and so on of
a checkerboard. The pair is calibrated on the views of even numbers, by ``vergence calibrate`` or by
OpenCV and ``vergence import stereo``, and ``vergence locate`` measures the board in the views of
odd numbers. Calibration by OpenCV uses each of its two corner finders; the measurement always uses
the package's detector.
"""

import argparse
import contextlib
import io
import json
import shutil
import tempfile
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.cli import main
from vergence.perception.finding import TargetFinder
from vergence.perception.locate import neighbour_distances_m
from vergence.perception.photographs import photographs_in_folder
from vergence.vision import parse_target, read_image
from vergence.vision.targets import Checkerboard

Pixels = NDArray[np.float32]


class Measured(NamedTuple):
    """Results in the held-out views, in millimetres and pixels."""

    stereo_rms_px: float
    """Reprojection error of the calibration, rms."""
    pairs: int
    """Held-out views with the board found in both images."""
    views: int
    """Held-out views."""
    mean_mm: float
    """Distance between neighbouring corners, mean."""
    spread_mm: float
    """Standard deviation of that distance."""
    gap_mm: float
    """Root mean square of the gaps between the lines of sight."""


def opencv_corners(path: Path, board: Checkerboard, finder: str) -> Pixels:
    """Corners of a board found by OpenCV with a usual refinement, shape (n, 2)."""
    image = read_image(path)
    shape = (board.columns, board.rows)
    if finder == "sb":
        found, corners = cv2.findChessboardCornersSB(image, shape)
    else:
        found, corners = cv2.findChessboardCorners(image, shape)
    if not found:
        raise SystemExit(f"{path}: OpenCV finds no board")
    if finder == "classic":
        # the window must hold one corner only: a fixed one would merge corners of small boards
        grid = corners.reshape(board.rows, board.columns, 2)
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
        half = int(np.clip(min(steps) / 3.0, 2, 5))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        corners = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), stop)
    return np.ascontiguousarray(corners.reshape(-1, 2), np.float32)


def calibrate(views: list[tuple[Path, Path]], board: Checkerboard, finder: str, out: Path) -> float:
    """Calibrate a pair with OpenCV, write its file, return the reprojection error, px rms."""
    flat = np.zeros((len(board.corners_m), 3), np.float32)
    flat[:, :2] = board.corners_m
    corners = [[opencv_corners(view[eye], board, finder) for view in views] for eye in range(2)]
    boards = [flat] * len(views)
    height, width = read_image(views[0][0]).shape
    single = [cv2.calibrateCamera(boards, p, (width, height), None, None)[1:3] for p in corners]
    rms, *parts = cv2.stereoCalibrate(
        boards, *corners, *single[0], *single[1], (width, height),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS,
    )  # fmt: skip
    storage = cv2.FileStorage(str(out), cv2.FILE_STORAGE_WRITE)
    names = ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T")
    for name, value in zip(names, parts[:6], strict=True):
        storage.write(name, value)
    storage.write("image_width", width)
    storage.write("image_height", height)
    storage.release()
    return float(rms)


def command(*words: object) -> str:
    """Run a command of vergence and return its standard output."""
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            main([str(word) for word in words])
    except SystemExit as ended:
        if ended.code:
            raise SystemExit(f"vergence {words[0]} ended with {ended.code}") from ended
    return printed.getvalue()


def measure(folder: Path, target: str, finder: str = "classic") -> Measured:
    """Calibrate on the views of even numbers and measure the board in the others.

    Args:
        folder: folder with left1.jpg, right1.jpg and so on.
        target: the board, such as ``checkerboard:9x6:24.23``.
        finder: corner finder for the calibration by OpenCV, ``classic`` or ``sb``, or ``vergence``
            for the calibration by the package.
    """
    board = parse_target(target)
    assert isinstance(board, Checkerboard)
    numbers = sorted(int(path.stem.removeprefix("left")) for path in folder.glob("left*.jpg"))
    views = {n: (folder / f"left{n}.jpg", folder / f"right{n}.jpg") for n in numbers}
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        known = [view for number, view in views.items() if number % 2 == 0]
        head = work / "head.toml"
        if finder == "vergence":
            lefts, rights = zip(*known, strict=True)
            found = command(
                "calibrate", "stereo", "--left", *lefts, "--right", *rights, "--target", target,
                "--out", head, "--report", work / "report", "--json",
            )  # fmt: skip
            rms = float(json.loads(found)["rms_stereo_px"])
        else:
            rms = calibrate(known, board, finder, work / "pair.yml")
            command("import", "stereo", work / "pair.yml", "--out", head, "--no-figure")
        held_out = [view for number, view in views.items() if number % 2]
        for side in range(2):
            (work / str(side)).mkdir()
            for view in held_out:
                shutil.copy(view[side], work / str(side))
        rows = json.loads(
            command("locate", work / "0", work / "1", "--head", head,
                    "--target", target, "--json", "--out", work / "run")
        )  # fmt: skip
    points = [1e-3 * np.array(row["points_mm"], np.float64) for row in rows]
    apart = 1e3 * np.concatenate([neighbour_distances_m(board, each) for each in points])
    gaps = np.concatenate([row["gap_mm"] for row in rows]).astype(np.float64)
    return Measured(
        stereo_rms_px=rms,
        pairs=len(rows),
        views=len(held_out),
        mean_mm=float(apart.mean()),
        spread_mm=float(apart.std()),
        gap_mm=float(np.sqrt((gaps**2).mean())),
    )


def detected(folder: Path, target: str) -> tuple[int, int]:
    """Number of images of a folder in which the board is found, and of all images."""
    finder, images = TargetFinder([parse_target(target)]), photographs_in_folder(folder)
    return sum(len(finder.find_in_file(path).detections) == 1 for path in images), len(images)


def report() -> None:
    """Measure with each calibration and print the results."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--target", default="checkerboard:9x6:24.23")
    options = parser.parse_args()
    found, images = detected(options.folder, options.target)
    print(f"found in {found} of {images} images")
    for finder, whose in (
        ("classic", "OpenCV, from its classic corners,"),
        ("sb", "OpenCV, from its sb corners,"),
        ("vergence", "vergence calibrate"),
    ):
        got = measure(options.folder, options.target, finder)
        print(
            f"calibrated by {whose} to {got.stereo_rms_px:.3f} px: "
            f"{got.pairs} of {got.views} held-out pairs located, neighbouring corners "
            f"{got.mean_mm:.3f} mm in the mean, spread {got.spread_mm:.3f} mm, gap "
            f"{got.gap_mm:.3f} mm rms"
        )


if __name__ == "__main__":
    report()
