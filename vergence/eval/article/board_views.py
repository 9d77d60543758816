r"""Repeated noisy images of a board at fixed poses, and the detections in them.

The Cramer-Rao bound of a point's pixel follows from the renderer's image. A frame is the noise-free
image I(p) plus white noise of variance s^2 (the camera's plus 1/12 from rounding). The Fisher
information of the parameters p is then

    F = sum over pixels (dI/dp) (dI/dp)^T / s^2,

with derivatives by finite differences of noise-free images. The parameters are the point's pixel
(u, v) and, as nuisance parameters, the rest of the board's pose: its depth along the ray and its
rotation. No unbiased estimator that uses the whole images of n frames has a variance of u below
[F^-1]_uu / n.
"""

import dataclasses
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.drawing import TargetRenderer
from vergence.vision.targets import board_pose, make_planar_target
from vergence.vision.tracking import Tracker, make_detector


def board_poses_in_eyes(head: HeadModel, q: ArrayLike, point: ArrayLike) -> FloatArray:
    """(2, 4, 4) poses T_Cl_T and T_Cr_T of a board at `point` in N that faces forward, m."""
    return np.asarray(np.linalg.inv(head.camera_poses(q)) @ board_pose(point, "forward"))


def shifted_pose(head: HeadModel, eye: int, T_C_T: FloatArray, offset_px: ArrayLike) -> FloatArray:
    """Translate a pose parallel to the image plane, so that its point moves by `offset_px`."""
    pose = T_C_T.copy()
    pose[:2, 3] += pose[2, 3] * np.asarray(offset_px) / head.cameras.focal[eye]
    return pose


class FixedView:
    """One eye (0 left, 1 right) before one checkerboard: draws images and detects in them."""

    def __init__(self, head: HeadModel, eye: int) -> None:
        camera, target = Camera.of(head, eye), make_planar_target("checkerboard")
        self._drawing = TargetRenderer(camera, target, head.rendering)
        self._detector = make_detector(target, camera)

    def true_pixel(self, T_C_T: FloatArray) -> FloatArray:
        """(2,) true raw pixel of the point of a board at a pose, px."""
        return np.asarray(self._drawing.camera.project(T_C_T[None, :3, 3])[0])

    def detect(self, poses: Iterable[FloatArray], rng: np.random.Generator) -> FloatArray:
        """(n, 2) detections, px, one per pose near the last, each with new noise; nan if lost."""
        tracker, pixels = Tracker(self._detector), []
        for pose in poses:
            self._drawing.draw(pose, rng)
            found = tracker.find(self._drawing.frame, self.true_pixel(pose))
            pixels.append(np.full(2, np.nan) if found is None else found.point_px)
        return np.asarray(pixels)


STEP_PX: Final = 0.25
"""Shift of edges for finite differences, px: below the blur, above the rounding (numerical)."""
WINDOW_PX: Final = 5
"""Half side of the detector's window around a corner, px (numerical)."""


class CramerRaoBound(NamedTuple):
    """Standard deviations that no unbiased estimator from one frame can beat, px."""

    board: FloatArray
    """(2,) u, v: from the whole board with unknown pose."""
    window: FloatArray
    """(2,) u, v: from the detector's window around the corner, with all else known."""


def cramer_rao_bound(head: HeadModel, eye: int, T_C_T: FloatArray) -> CramerRaoBound:
    """The bounds for one eye's view of the checkerboard at a pose T_C_T, (4, 4), m."""
    camera, board = Camera.of(head, eye), make_planar_target("checkerboard")
    rendering = head.rendering
    # full contrast reduces the rounding error of the finite differences
    contrast = (rendering.white_grey - rendering.black_grey) / 255.0
    background = (rendering.background_grey - rendering.black_grey) / contrast
    plain = dataclasses.replace(
        rendering, noise_grey=0.0, black_grey=0.0, white_grey=255.0, background_grey=background
    )
    drawing = TargetRenderer(camera, board, plain)

    def image(pose: FloatArray) -> FloatArray:
        drawing.draw(pose)
        return contrast * drawing.frame.astype(np.float64)

    slopes = [
        (image(_moved(head, eye, T_C_T, i, step)) - image(_moved(head, eye, T_C_T, i, -step)))
        / (2.0 * step)
        for i, step in enumerate(_steps(head, eye, T_C_T))
    ]
    variance = rendering.noise_grey**2 + 1.0 / 12.0
    flat = np.stack([slope.ravel() for slope in slopes])
    board_sigma = np.sqrt(np.diag(np.linalg.inv(flat @ flat.T / variance))[:2])
    u, v = np.rint(camera.project(T_C_T[None, :3, 3])[0]).astype(int).tolist()
    rows = slice(v - WINDOW_PX, v + WINDOW_PX + 1)
    columns = slice(u - WINDOW_PX, u + WINDOW_PX + 1)
    near = np.stack([slope[rows, columns].ravel() for slope in slopes[:2]])
    window_sigma = np.sqrt(np.diag(np.linalg.inv(near @ near.T / variance)))
    return CramerRaoBound(board_sigma, window_sigma)


def _steps(head: HeadModel, eye: int, T_C_T: FloatArray) -> FloatArray:
    """Steps of u, v (px), log depth and rotation (rad) that shift the board's far edge equally."""
    board = make_planar_target("checkerboard")
    focal = float(head.cameras.focal[eye].mean())
    extent = max(board.cells.shape) * board.cell_m / float(T_C_T[2, 3]) * focal
    turn, tilt = STEP_PX / extent, STEP_PX * focal / extent**2
    return np.array([STEP_PX, STEP_PX, turn, tilt, tilt, turn])


def _moved(head: HeadModel, eye: int, T_C_T: FloatArray, parameter: int, step: float) -> FloatArray:
    """Change one parameter of the pose; only the first two move the point's pixel."""
    if parameter < 2:
        return shifted_pose(head, eye, T_C_T, step * np.eye(2)[parameter])
    pose = T_C_T.copy()
    if parameter == 2:
        pose[:3, 3] *= np.exp(step)
    else:
        axis = np.eye(3)[parameter - 3]
        pose[:3, :3] = Rotation.from_rotvec(step * axis).as_matrix() @ pose[:3, :3]
    return pose
