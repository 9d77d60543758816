"""The centre of a board, from the corners that were found."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.models.parts import FloatArray
from vergence.vision import Camera, Detection
from vergence.vision.targets import AprilTag


def centre_weights(corners_m: FloatArray, found_mask: NDArray[np.bool_]) -> FloatArray:
    """(n,) weights whose mean is the centre by the affine fit; nan for corners on a line."""
    weights = np.zeros(len(corners_m))
    from_middle = (corners_m - corners_m.mean(axis=0))[found_mask]
    design = np.column_stack([np.ones(len(from_middle)), from_middle / np.ptp(corners_m)])
    if len(from_middle) < 3 or np.linalg.matrix_rank(design, tol=1e-6) < 3:
        return np.full(len(corners_m), np.nan)
    weights[found_mask] = np.linalg.pinv(design)[0]
    return weights


def weighted_sum(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sum of rows; rows with weight 0 are ignored, even if they are nan."""
    used = weights != 0.0
    return np.asarray(np.tensordot(weights[used], values[used], axes=1))


def target_centre_px(detection: Detection, camera: Camera | None) -> tuple[FloatArray, FloatArray]:
    """(2,) pixel of a target's centre, for a board by a homography, and (2,) its sigma; or nan."""
    target = detection.target
    if isinstance(target, AprilTag):
        return detection.point_px, detection.sigma_px
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(detection.corners_px).all(axis=-1))
    weights = centre_weights(target.corners_m, seen)
    nowhere = np.full(2, np.nan)
    if seen.sum() < 4 or not np.isfinite(weights).all():
        return nowhere, nowhere
    corners = detection.corners_px[seen]
    plane = corners if camera is None else camera.rays(corners)
    fitted: Any = cv2.findHomography(target.corners_m[seen], plane)
    homography = fitted[0]
    if homography is None:
        return nowhere, nowhere
    ray = homography @ [*target.corners_m.mean(axis=0), 1.0]
    middle = ray[:2] / ray[2]
    if camera is not None:
        middle = camera.project([[*middle, 1.0]])[0]
    return middle, np.sqrt(weighted_sum(detection.corners_sigma_px**2, weights**2))
