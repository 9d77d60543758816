"""Calibration files of a pair with known numbers, as different programs write them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

SIZE = (640, 480)
K_LEFT = np.array([[461.6, 0.0, 322.5], [0.0, 460.1, 246.0], [0.0, 0.0, 1.0]])
K_RIGHT = np.array([[458.2, 0.0, 315.25], [0.0, 457.9, 239.5], [0.0, 0.0, 1.0]])
D_LEFT = np.array([-0.28, 0.07, 2e-4, 1.8e-5, 0.01])
D_RIGHT = np.array([-0.27, 0.06, -3e-4, 5e-5, 0.02])
R = cv2.Rodrigues(np.array([0.01, -0.03, 0.005]))[0]
T = np.array([-0.09388, 0.0011, -0.0023])
RIGHT_FROM_LEFT = np.vstack([np.column_stack([R, T]), [0.0, 0.0, 0.0, 1.0]])
RECTIFIED = cv2.stereoRectify(
    K_LEFT, D_LEFT, K_RIGHT, D_RIGHT, SIZE, R, T.reshape(3, 1), flags=cv2.CALIB_ZERO_DISPARITY
)


def write_opencv(path: Path, values: dict[str, Any]) -> Path:
    """Write values as `cv2.FileStorage` does, in the format of the suffix."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        storage.write(key, value)
    storage.release()
    return path


def opencv_pair(**changes: Any) -> dict[str, Any]:
    """Values written by a program around `cv2.stereoCalibrate`; values of None are left out."""
    values: dict[str, Any] = {
        "cameraMatrix1": K_LEFT, "distCoeffs1": D_LEFT.reshape(1, -1), "cameraMatrix2": K_RIGHT,
        "distCoeffs2": D_RIGHT.reshape(1, -1), "R": R, "T": T.reshape(3, 1), "image_width": SIZE[0],
        "image_height": SIZE[1],
    } | changes  # fmt: skip
    return {key: value for key, value in values.items() if value is not None}


def _table(matrix: np.ndarray) -> dict[str, Any]:
    rows, cols = np.atleast_2d(matrix).shape
    return {"rows": rows, "cols": cols, "data": matrix.round(8).ravel().tolist()}


def _write_yaml(path: Path, values: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(values, sort_keys=False, default_flow_style=None), "utf-8")
    return path


def camera_info(path: Path, eye: int) -> Path:
    """Write the file of one camera as ROS's camera_calibration does."""
    k, d = ((K_LEFT, D_LEFT), (K_RIGHT, D_RIGHT))[eye]
    return _write_yaml(path, {
        "image_width": SIZE[0], "image_height": SIZE[1], "camera_name": f"pair/{path.stem}",
        "camera_matrix": _table(k), "distortion_model": "plumb_bob",
        "distortion_coefficients": _table(d), "rectification_matrix": _table(RECTIFIED[eye]),
        "projection_matrix": _table(RECTIFIED[2 + eye]),
    })  # fmt: skip


def camchain(path: Path, model: str = "radtan") -> Path:
    return _write_yaml(path, {
        f"cam{eye}": ({"T_cn_cnm1": RIGHT_FROM_LEFT.tolist()} if eye else {}) | {
            "cam_overlaps": [1 - eye], "camera_model": "pinhole",
            "distortion_coeffs": d[:4].tolist(), "distortion_model": model,
            "intrinsics": [float(k[0, 0]), float(k[1, 1]), *k[:2, 2].tolist()],
            "resolution": list(SIZE), "rostopic": f"/cam{eye}/image_raw",
        }
        for eye, (k, d) in enumerate(((K_LEFT, D_LEFT), (K_RIGHT, D_RIGHT)))
    })  # fmt: skip
