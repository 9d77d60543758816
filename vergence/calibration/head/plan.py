"""Planning of postures in which both eyes see the whole board, each as different as possible."""

from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.start import board_in_cameras
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import EYES, NECK, FloatArray

_CANDIDATES: Final = 400
"""Random postures from which the next one is chosen (chosen: more take longer)."""
_MARGINS: Final = (0.1, 0.05, 0.02)
"""Margins around the board in the image, in image widths, tried in this order (chosen: a head that
is not yet calibrated may look some degrees beside, each about 9 px of 640)."""
_KNOWN_MARGINS: Final = (0.025, 0.015)
"""Margins once the head is known well, in image widths (chosen: room for the detector)."""
_FARTHEST_NECK_RAD: Final = 0.6
"""Largest angle of a neck joint from rest, rad (chosen: the eyes can compensate for it, and it is
moderate for a resting body)."""
_EYE_OFFSET_RAD: Final = 0.1
"""Largest random offset of an eye actuator from the fixation of one point, rad (chosen)."""
_LIMIT_DISTANCE_RAD: Final = 1e-3
"""Distance of actuators to their limits, beyond the dither, rad (chosen)."""
_NECK_WEIGHT: Final = 0.5
"""Weight of the neck's whole range relative to the board crossing the whole image (chosen)."""


class EstimatedBoard(NamedTuple):
    """A head model, and the corners of the board in frame 0 as each eye of that head sees them."""

    head: HeadModel
    """The estimated head."""
    corners_by_eye: FloatArray
    """(2, n, 3) the board's corners in frame 0, m, as seen by each eye of that head."""
    is_fitted: bool
    """True if head and corners come from a fit to many views."""

    def pixels(self, q: FloatArray) -> FloatArray:
        """(..., 2, n, 2) predicted corners in both eyes at joint angles (..., 7), px."""
        T_0_N = self.head.base_pose(q)[..., None, :, :]
        found = []
        for eye in range(2):
            inside = (self.corners_by_eye[eye] - T_0_N[..., :3, 3]) @ T_0_N[..., 0, :3, :3]
            found.append(self.head.project(q[..., None, :], inside)[..., eye, :])
        return np.stack(found, axis=-3)


def estimate_board_by_last_views(head: HeadModel, frames: HeadFrames) -> EstimatedBoard:
    """Board by the last view of each eye, whose error recurs in its next; else the other's."""
    enough = frames.seen.sum(axis=-1) >= 4
    T_0_N = head.base_pose(frames.joint_positions)
    T_0_C = T_0_N[:, None] @ head.camera_poses(frames.joint_positions)
    corners: list[FloatArray | None] = [None, None]
    for eye, poses in enumerate(board_in_cameras(head, frames)):
        if enough[eye].any():
            last = int(np.flatnonzero(enough[eye])[-1])
            inside = frames.corners @ poses.rotation[last].T + poses.translation[last]
            corners[eye] = inside @ T_0_C[last, eye, :3, :3].T + T_0_C[last, eye, :3, 3]
    there = [
        one if one is not None else other for one, other in zip(corners, corners[::-1], strict=True)
    ]
    return EstimatedBoard(head, np.array(there, dtype=np.float64), False)


class PosePlanner:
    """Chooser of postures unlike (k, 7) earlier ones, with a dither of each actuator, rad."""

    def __init__(self, rng: np.random.Generator, dither_rad: float, used: FloatArray) -> None:
        self._rng, self._keep = rng, dither_rad + _LIMIT_DISTANCE_RAD
        self._used = list(used)

    def next_pose(self, scene: EstimatedBoard) -> FloatArray:
        """(7,) rad, most different from earlier postures, the board inside both images."""
        size = scene.head.cameras.size
        q = self._candidates(scene)
        pixels = scene.pixels(q)
        for margin in _KNOWN_MARGINS if scene.is_fitted else _MARGINS:
            room = margin * size[:, None, :1]
            high = size[:, None] - 1.0 - room
            inside = ((pixels > room) & (pixels < high)).all(axis=(1, 2, 3))
            if inside.any():
                chosen = self._farthest(scene, q[inside])
                self._used.append(chosen)
                return chosen
        raise ConfigurationError(
            "expected a board that fits into both images at once, got one that does not, however "
            "the head turns: put it farther away, or before the middle of the head"
        )

    def _candidates(self, scene: EstimatedBoard) -> FloatArray:
        """(k, 7) random joint angles with the board somewhere near both images."""
        rng, head = self._rng, scene.head
        own, rest = head.actuation, head.rest()
        neck = np.clip(
            rest[NECK] + rng.uniform(-1.0, 1.0, (_CANDIDATES, 3)) * _FARTHEST_NECK_RAD,
            own.lower[NECK],
            own.upper[NECK],
        )
        stretched = np.zeros((_CANDIDATES, 7))
        stretched[:, NECK] = neck
        T_0_N = head.base_pose(stretched)
        middle = scene.corners_by_eye.mean(axis=(0, 1))
        there = np.einsum("kji,kj->ki", T_0_N[:, :3, :3], middle - T_0_N[:, :3, 3])
        half_view = 0.5 * head.cameras.size.min(axis=0) / head.cameras.focal.max(axis=0)
        aside = rng.uniform(-1.0, 1.0, (_CANDIDATES, 2)) * half_view
        there[:, :2] += aside * np.linalg.norm(there, axis=-1, keepdims=True)
        q = own.actuators_of(np.nan_to_num(head.fixate(there, neck)))
        q[:, EYES] += rng.uniform(-_EYE_OFFSET_RAD, _EYE_OFFSET_RAD, (_CANDIDATES, 4))
        return self._held(head, q)

    def _held(self, head: HeadModel, actuators: FloatArray) -> FloatArray:
        """Clip actuators off their limits, and return joint angles."""
        own = head.actuation
        keep = np.minimum(self._keep, 0.5 * (own.upper - own.lower))
        return own.joints_of(np.clip(actuators, own.lower + keep, own.upper - keep))

    def _farthest(self, scene: EstimatedBoard, q: FloatArray) -> FloatArray:
        """Choose the posture farthest from the nearest used one, by `_features`."""
        if not self._used:
            return np.asarray(q[0])
        away = _features(scene, q)[:, None] - _features(scene, np.array(self._used))
        nearest = np.linalg.norm(away, axis=-1).min(axis=1)
        return np.asarray(q[int(nearest.argmax())])


def _features(scene: EstimatedBoard, q: FloatArray) -> FloatArray:
    """(k, 7) features to compare postures: the board's position in both images, and the neck."""
    places = np.nan_to_num(scene.pixels(q).mean(axis=-2) / scene.head.cameras.size)
    neck = _NECK_WEIGHT / (2.0 * _FARTHEST_NECK_RAD) * q[:, NECK]
    return np.concatenate([places.reshape(len(q), -1), neck], axis=-1)
