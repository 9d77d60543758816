"""Postures in which a head sees all of a board, each as far from the others as can be."""

from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.start import board_in_cameras
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, NECK
from vergence.models.parts import FloatArray

_CANDIDATES: Final = 400
_MARGINS: Final = (0.1, 0.05, 0.02)
"""Room about the board, by the image's width: a head that is not yet calibrated may look some
degrees beside, each of which is about 9 px of 640."""
_KNOWN_MARGINS: Final = (0.025, 0.015)
"""The same once the head is known well: room that a detector needs."""
_FARTHEST_NECK_RAD: Final = 0.6
"""From rest: what the eyes can make up for, and what a body at rest likes."""
_APART_RAD: Final = 0.1
"""By how much each actuator of the eyes differs at most from where both look at one point."""
_LIMIT_RAD: Final = 1e-3
"""Distance that joints keep to their limits, beyond the dither."""
_NECK_WEIGHT: Final = 0.5
"""What the neck's whole range counts beside a board that crosses the whole image."""


class Scene(NamedTuple):
    """Where a board stands, as far as one knows."""

    head: HeadModel
    """The head as it is believed to be."""
    corners: FloatArray
    """(2, n, 3) the board's corners in frame 0, m, as either eye sees them through that head."""
    known: bool
    """Whether head and corners come from a fit to many views."""

    def pixels(self, q: FloatArray) -> FloatArray:
        """(..., 2, n, 2) where the corners appear to the eyes at joint angles (..., 7), px."""
        T_0_N = self.head.base_pose(q)[..., None, :, :]
        found = []
        for eye in range(2):
            inside = (self.corners[eye] - T_0_N[..., :3, 3]) @ T_0_N[..., 0, :3, :3]
            found.append(self.head.project(q[..., None, :], inside)[..., eye, :])
        return np.stack(found, axis=-3)


def scene_of(head: HeadModel, frames: HeadFrames) -> Scene:
    """Where the last view of either eye has the board, through the head as its file has it.

    What an eye is off by shows again in its next view, so that each has the board where its own
    view had it; an eye that has not seen it has that of the other one.

    Args:
        head: as its file has it.
        frames: at least one view of four corners.
    """
    enough = frames.seen.sum(axis=-1) >= 4
    T_0_N = head.base_pose(frames.positions)
    T_0_C = T_0_N[:, None] @ head.camera_poses(frames.positions)
    corners: list[FloatArray | None] = [None, None]
    for eye, poses in enumerate(board_in_cameras(head, frames)):
        if enough[eye].any():
            last = int(np.flatnonzero(enough[eye])[-1])
            inside = frames.corners @ poses.rotation[last].T + poses.translation[last]
            corners[eye] = inside @ T_0_C[last, eye, :3, :3].T + T_0_C[last, eye, :3, 3]
    there = [
        one if one is not None else other for one, other in zip(corners, corners[::-1], strict=True)
    ]
    return Scene(head, np.array(there, dtype=np.float64), False)


class Plan:
    """Chooses one posture after the other.

    Args:
        rng: the source of randomness.
        dither_rad: by how much each actuator will be moved about a posture, rad.
        used: (k, 7) joint angles of earlier postures.
    """

    def __init__(self, rng: np.random.Generator, dither_rad: float, used: FloatArray) -> None:
        self._rng, self._keep = rng, dither_rad + _LIMIT_RAD
        self._used = list(used)

    def next(self, scene: Scene) -> FloatArray:
        """The next posture: of many in which both images hold the board, the one least like others.

        Args:
            scene: where the board stands.

        Returns:
            (7,) joint angles, rad.

        Raises:
            ConfigurationError: there is none.
        """
        size = scene.head.cameras.size
        q = self._candidates(scene)
        pixels = scene.pixels(q)
        for margin in _KNOWN_MARGINS if scene.known else _MARGINS:
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

    def _candidates(self, scene: Scene) -> FloatArray:
        """(k, 7) joint angles with the board somewhere near both images."""
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
        middle = scene.corners.mean(axis=(0, 1))
        there = np.einsum("kji,kj->ki", T_0_N[:, :3, :3], middle - T_0_N[:, :3, 3])
        half_view = 0.5 * head.cameras.size.min(axis=0) / head.cameras.focal.max(axis=0)
        aside = rng.uniform(-1.0, 1.0, (_CANDIDATES, 2)) * half_view
        there[:, :2] += aside * np.linalg.norm(there, axis=-1, keepdims=True)
        q = own.actuators_of(np.nan_to_num(head.fixate(there, neck)))
        q[:, EYES] += rng.uniform(-_APART_RAD, _APART_RAD, (_CANDIDATES, 4))
        return self._held(head, q)

    def _held(self, head: HeadModel, actuators: FloatArray) -> FloatArray:
        """Joint angles of actuators that keep off their limits; what does not move rests."""
        own = head.actuation
        keep = np.minimum(self._keep, 0.5 * (own.upper - own.lower))
        return own.joints_of(np.clip(actuators, own.lower + keep, own.upper - keep))

    def _farthest(self, scene: Scene, q: FloatArray) -> FloatArray:
        """The posture that is least like those that were used."""
        if not self._used:
            return np.asarray(q[0])
        away = _features(scene, q)[:, None] - _features(scene, np.array(self._used))
        nearest = np.linalg.norm(away, axis=-1).min(axis=1)
        return np.asarray(q[int(nearest.argmax())])


def _features(scene: Scene, q: FloatArray) -> FloatArray:
    """(k, 7) what postures are compared by: the board's places in both images, and the neck."""
    places = np.nan_to_num(scene.pixels(q).mean(axis=-2) / scene.head.cameras.size)
    neck = _NECK_WEIGHT / (2.0 * _FARTHEST_NECK_RAD) * q[:, NECK]
    return np.concatenate([places.reshape(len(q), -1), neck], axis=-1)
