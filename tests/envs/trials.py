"""What tests of the environments share: trials that begin as wanted, targets, variations."""

from collections.abc import Callable
from typing import Final

import gymnasium
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

import vergence  # noqa: F401  # registers its environments
from vergence.envs.plant import PLANTS, Plant, TrialStart, is_simulated, simulation_of
from vergence.envs.reading import Reading
from vergence.envs.streams import RandomStreams
from vergence.envs.targets import make_target
from vergence.envs.targets.motion import POINT, Board, motion_rows
from vergence.models import HeadModel

Array = NDArray[np.float64]
AHEAD = (0.0, -0.1, 1.0)


def start_of(
    num: int = 1, point: ArrayLike = AHEAD, before: ArrayLike | None = None,
    positions: ArrayLike = 0.0, seed: int = 0,
) -> TrialStart:  # fmt: skip
    """A trial each of some heads: a target at rest at `point`, at `before` until time zero."""
    points = np.broadcast_to(np.asarray(point, dtype=np.float64), (num, 3))
    angles = np.broadcast_to(np.asarray(positions, dtype=np.float64), (num, 7)).copy()
    ids, seeds = np.arange(num), np.full(num, seed, dtype=np.uint64)
    rows = motion_rows(points, before=before)
    return TrialStart(ids, seeds, ids.astype(np.uint64), angles, rows)


def begin(plant: Plant, start: TrialStart) -> Reading:
    """Begin trials on a simulated plant."""
    return simulation_of(plant).begin(start)


def steps(
    plant: Plant, start: TrialStart, count: int,
    command: ArrayLike | Callable[[int], ArrayLike] = 0.0,
) -> tuple[list[Reading], Array, Array]:  # fmt: skip
    """Readings, angles and velocities (count + 1, num, 7) of trials, from time zero on.

    The command is one that broadcasts to (num, 7), or a function of the step, rad/s.
    """
    readings, positions, velocities = [begin(plant, start).copy()], [], []

    def note() -> None:
        truth = simulation_of(plant).truth()
        positions.append(truth.positions)
        velocities.append(truth.velocities)

    note()
    for step in range(count):
        given = command(step) if callable(command) else command
        joint_velocity = np.broadcast_to(np.asarray(given, dtype=np.float64), (plant.num, 7))
        readings.append(plant.step(joint_velocity.copy()).copy())
        note()
    return readings, np.array(positions), np.array(velocities)


def assert_uniform(sample: ArrayLike) -> None:
    """Fail if numbers that should be uniform in 0 to 1 hardly are."""
    # far below what chance gives once in a thousand, and far above a wrong distribution's
    assert stats.kstest(sample, "uniform").pvalue > 1e-3


def assert_white_normal(noise: Array, sigma: float) -> None:
    """Fail if noise (steps, num, 4) hardly is white and normal, of this standard deviation."""
    # each within four standard deviations of its estimate
    assert noise.std() == pytest.approx(sigma, rel=4 / np.sqrt(2 * noise.size))
    assert abs(noise.mean()) < 4 * sigma / np.sqrt(noise.size)
    assert (noise**4).mean() / sigma**4 == pytest.approx(3.0, abs=4 * np.sqrt(96 / noise.size))
    pairs = np.corrcoef(noise.reshape(-1, 4).T) - np.eye(4)
    assert np.abs(pairs).max() < 4 / np.sqrt(noise.size / 4)
    assert abs((noise[1:] * noise[:-1]).mean()) < 4 * sigma**2 / np.sqrt(noise.size)


def pixels_of(head: HeadModel, q: Array, start: Array, point: ArrayLike = AHEAD) -> Array:
    """Pixels at angles q of a point that rests in frame 0, given in N as it stood at `start`."""
    carry = np.linalg.inv(head.base_pose(q)) @ head.base_pose(start)
    return head.project(q, (carry @ np.array([*point, 1.0]))[..., :3])


def draw(
    head: HeadModel, target: object, num: int = 1, seed: int = 0, first: int = 0,
    board: Board = POINT,
) -> tuple[Array, Array]:  # fmt: skip
    """Motions and starting angles of trials of a seed, from the `first` on."""
    streams, ids = RandomStreams(num), np.arange(num)
    trials = (first + ids).astype(np.uint64)
    streams.start(ids, np.full(num, seed, dtype=np.uint64), trials)
    return make_target(target).draw(head, streams, ids, board)


def midpoint_between_eyes(head: HeadModel) -> Array:
    """(3,) the point in the middle of both eyes at rest, in N, m."""
    return head.camera_poses(head.rest())[:, :3, 3].mean(axis=0)


def eccentricity(head: HeadModel, points: Array) -> Array:
    """(...) angles of points from straight ahead, as workspaces count them, rad."""
    aside = np.hypot(*np.moveaxis((points - midpoint_between_eyes(head))[..., :2], -1, 0))
    return np.arctan(aside / points[..., 2])


def inside(head: HeadModel, q: Array, points: Array) -> bool:
    """True if all points are visible to both eyes."""
    pixels = head.project(q, points)
    return bool(((pixels >= 0) & (pixels <= head.cameras.size - 1)).all())


MODEL_ERRORS: Final = {
    "joint_offset_rad": 0.01, "principal_px": 1.0, "distortion": 0.01, "common_tilt_rad": 0.01,
}  # fmt: skip
LOOP: Final = {
    "latency_s": (0.03, 0.13), "lag_s": (0.015, 0.06), "detection_noise_px": (0.0, 0.15),
    "dropped_frame_probability": (0.0, 0.3), "jitter_s": (0.0, 0.02),
    "missed_detection_probability": (0.0, 0.2), "outlier_probability": (0.0, 0.1),
    "outlier_px": (50.0, 100.0), "frame_rate_hz": (25.0, 150.0), "frame_phase": (0.0, 1.0),
    "clock_drift": (-0.01, 0.01), "command_latency_s": (0.0, 0.02),
    "feedback_latency_s": (0.0, 0.02), "angle_noise_rad": (0.0, 0.001),
    "speed_noise_rad_s": (0.0, 0.05), "acceleration_ratio": (0.4, 1.2),
    "torque_falloff": (0.0, 0.5), "onset_s": (0.0, 0.2), "speed_gain": (0.85, 1.15),
    "backlash_rad": (0.0, 0.003), "speed_filter_s": (0.0, 0.04), "speed_latency_s": (0.0, 0.02),
    "speed_span_s": (0.0, 0.04), "lost_command_probability": (0.0, 0.1),
    "stall_probability": (0.0, 0.02), "stall_s": (0.0, 0.1),
    "false_detection_probability": (0.0, 0.02), "false_detection_s": (0.0, 0.2),
    "false_detection_px": (50.0, 100.0), "overshoot": (0.0, 0.4), "skew_s": (0.0, 0.03),
}  # fmt: skip
EVERYTHING: Final = {**LOOP, "model_errors": MODEL_ERRORS}


SIMULATED_PLANTS = sorted(name for name in PLANTS if is_simulated(name))
SIMULATED_IDS = sorted(
    id for id in gymnasium.registry if id.startswith("vergence/") and "Hardware" not in id
)
