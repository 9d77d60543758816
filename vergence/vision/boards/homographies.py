"""Homography from a board's plane to an image, and the uncertainty of the board's origin by it."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def fit_homography(
    board_m: NDArray[np.float64], pixels: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Least-squares homography from the board's plane to the image; None if corners are collinear.

    Args:
        board_m: (n, 2) corners on the board, m.
        pixels: (n, 2) these corners in the image, px.
    """
    transform: Any = cv2.findHomography(board_m, pixels, 0)[0]
    if transform is None or not np.isfinite(transform).all():
        return None
    return np.asarray(transform, float)


def origin_sigma_px(
    homography: NDArray[np.float64], board_m: NDArray[np.float64], sigmas: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Standard deviations of the board's origin in the image by a homography of corners, (2,) px.

    They are large if the corners do not surround the origin.

    Args:
        homography: the homography.
        board_m: (n, 2) corners on the board, m.
        sigmas: (n, 2) their standard deviations in the image, px.
    """
    scale = 1.0 / np.abs(board_m).max()
    H = homography @ np.diag([1.0 / scale, 1.0 / scale, 1.0])
    x, y = (scale * board_m).T
    both = np.stack([x, y, np.ones_like(x)])
    w = H[2] @ both
    u, v = H[0] @ both / w, H[1] @ both / w
    rows = np.zeros((len(x), 2, 8))
    rows[:, 0, 0:3] = rows[:, 1, 3:6] = (both / w).T
    rows[:, 0, 6:8], rows[:, 1, 6:8] = -(u * both[:2] / w).T, -(v * both[:2] / w).T
    normal = np.einsum("nij,nik,ni->jk", rows, rows, 1.0 / sigmas**2)
    middle = np.zeros((2, 8))
    middle[0, 2] = middle[1, 5] = 1.0
    middle[0, 6:8] = middle[1, 6:8] = 0.0
    middle /= H[2, 2]
    spread = middle @ np.linalg.pinv(normal, hermitian=True) @ middle.T
    return np.sqrt(np.diagonal(spread))
