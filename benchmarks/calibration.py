"""Calibrate simulated camera pairs and compare the errors with the stated standard deviations.

    python -m benchmarks.calibration [--drawn N] [--corners N] [--lens LENS] [--csv FILE]

For each lens model it calibrates N data sets, each with two new cameras of strong distortion and
new photographs of a checkerboard. With `--drawn`, photographs are rendered through the lens with
blur, noise and 8 bits, and the package's detector finds the corners. With `--corners`, the true
corners with Gaussian noise are used instead, which separates errors of the solver from errors of
the detector. A drawn data set of 18 photographs per camera takes some two seconds.

The columns of the table:

nees                 e^T C^-1 e / n over all parameters of the cameras, R and T, mean; expected: 1
nees_error           standard error of nees
nees_bend            nees that includes the board's curvatures, whose true value is 0
likelihood_ratio     (sum of squares at the truth - least sum of squares) / (s^2 n): as nees,
                     but also valid if different coefficients give nearly the same lens
direction_ratio      rms of error / sigma of viewing directions over the left image
baseline_ratio       rms error of the baseline / rms sigma of the baseline
baseline_error_mm    error of the baseline, rms
baseline_sigma_mm    sigma of the baseline, rms
noise                residuals / sigma of the detector
rms_px               residuals of both cameras
corner_ratio         error / sigma of the corners: median of absolute values, relative to a normal
                     distribution
corner_rms_ratio     error / sigma of the corners, rms
corner_error_px      error of the corners, each coordinate, rms
corner_bias_px       corner_error_px without image noise: the part that does not average out
dropped              views of a data set that were left out, mean
failed               data sets that gave no calibration
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.progress import track
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import (
    BoardPoses,
    CameraRig,
    cross_matrices,
    project_with_jacobians,
    rms_length,
)
from vergence.calibration.cameras import (
    CameraFit,
    fit_camera,
    fit_camera_pair,
    fit_consistent_views,
)
from vergence.calibration.observations import BoardObservations
from vergence.calibration.uncertainty import direction_sigma_px, rig_covariance
from vergence.errors import ConfigurationError
from vergence.models.camera import Camera, Lens, camera_matrix
from vergence.models.parts import FloatArray, Rendering
from vergence.vision import TargetRenderer, make_detector, parse_target
from vergence.vision.targets import PlanarTarget

SIZE: Final = (640, 480)
"""Width and height of the images, px (chosen: a common camera)."""
TARGET: Final = "checkerboard:9x6:24"
PAIRS: Final = 18
"""Views of a data set (chosen: a usual number for a calibration)."""
LENSES: Final[dict[str, tuple[float, tuple[float, ...]]]] = {
    # the image corner is at 44 degrees, moved inwards by 13 %
    "brown-conrady": (420.0, (-0.30, 0.12, 0.0005, -0.0008, -0.02)),
    # at 48 degrees, moved inwards by 21 %
    "rational": (420.0, (0.9, 0.35, 0.0005, -0.0008, 0.02, 1.2, 0.6, 0.08)),
    # at 72 degrees
    "fisheye": (310.0, (0.05, -0.02, 0.01, -0.004)),
}
"""Focal length, px, and distortion coefficients, all of which affect the images."""
DISTANCES_M: Final = (0.28, 0.6)
"""Least and greatest distance of the board, m (chosen: it fills a large part of the image)."""
MOST_TILT_RAD: Final = np.radians(40.0)
"""Largest tilt of the board, rad (chosen: a usual limit of photographs for calibration)."""
RIM_PX: Final = 12.0
"""Least distance of a corner from the image border, px (chosen: a board is found only if whole)."""
BLURS_PX: Final = (0.5, 1.0)
"""Range of the blur's standard deviation, px (chosen: sharp cameras)."""
NOISES_GREY: Final = (2.0, 4.0)
"""Range of the noise's standard deviation, grey levels (chosen: a usual camera)."""
CORNER_NOISE_PX: Final = 0.1
"""Noise of the corners with `--corners`, px (chosen: about that of a detector)."""
_NORMAL_MEDIAN: Final = 0.6745
"""Median of the absolute value of a standard normal variable (numerical)."""


