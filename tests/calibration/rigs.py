"""Pairs of cameras with known numbers, and the corners that they see of a board."""

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import BoardPoses, BundleAdjustment, BundleSolution, CameraRig
from vergence.calibration.calibrate import Calibration
from vergence.calibration.cameras import CameraFit
from vergence.calibration.observations import BoardObservations
from vergence.calibration.uncertainty import rig_covariance
from vergence.vision import parse_target

SIZE = (640, 480)
BOARD = parse_target("checkerboard:9x6:24")
COEFFICIENTS = {
    "brown-conrady": (-0.25, 0.08, 0.0005, -0.0008, 0.01),
    "rational": (0.9, 0.35, 0.0005, -0.0008, 0.02, 1.2, 0.6, 0.08),
    "fisheye": (0.05, -0.02, 0.01, -0.004),
}


def make_rig(lens="brown-conrady", focal=520.0):
    """Two cameras 100 mm apart that look the same way but for a degree or two."""
    left = np.array([focal, focal + 2.0, 322.0, 237.0, *COEFFICIENTS[lens]])
    right = np.array([focal + 5.0, focal + 6.0, 315.0, 244.0, *COEFFICIENTS[lens]])
    turn = Rotation.from_euler("xyz", [0.5, -2.0, 0.3], degrees=True).as_matrix()
    return CameraRig((lens, lens), (left, right), turn, np.array([-0.1, 0.002, 0.003]), np.zeros(3))


def make_poses(rng, views, board=BOARD, wide=1.0):
    """Boards all over both images, tilted every way by up to 40 degrees; farther aside if wide."""
    corners = board.corners_m
    middle = np.append(corners.mean(axis=0), 0.0)
    tilts = np.radians(rng.uniform(-40.0, 40.0, (views, 3)) * (1.0, 1.0, 0.5))
    rotation = Rotation.from_rotvec(tilts).as_matrix()
    z = rng.uniform(0.35, 0.7, views)
    x, y = wide * rng.uniform(-0.35, 0.35, views) * z + 0.05, rng.uniform(-0.25, 0.25, views) * z
    return BoardPoses(rotation, np.column_stack([x, y, z]) - rotation @ middle)


def look(rig, poses, rng, noise_px=0.1, size=SIZE, board=BOARD):
    """Observations of the board with noise; corners outside of an image are not found."""
    corners = np.column_stack([board.corners_m, np.zeros(len(board.corners_m))])
    shape = (len(rig.camera_parameters), len(poses.translation), len(corners), 2)
    true = BundleAdjustment(corners, np.zeros(shape), np.ones(shape)).residuals(rig, poses)
    pixels = true + noise_px * rng.standard_normal(shape)
    outside = ~((pixels > 0.0) & (pixels < np.array(size) - 1.0)).all(axis=-1)
    whole = ~outside.any(axis=-1)[..., None, None]  # a checkerboard is found whole or not at all
    names = tuple(tuple(f"{eye}{view}.png" for view in range(shape[1])) for eye in "lr"[: shape[0]])
    return BoardObservations(
        target=board, file_names=names, image_sizes=(size,) * shape[0],
        pixels=np.where(whole, pixels, np.nan),
        sigma=np.where(whole, np.full(shape, noise_px), np.nan),
    )  # fmt: skip


def as_calibrated(rig, poses, seen, dropped=()):
    """A calibration that has found just what is true, of views that were seen so."""
    cameras, views = seen.pixels.shape[:2]
    out = np.isin(np.arange(views), dropped)
    alone = []
    for camera in range(cameras):
        mine = poses.transformed(rig.rotation, rig.translation) if camera else poses
        problem = seen.problem.select_camera(camera)
        alone.append(_fit(problem, rig.alone(camera), mine, seen.usable[camera] & ~out))
    fit = alone[0]
    if cameras > 1:
        fit = _fit(seen.problem, rig, poses, seen.usable.any(axis=0) & ~out)
    return Calibration(
        observations=seen, single_fits=tuple(alone), fit=fit,
        covariance=rig_covariance(fit.solution), held_out_px=fit.solution.residuals_px,
        lens=rig.lenses[0], lens_errors={}, read_errors=(),
    )  # fmt: skip


def _fit(problem, rig, poses, kept):
    one = problem.select(kept)
    return CameraFit(
        BundleSolution(one, rig, poses.select(kept)), kept,
        BundleSolution(problem, rig, poses),
    )  # fmt: skip


def differences(value, count, step=1e-6):
    """Derivative of a function of (count,) steps by central differences, along the last axis."""
    return np.stack(
        [(value(one) - value(-one)) / (2.0 * step) for one in step * np.eye(count)], axis=-1
    )
