"""Simulated recordings of a head in front of a board: projected corners with noise, no images."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.adjust import ParametricHead, board_points_and_offsets
from vergence.calibration.head.recording import HeadFrames
from vergence.envs.plant import TrialStart, make_plant, simulation_of
from vergence.envs.reading import Image
from vergence.envs.targets.motion import motion_rows
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.events import BoardView
from vergence.vision import Camera, TargetRenderer, make_detector, parse_target
from vergence.vision.targets import PlanarTarget, TagFamily

_RECORDED_BORDER_PX: Final = 5.0
"""Least distance of a corner to the image's border in a recording, px (chosen)."""
_MOST_TRIES: Final = 200
"""Random postures tried per accepted pose, on average, before an error is raised (numerical)."""


class SimulatedRecording(NamedTuple):
    """A simulated recording, the true joint angles (f, 7), rad, and the boards in frame 0."""

    frames: HeadFrames
    true_q: FloatArray
    boards: BoardPoses


@dataclass(frozen=True, kw_only=True)
class JointReadingErrors:
    """Systematic errors of the readings by actuator, besides quantisation."""

    backlash_rad: FloatArray = field(default_factory=lambda: np.zeros(7))
    """(7,) whole widths of the backlash between the motors, whose angles are read, and the
    joints."""
    harmonics_rad: FloatArray = field(default_factory=lambda: np.zeros((7, 4)))
    """(7, 4) harmonics of true minus read angle q: factors of cos(q), sin(q), cos(2q) and
    sin(2q)."""

    def output_angles(
        self, motors: FloatArray, previous: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(f, 7) angles of (f, 7) motors, rad, and (7,) the last behind the backlash."""
        behind, half = [], 0.5 * self.backlash_rad
        for motor in motors:
            previous = np.clip(previous, motor - half, motor + half)
            behind.append(previous)
        waves = [np.cos(motors), np.sin(motors), np.cos(2.0 * motors), np.sin(2.0 * motors)]
        return np.array(behind) + np.einsum("hfj,jh->fj", waves, self.harmonics_rad), previous


def simulate_recording(
    head: HeadModel,
    true_head: HeadModel,
    rng: np.random.Generator,
    *,
    target: str = "checkerboard:9x6:24",
    poses: int = 60,
    frames_per_pose: int = 8,
    noise_px: float = 0.05,
    distances_m: tuple[float, ...] = (0.7,),
    move_neck: bool = True,
    off_axis: float = 1.0,
    dither_rad: float = np.deg2rad(0.3).item(),
    reading_errors: JointReadingErrors | None = None,
) -> SimulatedRecording:
    """Simulate a recording by a true head whose joints are read as the nominal head's.

    The board stands at `distances_m`, one placement after the other. `off_axis` scales the random
    offsets of the gaze from it; 0 fixates it. `dither_rad` is the dither of a pose's frames.
    """
    board = parse_target(target)
    if isinstance(board, TagFamily):
        raise ConfigurationError(f"target: expected a single board or tag, got {target}")
    corners = np.column_stack([board.corners_m, np.zeros(len(board.corners_m))])
    corners -= corners.mean(axis=0)
    own = head.actuation
    moves = own.upper > own.lower
    T_0_N = head.base_pose(head.rest())
    ahead = [
        np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.05), rng.uniform(0.9, 1.1) * each])
        for each in distances_m
    ]
    boards = BoardPoses(
        np.array(
            [T_0_N[:3, :3] @ Rotation.from_rotvec(v).as_matrix()
             for v in rng.uniform(-0.5, 0.5, (len(ahead), 3))]
        ),
        np.array([T_0_N[:3, :3] @ point + T_0_N[:3, 3] for point in ahead]),
    )  # fmt: skip
    chain = ParametricHead(true_head, true_head.parameters().values)
    size = true_head.cameras.size[0]
    reading_errors = JointReadingErrors() if reading_errors is None else reading_errors
    behind, rest = own.actuators_of(head.rest()), head.rest()[:3]
    angles: list[FloatArray] = []
    read: list[FloatArray] = []
    pixels: list[FloatArray] = []
    placement: list[int] = []
    for _ in range(_MOST_TRIES * poses + 1):
        if len(angles) == poses:
            break
        place = len(angles) * len(ahead) // poses
        q = np.zeros(7)
        if move_neck:
            q[:3] = np.clip(rest + rng.uniform(-0.35, 0.35, 3), own.lower[:3], own.upper[:3])
        T_0_N = head.base_pose(q)
        there = T_0_N[:3, :3].T @ (boards.translation[place] - T_0_N[:3, 3])
        aside = off_axis * np.array([*rng.uniform(-0.15, 0.15, 2), 0.0])
        q = own.actuators_of(head.fixate(there + aside, q[:3], warn=False))
        q[3:] += off_axis * moves[3:] * rng.uniform(-0.06, 0.06, 4)
        dither = rng.uniform(-dither_rad, dither_rad, (frames_per_pose, 7)) * moves
        dither[:, :3] *= move_neck
        motors = np.clip(q, own.lower, own.upper) + dither
        outputs, then = reading_errors.output_angles(motors, behind)
        turned = own.joints_of(outputs)
        points, offsets = board_points_and_offsets(corners, boards, np.full(frames_per_pose, place))
        seen = np.stack(
            [chain.project_board(eye, turned, points, offsets).pixels for eye in range(2)]
        )
        if ((seen > _RECORDED_BORDER_PX) & (seen < size - 1.0 - _RECORDED_BORDER_PX)).all():
            behind = then
            angles.append(turned)
            read.append(own.joints_of(motors))
            pixels.append(seen + noise_px * rng.standard_normal(seen.shape))
            placement += [place] * frames_per_pose
    else:
        raise ConfigurationError(
            f"expected a board that both eyes see whole, got {target} at {distances_m} m"
        )
    found = np.concatenate(pixels, axis=1)
    frames = HeadFrames(
        target=board,
        time_s=0.1 * np.arange(len(placement), dtype=np.float64),
        joint_positions=quantised(head, np.concatenate(read)),
        pixels=found,
        sigma=np.full(found.shape, noise_px),
        placement=np.array(placement, dtype=np.intp),
    )
    return SimulatedRecording(frames, np.concatenate(angles), boards)


def quantised(head: HeadModel, q: FloatArray) -> FloatArray:
    """Quantise joint angles as the head's encoders do."""
    own = head.actuation
    angles, step = own.actuators_of(q), own.angle_step
    whole = np.where(step > 0.0, step, 1.0)
    return own.joints_of(np.where(step > 0.0, whole * np.rint(angles / whole), angles))


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


_Corners = tuple[FloatArray | None, FloatArray | None]
"""(n, 2) corners in an eye's image and their standard deviations, px; or none."""


class SimulatedLooker:
    """`Looker` of a simulated head before a board of pose T_0_T, by the kinematic plant.

    The board is detected in rendered `images` if `drawn`; else its corners are projected, with the
    detection noise of the head's sensor.
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
        self._seed, eyes = rng.integers(2**63, size=1, dtype=np.uint64), range(2 if drawn else 0)
        self._drawings = [
            TargetRenderer(Camera.of(self._true, eye), target, head.rendering) for eye in eyes
        ]
        self._detectors = [make_detector(target, Camera.of(head, eye)) for eye in eyes]

    def look(self, q: FloatArray) -> BoardView:
        """See `Looker.look`."""
        self._looks += 1
        trials = np.array([self._looks], dtype=np.uint64)  # new backlash state per look
        motions = motion_rows(np.array([[0.0, 0.0, 1.0]]))
        reading = self._plant.begin(
            TrialStart(np.arange(1), self._seed, trials, np.array(q)[None], motions)
        )
        true_q = self._plant.truth().positions[0]
        found = self._drawn(true_q) if self._drawings else self._projected(true_q)
        corners, sigma = zip(*found, strict=True)
        return BoardView(_LOOK_S * self._looks, reading.positions[0].copy(), corners, sigma)

    def close(self) -> None:
        """See `Looker.close`."""
        self._plant.close()

    def _projected(self, q: FloatArray) -> list[_Corners]:
        corners = self.target.corners_m @ self._pose[:3, :2].T + self._pose[:3, 3]
        T_0_N = self._true.base_pose(q)
        pixels = self._true.project(q, (corners - T_0_N[:3, 3]) @ T_0_N[:3, :3])
        found: list[_Corners] = [(None, None), (None, None)]
        noise_px = self.head.sensor.detection_noise_px
        for eye, size in enumerate(self._true.cameras.size):
            seen = pixels[:, eye]
            if ((seen >= _BORDER_PX) & (seen <= size - 1.0 - _BORDER_PX)).all():
                sigma = np.full(seen.shape, max(noise_px, _LEAST_SIGMA_PX))
                found[eye] = seen + noise_px * self._rng.standard_normal(seen.shape), sigma
        return found

    def _drawn(self, q: FloatArray) -> list[_Corners]:
        T_0_C = self._true.base_pose(q) @ self._true.camera_poses(q)
        found: list[_Corners] = []
        for pose, drawing, detector in zip(T_0_C, self._drawings, self._detectors, strict=True):
            drawing.draw(np.linalg.inv(pose) @ self._pose, self._rng)
            seen = detector.detect(drawing.frame) if drawing.region is not None else None
            found.append((None, None) if seen is None else (seen.corners_px, seen.corners_sigma_px))
        self.images = tuple(drawing.frame for drawing in self._drawings)
        return found
