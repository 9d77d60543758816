"""Repeated noisy images of a board at fixed poses, and the detections in them."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.drawing import TargetRenderer
from vergence.vision.targets import board_pose, make_planar_target
from vergence.vision.tracking import Tracker, make_detector


def board_poses_in_eyes(head: HeadModel, q: ArrayLike, point: ArrayLike) -> FloatArray:
    """Poses in both cameras of a board that faces forward.

    Args:
        head: the head.
        q: (7,) joint angles, rad.
        point: (3,) the board's reference point, in N, m.

    Returns:
        (2, 4, 4) T_Cl_T and T_Cr_T, m.
    """
    return np.asarray(np.linalg.inv(head.camera_poses(q)) @ board_pose(point, "forward"))


def shifted_pose(head: HeadModel, eye: int, T_C_T: FloatArray, offset_px: ArrayLike) -> FloatArray:
    """Translate a pose parallel to the image plane, so that its point moves by `offset_px`."""
    pose = T_C_T.copy()
    pose[:2, 3] += pose[2, 3] * np.asarray(offset_px) / head.cameras.focal[eye]
    return pose


class FixedView:
    """One eye before one checkerboard: draws images and detects in them.

    Args:
        head: the head; it sets the camera, the images and their noise.
        eye: 0 for left, 1 for right.
        board: the target's name.
    """

    def __init__(self, head: HeadModel, eye: int, board: str = "checkerboard") -> None:
        self.head = head
        self.eye = eye
        camera, target = Camera.of(head, eye), make_planar_target(board)
        self._drawing = TargetRenderer(camera, target, head.rendering)
        self._detector = make_detector(target, camera)

    def true_pixel(self, T_C_T: FloatArray) -> FloatArray:
        """(2,) true raw pixel of the point of a board at a pose, px."""
        return np.asarray(self._drawing.camera.project(T_C_T[None, :3, 3])[0])

    def detect(self, poses: Iterable[FloatArray], rng: np.random.Generator) -> FloatArray:
        """Detect the point once per pose, each time with new image noise.

        Args:
            poses: T_C_T of the board, each near the previous one.
            rng: source of the noise.

        Returns:
            (n, 2) px; nan where the board was not detected.
        """
        tracker, pixels = Tracker(self._detector), []
        for pose in poses:
            self._drawing.draw(pose, rng)
            found = tracker.find(self._drawing.frame, self.true_pixel(pose))
            pixels.append(np.full(2, np.nan) if found is None else found.point_px)
        return np.asarray(pixels)
