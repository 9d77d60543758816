"""Simulated recordings of a head in front of a board: projected corners with noise, no images."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.calibration.adjustment import BoardPoses
from vergence.calibration.head.chain import ParametricHead, board_points_and_offsets
from vergence.calibration.head.frames import HeadFrames
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision import parse_target
from vergence.vision.targets import TagFamily

BORDER_PX: Final = 5.0
"""Least distance of a corner to the image's border, px (chosen)."""
_MOST_TRIES: Final = 200
"""Random postures tried per accepted pose, on average, before an error is raised (numerical)."""


@dataclass(frozen=True, kw_only=True)
class SimulatedRecording:
    """A simulated recording, and its ground truth."""

    frames: HeadFrames
    true_q: FloatArray
    """(f, 7) true joint angles, rad."""
    boards: BoardPoses
    """(b) true poses of the board in frame 0."""


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
        behind = []
        for motor in motors:
            previous = np.clip(
                previous, motor - 0.5 * self.backlash_rad, motor + 0.5 * self.backlash_rad
            )
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
    """Simulate a recording of boards by a true head.

    Args:
        head: the nominal head, which reads the joints.
        true_head: the true head, which looks.
        rng: the source of randomness.
        target: the board.
        poses: number of poses.
        frames_per_pose: frames per pose, each with all joints dithered.
        noise_px: standard deviation of each coordinate of a corner.
        distances_m: distances of the board, one placement after the other.
        move_neck: True to move the neck as well.
        off_axis: scale of the random gaze offsets from the board; 0 to fixate it.
        dither_rad: amplitude of the dither about a pose.
        reading_errors: systematic errors of the readings, besides quantisation.

    Raises:
        ConfigurationError: the target has no corners of its own, or is hardly ever whole in both
            images.
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
    behind = own.actuators_of(head.rest())
    angles: list[FloatArray] = []
    read: list[FloatArray] = []
    pixels: list[FloatArray] = []
    placement: list[int] = []
    for _ in range(_MOST_TRIES * poses + 1):
        if len(angles) == poses:
            break
        place = len(angles) * len(ahead) // poses
        rest = head.rest()[:3]
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
        inside = (seen > BORDER_PX) & (seen < size - 1.0 - BORDER_PX)
        if inside.all():
            behind = then
            angles.append(turned)
            read.append(own.joints_of(motors))
            pixels.append(seen + noise_px * rng.standard_normal(seen.shape))
            placement += [place] * frames_per_pose
    else:
        raise ConfigurationError(
            f"expected a board that both eyes see whole, got {target} at {distances_m} m"
        )
    true_q = np.concatenate(angles)
    return SimulatedRecording(
        frames=HeadFrames(
            target=board,
            time_s=0.1 * np.arange(len(true_q), dtype=np.float64),
            joint_positions=quantised(head, np.concatenate(read)),
            pixels=np.concatenate(pixels, axis=1),
            sigma=np.full((2, len(true_q), len(corners), 2), noise_px),
            placement=np.array(placement, dtype=np.intp),
        ),
        true_q=true_q,
        boards=boards,
    )


def quantised(head: HeadModel, q: FloatArray) -> FloatArray:
    """Quantise joint angles as the head's encoders do."""
    own = head.actuation
    angles, step = own.actuators_of(q), own.angle_step
    whole = np.where(step > 0.0, step, 1.0)
    return own.joints_of(np.where(step > 0.0, whole * np.rint(angles / whole), angles))
