"""Results of a camera calibration: depth's standard deviation, head files, documents."""

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import (
    CameraRig,
    camera_parameter_names,
    project_with_jacobians,
    rms_length,
)
from vergence.calibration.calibrate import Calibration
from vergence.calibration.uncertainty import triangulation_covariances
from vergence.models.camera import Camera, CameraResponse, Lens, camera_matrix
from vergence.models.parts import EYE_NAMES, CalibrationRecord, FloatArray
from vergence.models.stereo_files import ReadCameras, document_of_pair
from vergence.models.toml_table import toml_text
from vergence.reporting.runs import package_versions

BASELINES: Final = (3.0, 100.0)
"""Nearest and farthest distance of the figure, in baselines (chosen: the range of use)."""
NEAR_M: Final = 0.2
"""Distance from which on the figure reaches in any case, m (chosen: the range of use)."""
FAR_M: Final = 5.0
"""Distance up to which the figure reaches in any case, m (chosen: the range of use)."""


@dataclass(frozen=True, eq=False)
class DepthSigma:
    """Standard deviations of depth along the pair's middle axis; nan outside either image."""

    distance_m: FloatArray
    """(n) distance from the middle of the baseline."""
    calibration_m: FloatArray
    """(n) contribution of calibration errors, which are the same in every pair of images."""
    noise_m: FloatArray
    """(n) contribution of the noise of one pair of images."""

    @property
    def total_m(self) -> FloatArray:
        """(n) root sum square of both contributions."""
        return np.asarray(np.hypot(self.calibration_m, self.noise_m))


def pixel_noise_px(calibration: Calibration) -> float:
    """Estimate a detected corner's standard deviation per coordinate from each camera alone."""
    return float(np.sqrt(0.5 * np.mean(np.square(calibration.rms_alone_px))))


def depths_to_plot_m(calibration: Calibration) -> FloatArray:
    """(n) distances for a figure, m, evenly spaced on a logarithmic scale."""
    baseline = float(np.linalg.norm(calibration.rig.translation))
    near, far = min(NEAR_M, BASELINES[0] * baseline), max(FAR_M, BASELINES[1] * baseline)
    return np.geomspace(near, far, 80)


def depth_sigma_at(calibration: Calibration, distance_m: FloatArray) -> DepthSigma:
    """Uncertainty of depth along the bisector of the axes, (n) m from the baseline's middle."""
    rig = calibration.rig
    axis = np.array([0.0, 0.0, 1.0]) + rig.rotation[2]
    axis /= np.linalg.norm(axis)
    middle = -0.5 * rig.rotation.T @ rig.translation
    points = middle + distance_m[:, None] * axis
    covariances = triangulation_covariances(
        calibration.fit.solution, calibration.covariance, points, pixel_noise_px(calibration)
    )
    inside = _in_both(calibration, points)
    calibration_sigma, noise_sigma = (
        np.where(inside, np.sqrt(np.einsum("i,nij,j->n", axis, each, axis)), np.nan)
        for each in covariances
    )
    return DepthSigma(distance_m, calibration_sigma, noise_sigma)


def _in_both(calibration: Calibration, points: FloatArray) -> FloatArray:
    """(n) True for points (n, 3) in the left camera's frame that are inside both images."""
    rig = calibration.rig
    inside = np.ones(len(points), bool)
    for camera, size in enumerate(calibration.observations.image_sizes):
        lens, values = rig.lenses[camera], rig.camera_parameters[camera]
        pixels = project_with_jacobians(lens, values, rig.in_camera(camera, points)).pixels
        inside &= ((pixels > -0.5) & (pixels < np.array(size) - 0.5)).all(axis=-1)
    return inside


_RECORDED_PACKAGES: Final = ("vergence", "opencv-python-headless", "numpy", "scipy")
_ROS_LENSES: Final[dict[str, str]] = {
    "brown-conrady": "plumb_bob",
    "rational": "rational_polynomial",
    "fisheye": "equidistant",
}


def camera_of(calibration: Calibration, camera: int, pose: FloatArray | None = None) -> Camera:
    """Extract one camera."""
    values, lens = calibration.rig.camera_parameters[camera], calibration.rig.lenses[camera]
    return Camera(
        size=calibration.observations.image_sizes[camera],
        matrix=camera_matrix(values[:2], values[2:4]),
        lens=Lens(lens, values[4:]),
        pose=np.eye(4) if pose is None else pose,
    )


