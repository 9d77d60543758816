"""Simulated head in front of a fixed board: exact projections with noise, or rendered images."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.envs.plant import make_plant
from vergence.envs.plants.simulation import TrialStart, simulation_of
from vergence.envs.reading import Image
from vergence.envs.targets.motion import motion_rows
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.looking import BoardView
from vergence.vision import Camera, TargetRenderer, make_detector
from vergence.vision.targets import PlanarTarget

_LOOK_S: Final = 1.0
"""Simulated time per look, s (chosen)."""
_BOARD_ROTATION_VECTOR: Final = (0.25, -0.2, 0.1)
"""Rotation vector of the board from upright, in its frame, rad (chosen: as if set up by hand)."""
_BORDER_PX: Final = 3.0
"""Least distance of corners to the image's border, px (chosen: room for a detector)."""
_LEAST_SIGMA_PX: Final = 1e-3
"""Least standard deviation of a corner, px, as an adjustment needs one above zero (numerical)."""


def board_ahead(head: HeadModel, target: PlanarTarget, distance_m: float) -> FloatArray:
    """(4, 4) T_0_T, m, of a board ahead of a head at rest, upright to some degrees."""
    q = head.rest()
    left, right = head.base_pose(q) @ head.camera_poses(q)
    ahead = left[:3, 2] + right[:3, 2]
    pose = np.eye(4)
    pose[:3, :3] = left[:3, :3] @ Rotation.from_rotvec(_BOARD_ROTATION_VECTOR).as_matrix()
    middle = 0.5 * (left[:3, 3] + right[:3, 3]) + distance_m * ahead / np.linalg.norm(ahead)
    pose[:3, 3] = middle - pose[:3, :2] @ target.corners_m.mean(axis=0)
    return pose


class SimulatedLooker:
    """`Looker` of a simulated head, with encoders and backlash of the kinematic plant.

    Args:
        head: the nominal head model.
        target: the board.
        pose: (4, 4) pose of the board, T_0_T.
        rng: the source of all noise.
        true_head: the true head; None for the nominal one.
        drawn: True to detect the board in rendered images; else its corners are projected, with the
            detection noise of the head's sensor.

    Attributes:
        images: rendered images of the last look by eye, (height, width) grey levels; empty if
            `drawn` is False.
    """

    def __init__(
        self,
        head: HeadModel,
        target: PlanarTarget,
        pose: FloatArray,
        rng: np.random.Generator,
        *,
        true_head: HeadModel | None = None,
        drawn: bool = False,
    ) -> None:
        self.head, self.target = head, target
        self.images: tuple[Image, ...] = ()
        self._true = head if true_head is None else true_head
        self._pose, self._rng, self._looks = pose, rng, 0
        self._plant = simulation_of(make_plant("kinematic", head, true_head=true_head))
        self._seed = rng.integers(2**63, size=1, dtype=np.uint64)
        self._drawings = [
            TargetRenderer(Camera.of(self._true, eye), target, head.rendering)
            for eye in range(2 if drawn else 0)
        ]
        self._detectors = [
            make_detector(target, Camera.of(head, eye)) for eye in range(2 if drawn else 0)
        ]

    def look(self, q: FloatArray) -> BoardView:
        """See `Looker.look`."""
        self._looks += 1
        reading = self._plant.begin(
            TrialStart(
                ids=np.arange(1),
                seeds=self._seed,
                trials=np.array([self._looks], dtype=np.uint64),  # new backlash state per look
                positions=np.array(q)[None],
                motions=motion_rows(np.array([[0.0, 0.0, 1.0]])),
            )
        )
        true_q = self._plant.truth().positions[0]
        found = self._drawn(true_q) if self._drawings else self._projected(true_q)
        return BoardView(
            _LOOK_S * self._looks,
            reading.positions[0].copy(),
            (found[0][0], found[1][0]),
            (found[0][1], found[1][1]),
        )

    def close(self) -> None:
        """See `Looker.close`."""
        self._plant.close()

    def _projected(self, q: FloatArray) -> Sequence[tuple[FloatArray | None, FloatArray | None]]:
        corners = self.target.corners_m @ self._pose[:3, :2].T + self._pose[:3, 3]
        T_0_N = self._true.base_pose(q)
        pixels = self._true.project(q, (corners - T_0_N[:3, 3]) @ T_0_N[:3, :3])
        found: list[tuple[FloatArray | None, FloatArray | None]] = []
        for eye in range(2):
            seen, most = pixels[:, eye], self._true.cameras.size[eye] - 1.0 - _BORDER_PX
            if not ((seen >= _BORDER_PX) & (seen <= most)).all():
                found.append((None, None))
                continue
            noise_px = self.head.sensor.detection_noise_px
            sigma = np.full(seen.shape, max(noise_px, _LEAST_SIGMA_PX))
            found.append((seen + noise_px * self._rng.standard_normal(seen.shape), sigma))
        return found

    def _drawn(self, q: FloatArray) -> Sequence[tuple[FloatArray | None, FloatArray | None]]:
        T_0_C = self._true.base_pose(q) @ self._true.camera_poses(q)
        found: list[tuple[FloatArray | None, FloatArray | None]] = []
        for eye, (drawing, detector) in enumerate(
            zip(self._drawings, self._detectors, strict=True)
        ):
            drawing.draw(np.linalg.inv(T_0_C[eye]) @ self._pose, self._rng)
            seen = detector.detect(drawing.frame) if drawing.region is not None else None
            found.append((None, None) if seen is None else (seen.corners_px, seen.corners_sigma_px))
        self.images = tuple(drawing.frame for drawing in self._drawings)
        return found