class Truth(NamedTuple):
    """True cameras, and true pose of the board in each view."""

    rig: CameraRig
    poses: BoardPoses

    def pixels(self, target: PlanarTarget) -> FloatArray:
        """(c, v, n, 2) pixels of the board in the cameras; nan for boards that leave an image."""
        board = np.insert(target.corners_m, 2, 0.0, axis=1)
        left = board @ self.poses.rotation.transpose(0, 2, 1) + self.poses.translation[:, None]
        points = [left, left @ self.rig.rotation.T + self.rig.translation]
        pixels = np.stack(
            [
                project_with_jacobians(lens, values, each).pixels
                for lens, values, each in zip(
                    self.rig.lenses, self.rig.camera_parameters, points, strict=True
                )
            ]
        )
        inside: NDArray[np.bool_] = np.asarray(
            (pixels > RIM_PX) & (pixels < np.array(SIZE) - 1.0 - RIM_PX)
        )
        return np.where(np.asarray(inside.all(axis=(-1, -2)))[..., None, None], pixels, np.nan)


def drawn_rig(lens: str, rng: np.random.Generator) -> CameraRig:
    """Two random cameras of a lens model, about 100 mm apart, a few degrees from parallel."""
    focal, coefficients = LENSES[lens]
    values = tuple(
        np.array(
            [
                *(focal * rng.uniform(0.97, 1.03) + rng.uniform(-2.0, 2.0, 2)),
                *(0.5 * np.array(SIZE) + rng.uniform(-10.0, 10.0, 2)),
                *coefficients,
            ]
        )
        for _ in range(2)
    )
    turn = Rotation.from_rotvec(np.radians(rng.uniform(-3.0, 3.0, 3))).as_matrix()
    return CameraRig((lens, lens), values, turn, np.array([-0.1, 0.002, 0.003]), np.zeros(3))