def pair_of(calibration: Calibration) -> ReadCameras:
    """Extract the cameras of a pair's calibration."""
    right = np.eye(4)
    right[:3, :3] = calibration.rig.rotation.T
    right[:3, 3] = -calibration.rig.rotation.T @ calibration.rig.translation
    return ReadCameras(left=camera_of(calibration, 0), right=camera_of(calibration, 1, right))


def head_file_text(
    calibration: Calibration, name: str, response: CameraResponse | None = None
) -> str:
    """Write the head file of a calibrated pair as TOML text."""
    document = document_of_pair(
        pair_of(calibration),
        name,
        noise_px=pixel_noise_px(calibration),
        calibration=calibration_record(calibration),
        response=response,
    )
    return toml_text(document)


def calibration_record(calibration: Calibration) -> CalibrationRecord:
    """Record the origin and uncertainty of a calibrated pair."""
    sigma = {
        f"{eye}.camera.{value}": deviation
        for eye, lens, block in zip(
            EYE_NAMES, calibration.rig.lenses, calibration.rig.blocks[:-2], strict=True
        )
        for value, deviation in zip(
            camera_parameter_names(lens), calibration.sigma[block].tolist(), strict=True
        )
    }
    between = calibration.rig.blocks[-2]
    placed = right_camera_pose_covariance(calibration.rig, calibration.covariance[between, between])
    names = ("rx", "ry", "rz", "x", "y", "z")
    deviations = np.sqrt(np.diagonal(placed)).tolist()
    sigma |= {f"right.head_eye.{n}": d for n, d in zip(names, deviations, strict=True)}
    return CalibrationRecord(
        target=str(calibration.observations.target),
        views=int(calibration.fit.kept_views.sum()),
        rms_px=rms_length(calibration.fit.solution.residuals_px),
        rms_heldout_px=rms_length(calibration.held_out_px),
        corners_sha256=calibration.observations.digest,
        versions=", ".join(
            f"{name} {each}" for name, each in package_versions(_RECORDED_PACKAGES).items()
        ),
        sigma=sigma,
    )


def right_camera_pose_covariance(rig: CameraRig, covariance: FloatArray) -> FloatArray:
    """(6, 6) of r, p in (R^T exp([r]), p = -R^T T), rad, m, from `x_right = R x_left + T`."""
    vector = Rotation.from_matrix(rig.rotation).as_rotvec()
    by_vector = np.asarray(cv2.Rodrigues(vector)[1]).reshape(3, 3, 3)
    # R(v + d) = exp([J d]) R(v)
    spins = by_vector @ rig.rotation.T
    turning = np.stack([spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]])
    x, y, z = rig.translation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = -turning
    jacobian[3:, :3] = -rig.rotation.T @ cross @ turning
    jacobian[3:, 3:] = -rig.rotation.T
    return np.asarray(jacobian @ covariance @ jacobian.T)


def ros_camera_document(calibration: Calibration) -> dict[str, Any]:
    """Convert a camera's calibration to plain values with the keys of ROS's camera_info files."""
    camera = camera_of(calibration, 0)
    lens, coefficients = camera.lens
    (f_u, f_v), (u_0, v_0) = camera.focal.tolist(), camera.principal.tolist()
    names = camera_parameter_names(lens)
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": {
            "rows": 3,
            "cols": 3,
            "data": [f_u, 0.0, u_0, 0.0, f_v, v_0, 0.0, 0.0, 1.0],
        },
        "distortion_model": _ROS_LENSES[lens],
        "distortion_coefficients": {
            "rows": 1,
            "cols": len(coefficients),
            "data": np.asarray(coefficients).tolist(),
        },
        "calibration": {
            "target": str(calibration.observations.target),
            "views": int(calibration.fit.kept_views.sum()),
            "rms_px": calibration.rms_alone_px[0],
            "rms_heldout_px": rms_length(calibration.held_out_px),
            "corners_sha256": calibration.observations.digest,
            "versions": package_versions(_RECORDED_PACKAGES),
            "sigma": dict(
                zip(names, calibration.sigma[calibration.rig.blocks[0]].tolist(), strict=True)
            ),
        },
    }
