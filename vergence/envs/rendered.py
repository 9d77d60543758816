"""The rendered plant: MuJoCo's dynamics, drawn images, and a real detector that looks at them."""

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.envs.motion import BEFORE, SEEN_BEFORE, target_position
from vergence.envs.mujoco import MujocoPlant
from vergence.envs.streams import IntArray, Purpose
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import NECK
from vergence.models.parts import FloatArray
from vergence.vision.detection import Detection, Detector, make_detector
from vergence.vision.drawing import TargetDrawing
from vergence.vision.optics import EyeCamera
from vergence.vision.targets import make_planar_target


def eye_camera(head: HeadModel, eye: int) -> EyeCamera:
    """One eye's intrinsics as the vision modules take them."""
    cameras = head.cameras
    return EyeCamera(
        width=cameras.width,
        height=cameras.height,
        focal_px=tuple(cameras.focal[eye]),
        principal_px=tuple(cameras.principal[eye]),
        distortion=tuple(cameras.distortion[eye]),
    )


def board_pose(point: ArrayLike, facing: Literal["head", "forward"] = "head") -> FloatArray:
    """The pose of a board whose measured point is at a point of N.

    Args:
        point: (3,) in N, m.
        facing: `head`, square to the line from N's origin; `forward`, parallel to N's xy plane.

    Returns:
        (4, 4) T_N_T: x right and y down as seen from the head, z into the board.
    """
    point = np.asarray(point, dtype=np.float64)
    pose = np.eye(4)
    pose[:3, 3] = point
    if facing == "head":
        z = point / np.sqrt(point @ point)
        x = np.array([z[2], 0.0, -z[0]])
        x /= np.sqrt(x @ x)
        pose[:3, 0], pose[:3, 2] = x, z
        pose[:3, 1] = (z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], -z[1] * x[0])
    return pose


class _Eye:
    """One eye's camera, its drawing and its tracker."""

    def __init__(self, drawing: TargetDrawing, detector: Detector) -> None:
        self.drawing = drawing
        self.detector = detector
        self.forget()

    def forget(self) -> None:
        """Lose the track."""
        self.previous: Detection | None = None
        self.motion = np.zeros(2)

    def look(
        self, T_C_T: FloatArray, smear_px: FloatArray, rng: np.random.Generator
    ) -> FloatArray | None:
        """Draw a frame and find the target in it, near where it is expected if it is tracked."""
        self.drawing.draw(T_C_T, rng, smear_px)
        found = None
        if self.previous is not None:
            around = self.previous.point_px + self.motion
            found = self.detector.track(self.drawing.frame, around, self.previous)
        if found is None and self.drawing.region is not None:
            # without a drawn region the whole frame is plain background: nothing to search
            found = self.detector.detect(self.drawing.frame)
        if found is None:
            self.forget()
            return None
        if self.previous is not None:
            self.motion = found.point_px - self.previous.point_px
        self.previous = found
        return found.point_px


class RenderedPlant(MujocoPlant):
    """Heads whose eyes see drawn images, in which a detector finds the target.

    Detection noise is the detector's own; the grey levels' noise is the preset's rendering.

    Args:
        head: the model that a controller knows.
        num: how many heads move side by side.
        board: what the target shows: `tag` (AprilTag 36h11) or `checkerboard`.
        facing: where the board looks, see `board_pose`.
        **options: those of `MujocoPlant`.
    """

    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        board: Literal["tag", "checkerboard"] = "tag",
        facing: Literal["head", "forward"] = "head",
        **options: Any,
    ) -> None:
        if facing not in ("head", "forward"):
            raise ConfigurationError(f"facing: expected 'head' or 'forward', got {facing!r}")
        super().__init__(head, num, **options)
        self._board = make_planar_target(board)
        self._facing: Literal["head", "forward"] = facing
        many = bool(self.true_head.batch_shape)
        self._true = [
            self.true_head[i % len(self._heads)] if many else self.true_head for i in range(num)
        ]
        self._eyes = [self._make_eyes(place) for place in range(num)]
        self._ids = np.arange(num)

    def _make_eyes(self, place: int) -> tuple[_Eye, _Eye]:
        left, right = (
            _Eye(
                TargetDrawing(eye_camera(self._true[place], eye), self._board, self.head.rendering),
                make_detector(self._board, eye_camera(self.head, eye)),
            )
            for eye in range(2)
        )
        return left, right

    def frames(self, place: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The present images of both eyes, (height, width) grey levels, reused by the next step.

        Args:
            place: which head of the batch.

        Returns:
            Left and right image.
        """
        left, right = self._eyes[place]
        return left.drawing.frame, right.drawing.frame

    def _fill_before(self, ids: IntArray) -> None:
        timing = self.head.timing
        for place in ids:
            for eye in self._eyes[place]:
                eye.forget()
            self._frame_arrived[place] = False
            if self._motions[place, SEEN_BEFORE] == 0.0:
                continue
            for step in range(-self._ring, 0):
                if step % timing.periods_per_frame == 0:
                    self._look(int(place), step, self._motions[place, BEFORE])

    def _expose(self, ids: IntArray | None) -> None:
        target = self.truth().target
        every = self.head.timing.periods_per_frame
        for place in self._ids if ids is None else ids:
            step = int(self._step[place])
            slot = step % self._ring
            cell = step % self._chance.shape[1]
            dropped = self._drop[place] > 0.0 and self._chance[place, cell] < self._drop[place]
            self._frame_arrived[place, slot] = False
            if step % every == 0 and not dropped:
                self._look(int(place), step, target[place])

    def _look(self, place: int, step: int, point: FloatArray) -> None:
        """Take both eyes' frames of a step and put what is found into the rings."""
        slot = step % self._ring
        # the steps before time zero have the odd blocks, as many as there are
        rng = self._streams.at(place, Purpose.IMAGE, 2 * step if step >= 0 else -2 * step - 1)
        head = self._true[place]
        q = self._q[place]
        T_N_T = board_pose(point, self._facing)
        T_N_C = head.camera_poses(q)
        smear = self._smear(head, place, step)
        self._frame_arrived[place, slot] = True
        for eye in range(2):
            R, t = T_N_C[eye, :3, :3], T_N_C[eye, :3, 3]
            T_C_T = np.eye(4)
            T_C_T[:3, :3] = R.T @ T_N_T[:3, :3]
            T_C_T[:3, 3] = R.T @ (T_N_T[:3, 3] - t)
            found = self._eyes[place][eye].look(T_C_T, smear[eye], rng)
            self._frame_visible[place, slot, eye] = found is not None
            if found is not None:
                self._frame_pixels[place, slot, eye] = found

    def _smear(self, head: HeadModel, place: int, step: int) -> FloatArray:
        """(2, 2) how far the target's image moves while the shutter is open, px."""
        half = 0.5 * self.head.timing.exposure_s
        if half == 0.0:
            return _STILL
        time = step * self.head.timing.period_s + half * _ENDS
        points = target_position(self._motions[place], time)
        q = self._q[place] + half * _ENDS[:, None] * self._v[place]
        start = np.zeros(7)
        start[NECK] = self._necks[place]
        carry = np.linalg.inv(head.base_pose(q)) @ head.base_pose(start)
        points = (carry[:, :3, :3] @ points[..., None])[..., 0] + carry[:, :3, 3]
        begin, end = head.project(q, points)
        return np.asarray(np.nan_to_num(end - begin))


_STILL = np.zeros((2, 2))
_ENDS = np.array([-1.0, 1.0])