def drawn_pose(
    rig: CameraRig, camera: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Random pose of a board in the left camera's frame, centred anywhere in a camera's image."""
    eye = eye_camera(rig, camera)
    ray = np.append(eye.rays(rng.uniform((0.0, 0.0), SIZE)[None])[0], 1.0)
    ray /= np.linalg.norm(ray)
    middle = ray * rng.uniform(*DISTANCES_M)
    axis = rng.uniform(0.0, 2.0 * np.pi)
    tilt = MOST_TILT_RAD * np.sqrt(rng.uniform()) * np.array([np.cos(axis), np.sin(axis), 0.0])
    facing = np.cross([0.0, 0.0, 1.0], ray)
    facing *= np.arccos(ray[2]) / max(float(np.linalg.norm(facing)), 1e-12)
    roll = np.array([0.0, 0.0, rng.uniform(-0.5, 0.5)])
    turned = [Rotation.from_rotvec(each) for each in (facing, tilt, roll)]
    rotation = (turned[0] * turned[1] * turned[2]).as_matrix()
    if camera == 1:
        rotation, middle = rig.rotation.T @ rotation, rig.rotation.T @ (middle - rig.translation)
    return rotation, middle


def drawn_truth(lens: str, target: PlanarTarget, rng: np.random.Generator) -> Truth:
    """Random pair, and boards that are entirely in one of its images, most of them in both."""
    rig = drawn_rig(lens, rng)
    centre = np.append(target.corners_m.mean(axis=0), 0.0)
    rotations: list[FloatArray] = []
    translations: list[FloatArray] = []
    while len(rotations) < PAIRS:
        camera = len(rotations) % 2
        rotation, middle = drawn_pose(rig, camera, rng)
        shift = middle - rotation @ centre
        with np.errstate(invalid="ignore"):
            seen = Truth(rig, BoardPoses(rotation[None], shift[None])).pixels(target)
        whole: NDArray[np.bool_] = np.asarray(np.isfinite(seen).all(axis=(1, 2, 3)))
        # a third of the views may be of one camera alone
        if whole.all() or (whole[camera] and len(rotations) % 6 < 2):
            rotations.append(rotation)
            translations.append(shift)
    return Truth(rig, BoardPoses(np.array(rotations), np.array(translations)))


def eye_camera(rig: CameraRig, camera: int) -> Camera:
    """One of the cameras, for drawing."""
    f_u, f_v, u_0, v_0, *coefficients = rig.camera_parameters[camera].tolist()
    return Camera(
        size=(SIZE[0], SIZE[1]), matrix=camera_matrix((f_u, f_v), (u_0, v_0)),
        lens=Lens(rig.lenses[camera], tuple(coefficients)),
    )  # fmt: skip


def observed(target: PlanarTarget, pixels: FloatArray, sigma: FloatArray) -> BoardObservations:
    """Observations made of given corners."""
    cameras, views = pixels.shape[:2]
    names = tuple(tuple(f"{camera}-{view}.png" for view in range(views)) for camera in "lr")
    return BoardObservations(
        target=target,
        file_names=names[:cameras],
        image_sizes=(SIZE,) * cameras,
        pixels=pixels,
        sigma=sigma,
    )


def photographed(
    target: PlanarTarget, truth: Truth, rng: np.random.Generator, *, noisy: bool = True
) -> BoardObservations:
    """Draw a pair's photographs and detect the corners in them."""
    true = truth.pixels(target)
    rendering = Rendering(
        blur_px=rng.uniform(*BLURS_PX), noise_grey=rng.uniform(*NOISES_GREY), black_grey=30.0,
        background_grey=130.0, white_grey=210.0, supersampling=2,
    )  # fmt: skip
    detector = make_detector(target)
    pixels, sigma = np.full_like(true, np.nan), np.full_like(true, np.nan)
    for camera in range(2):
        drawing = TargetRenderer(eye_camera(truth.rig, camera), target, rendering)
        for view in np.flatnonzero(np.isfinite(true[camera]).all(axis=(1, 2))):
            pose = np.eye(4)
            pose[:3, :3] = truth.poses.rotation[view]
            pose[:3, 3] = truth.poses.translation[view]
            if camera == 1:
                between = np.eye(4)
                between[:3, :3], between[:3, 3] = truth.rig.rotation, truth.rig.translation
                pose = between @ pose
            drawing.draw(pose, rng if noisy else None)
            found = detector.detect(drawing.frame)
            if found is not None:
                pixels[camera, view] = found.corners_px
                sigma[camera, view] = found.corners_sigma_px
    return observed(target, pixels, sigma)


def noisy_corners(
    target: PlanarTarget, truth: Truth, rng: np.random.Generator
) -> BoardObservations:
    """True corners with Gaussian noise of known sigma."""
    true = truth.pixels(target)
    pixels = true + CORNER_NOISE_PX * rng.standard_normal(true.shape)
    return observed(target, pixels, np.where(np.isfinite(true), CORNER_NOISE_PX, np.nan))


def calibrated(seen: BoardObservations, lens: str) -> CameraFit:
    """Calibrate the pair as `vergence.calibration.calibrate` does with a given lens model."""
    alone = [
        fit_camera(seen.select_camera(i), lens, fit_consistent_views(seen.select_camera(i)))
        for i in range(2)
    ]
    return fit_camera_pair(seen, *alone)[1]


def nees(error: FloatArray, covariance: FloatArray) -> float:
    """Normalised squared error per parameter, e^T C^-1 e / n; its expectation is 1."""
    # coefficients of a lens and pixels differ by many orders of magnitude
    scale = np.sqrt(np.diagonal(covariance))
    correlation = covariance / scale[:, None] / scale
    return float((error / scale) @ np.linalg.solve(correlation, error / scale)) / len(error)


def likelihood_ratio(fit: CameraFit, truth: Truth) -> float:
    """Excess of the sum of squares at the truth over the least one, relative to its expectation."""
    solution = fit.solution
    there = solution.problem.fit_poses(truth.rig, truth.poses.select(fit.kept_views))
    more = float((there.residuals**2).sum() - (solution.residuals**2).sum())
    return more / solution.reduced_chi**2 / len(truth.rig.packed())


def direction_ratio(fit: CameraFit, truth: CameraRig, covariance: FloatArray) -> float:
    """Root mean square of error / sigma of the left camera's viewing directions."""
    found, lens = fit.solution.rig, truth.lenses[0]
    u, v = np.meshgrid(*(np.linspace(0.1, 0.9, 9) * length for length in SIZE))
    rays = eye_camera(truth, 0).rays(np.column_stack([u.ravel(), v.ravel()]))
    points = np.insert(rays, 2, 1.0, axis=1)
    seen = project_with_jacobians(lens, found.camera_parameters[0], points)
    error = seen.pixels - project_with_jacobians(lens, truth.camera_parameters[0], points).pixels
    # a rotation of the frame is fitted to the observed corners, as in `direction_sigma_px`
    corners = fit.solution.problem.points(found, fit.solution.poses)
    corners = corners[fit.solution.problem.seen[0]]
    at = project_with_jacobians(lens, found.camera_parameters[0], corners)
    by_turn = -at.point_jacobian @ cross_matrices(corners)
    missed = at.pixels - project_with_jacobians(lens, truth.camera_parameters[0], corners).pixels
    turn = np.linalg.lstsq(by_turn.reshape(-1, 3), -missed.ravel(), rcond=None)[0]
    error = error - seen.point_jacobian @ cross_matrices(points) @ turn
    sigma = direction_sigma_px(fit.solution, covariance, 0, rays)
    return float(np.sqrt(np.mean((error / sigma[:, None]) ** 2)))


def measured(fit: CameraFit, truth: Truth) -> dict[str, float]:
    """Errors and ratios of one calibrated data set."""
    rig, covariance = fit.solution.rig, rig_covariance(fit.solution)
    error = rig.packed() - truth.rig.packed()
    bend, between = rig.blocks[-1], rig.blocks[-2]
    shift = rig.translation
    length = float(np.linalg.norm(shift))
    variance = shift @ covariance[between, between][3:, 3:] @ shift / length**2
    known = slice(0, bend.start)
    return {
        "nees": nees(error[known], covariance[known, known]),
        "nees_bend": nees(error, covariance),
        "likelihood_ratio": likelihood_ratio(fit, truth),
        "direction_ratio": direction_ratio(fit, truth.rig, covariance),
        "baseline_error_mm": 1e3 * (length - float(np.linalg.norm(truth.rig.translation))),
        "baseline_sigma_mm": 1e3 * float(np.sqrt(variance)),
        "noise": fit.solution.reduced_chi,
        "rms_px": rms_length(fit.solution.residuals_px),
        "dropped": float((~fit.kept_views).sum()),
    }


def corner_errors(seen: BoardObservations, true: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k) errors of all detected coordinates, px, and their sigmas."""
    there = np.isfinite(seen.pixels) & np.isfinite(true)
    return (seen.pixels - true)[there], seen.sigma[there]


def row_of(lens: str, count: int, rng: np.random.Generator, look: str) -> dict[str, Any]:
    """Row of the table: calibrate data sets of one lens model."""
    target = parse_target(TARGET)
    assert isinstance(target, PlanarTarget)
    results, errors, sigmas, failed = [], [], [], 0
    see: Callable[..., BoardObservations] = noisy_corners if look == "corners" else photographed
    bias = np.array([0.0])
    started = time.perf_counter()
    for number in track(range(count), f"{lens}, {look}"):
        truth = drawn_truth(lens, target, rng)
        seen = see(target, truth, rng)
        error, sigma = corner_errors(seen, truth.pixels(target))
        errors.append(error)
        sigmas.append(sigma)
        if number == 0 and look == "drawn":
            quiet = photographed(target, truth, rng, noisy=False)
            bias = corner_errors(quiet, truth.pixels(target))[0]
        try:
            results.append(measured(calibrated(seen, lens), truth))
        except ConfigurationError as refused:
            print(f"{lens}, data set {number}: {refused}", file=sys.stderr)
            failed += 1
    table = pd.DataFrame(results)
    squares = np.concatenate(errors) / np.concatenate(sigmas)
    baseline = {
        name: float(np.sqrt((table[f"baseline_{name}_mm"] ** 2).mean()))
        for name in ("error", "sigma")
    }
    return {
        "lens": lens,
        "look": look,
        "data_sets": count,
        "nees": table["nees"].mean(),
        "nees_error": table["nees"].sem(),
        "nees_bend": table["nees_bend"].mean(),
        "likelihood_ratio": table["likelihood_ratio"].mean(),
        "direction_ratio": float(np.sqrt((table["direction_ratio"] ** 2).mean())),
        "baseline_ratio": baseline["error"] / baseline["sigma"],
        "baseline_error_mm": baseline["error"],
        "baseline_sigma_mm": baseline["sigma"],
        "noise": table["noise"].mean(),
        "rms_px": table["rms_px"].mean(),
        "corner_ratio": float(np.median(np.abs(squares))) / _NORMAL_MEDIAN,
        "corner_rms_ratio": _root_mean_square(squares),
        "corner_error_px": _root_mean_square(np.concatenate(errors)),
        "corner_bias_px": _root_mean_square(bias),
        "dropped": table["dropped"].mean(),
        "failed": failed,
        "seconds": (time.perf_counter() - started) / count,
    }


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def table_of(lenses: Iterable[str], looks: Sequence[str], count: int, seed: int) -> pd.DataFrame:
    """Table with a row for each lens model and source of corners."""
    rows = [
        row_of(lens, count, np.random.default_rng([seed, number]), look)
        for look in looks
        for number, lens in enumerate(lenses)
    ]
    return pd.DataFrame(rows)


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print a row for each lens model."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--drawn", type=int, default=0, metavar="N", help="data sets a lens")
    parser.add_argument("--corners", type=int, default=0, metavar="N", help="without drawing")
    parser.add_argument("--lens", choices=list(LENSES), action="append", help="of that lens only")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table")
    options = parser.parse_args(arguments)
    parts = [
        table_of(options.lens or list(LENSES), [look], count, options.seed)
        for look, count in (("corners", options.corners), ("drawn", options.drawn))
        if count
    ]
    if not parts:
        parser.error("expected --drawn N or --corners N")
    table = pd.concat(parts, ignore_index=True)
    print(table.T.to_string(float_format="{:.4g}".format))
    if options.csv:
        table.to_csv(options.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()
