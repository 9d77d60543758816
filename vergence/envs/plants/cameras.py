"""The cameras: their clock and its faults, the projection of targets, and rendered images.

The middle of the exposure of frame f of a trial is at `(phase + f) (1 + drift) / rate`, on the
cameras' own clock, which is independent of the control period. The frame becomes readable after the
latency and a jitter of its own, but never before an earlier frame; a dropped frame never does. The
faults of a frame depend only on the trial and on f.

If the right eye is exposed after the left, by the trial's skew, frame f has two exposures, numbers
2 f and 2 f + 1. Otherwise both eyes share exposure number f.
"""

from math import ceil, cos, pi, sin
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.plants.conditions import EnvIndex, TrialConditions
from vergence.envs.reading import BoolArray, Image, Truth, check_finite_number
from vergence.envs.streams import (
    IntArray,
    StreamKey,
    StreamPurpose,
    Words,
    four_normals,
    random_words,
    to_uniform,
)
from vergence.envs.targets.motion import POINT, Board, motion_position_at, view_motion
from vergence.errors import ConfigurationError
from vergence.kernels import compiled, inlined, subroutine
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    PackedHead,
    Vector,
    inside_image,
    neck_frame,
    pixel_error,
    point_in_eye,
    point_to_local,
    point_to_outer,
    point_to_pixel,
)
from vergence.models.parts import FloatArray
from vergence.vision.drawing import TargetRenderer
from vergence.vision.objects.room import RoomRenderer
from vergence.vision.objects.scenes import Scene, hit
from vergence.vision.objects.sights import line_of_sight
from vergence.vision.targets import AprilTag, Checkerboard, PlanarTarget, board_pose, outline_m

TIME_TOLERANCE_S: Final = 1e-9
"""Difference below which two times are equal: rounding of sums of periods, s (numerical)."""
_SENSOR: Final = int(StreamPurpose.SENSOR)
_SENSOR_BEFORE_START: Final = int(StreamPurpose.SENSOR_BEFORE_START)


def ring_size(min_length: int) -> int:
    """Length of a ring buffer of at least `min_length`: a power of two, so a mask is modulo."""
    return 1 << (min_length - 1).bit_length()


class Frames(NamedTuple):
    """Ring buffers of exposed frames that may not have arrived yet: frame f lies at f modulo F.

    F is a power of two, as is the length of every ring buffer here.
    """

    pixels: FloatArray  # (n, F, 2, 2) detections in both eyes' frames, px
    visible: BoolArray  # (n, F, 2) True if the target was detected
    dropped: BoolArray  # (n, F) True if the frame never arrives
    exposed_s: FloatArray  # (n, F) middle of the exposure since the trial's start, s
    comes_s: FloatArray  # (n, F) time at which the frame becomes readable, s
    next: IntArray  # (n,) number of the next exposure, see `exposed_eyes`
    pending: IntArray  # (n,) number of the first frame that has not arrived
    latest_s: FloatArray  # (n,) time at which the last exposed frame becomes readable, s

    @classmethod
    def empty(cls, num: int, max_latency_s: float, max_hz: float) -> "Frames":
        """Ring buffers without frames."""
        size = ring_size(ceil(max_latency_s * max_hz) + 2)
        return cls(
            pixels=np.zeros((num, size, 2, 2)), visible=np.zeros((num, size, 2), dtype=np.bool_),
            dropped=np.zeros((num, size), dtype=np.bool_), exposed_s=np.zeros((num, size)),
            comes_s=np.zeros((num, size)), next=np.zeros(num, dtype=np.int64),
            pending=np.zeros(num, dtype=np.int64), latest_s=np.zeros(num),
        )  # fmt: skip


class Exposures(NamedTuple):
    """The exposures within the present period, and the joints at their times."""

    counts: IntArray  # (n,) number of exposures
    time_s: FloatArray  # (n, E) middle of each exposure since the trial's start, s
    positions: FloatArray  # (n, E, 7) joint angles, rad
    velocities: FloatArray  # (n, E, 7) joint velocities, rad/s

    @classmethod
    def empty(
        cls, num: int, period_s: float, max_hz: float, exposures_per_frame: int = 1
    ) -> "Exposures":
        """Arrays for a period at the highest frame rate."""
        size = exposures_per_frame * (ceil(period_s * max_hz) + 1)
        return cls(
            counts=np.zeros(num, dtype=np.int64), time_s=np.zeros((num, size)),
            positions=np.zeros((num, size, 7)), velocities=np.zeros((num, size, 7)),
        )  # fmt: skip


class FrameFaults(NamedTuple):
    """Random faults of one pair of frames."""

    dropped: bool
    extra_latency_s: float  # delay beyond the latency, s
    missed_left: bool
    missed_right: bool


@inlined
def frame_exposure_time(conditions: TrialConditions, frame: int) -> float:
    """Time of a frame's (first) exposure since the trial's start, s."""
    return (conditions.frame_phase + frame) * conditions.frame_s


@inlined
def exposed_eyes(conditions: TrialConditions, exposure: int) -> tuple[int, int, int]:
    """Frame of an exposure, the first eye that it exposes, and one past the last."""
    if conditions.skew_s == 0.0:
        return exposure, 0, 2
    eye = exposure & 1
    return exposure >> 1, eye, eye + 1


@inlined
def first_exposure_of_frame(conditions: TrialConditions, frame: int) -> int:
    """The first exposure of a frame."""
    return frame if conditions.skew_s == 0.0 else 2 * frame


@inlined
def eye_skew_s(conditions: TrialConditions) -> float:
    """Delay of the right eye's exposure after the left's, at most one frame time, s."""
    return min(conditions.skew_s, conditions.frame_s)


@inlined
def exposure_time(conditions: TrialConditions, exposure: int) -> float:
    """Time of an exposure since the trial's start, s."""
    if conditions.skew_s == 0.0:
        return frame_exposure_time(conditions, exposure)
    return frame_exposure_time(conditions, exposure >> 1) + (exposure & 1) * eye_skew_s(conditions)


@inlined
def _words(key: StreamKey, frame: int, lane: int) -> Words:
    """Four random words of a frame; lane 1 is used for the detection noise."""
    if frame >= 0:
        return random_words(key.seed, key.trial, _SENSOR, frame, lane)
    return random_words(key.seed, key.trial, _SENSOR_BEFORE_START, -frame, lane)


@inlined
def draw_frame_faults(conditions: TrialConditions, key: StreamKey, frame: int) -> FrameFaults:
    """Draw the faults of a frame."""
    drop, jitter = conditions.dropped_frame_probability, conditions.jitter_s
    miss = conditions.missed_detection_probability
    if drop + jitter + miss == 0.0:
        return FrameFaults(False, 0.0, False, False)
    words = _words(key, frame, 2)
    return FrameFaults(
        to_uniform(words[0]) < drop, jitter * to_uniform(words[1]), to_uniform(words[2]) < miss,
        to_uniform(words[3]) < miss,
    )  # fmt: skip


@inlined
def pixel_noise(
    conditions: TrialConditions, key: StreamKey, frame: int
) -> tuple[float, float, float, float]:
    """Detection noise in one pair of frames, px: u and v left, u and v right."""
    if conditions.detection_noise_px == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return four_normals(_words(key, frame, 1), conditions.detection_noise_px)


@inlined
def _random_offset(most_px: float, size: np.uint64, direction: np.uint64) -> tuple[float, float]:
    """Random offset, uniform in length and direction, px."""
    length, around = most_px * to_uniform(size), 2.0 * pi * to_uniform(direction)
    return length * cos(around), length * sin(around)


@inlined
def outlier_offset(
    conditions: TrialConditions, key: StreamKey, frame: int, eye: int
) -> tuple[float, float]:
    """Offset of an eye's detection from the target if it is an outlier, px; mostly zero."""
    probability = conditions.outlier_probability
    if probability == 0.0 or not to_uniform(_words(key, frame, 3)[eye]) < probability:
        return 0.0, 0.0
    words = _words(key, frame, 4 + eye)
    return _random_offset(conditions.outlier_px, words[0], words[1])


@subroutine
def false_detection_offset(
    conditions: TrialConditions, key: StreamKey, frame: int, eye: int
) -> tuple[float, float]:
    """Offset of an eye's false detection from the target, px; mostly zero.

    A false detection that begins replaces one that is already under way.
    """
    probability = conditions.false_detection_probability
    frames = conditions.false_detection_s / conditions.frame_s
    for age in range(max(int(np.rint(frames)), 1)):
        words = _words(key, frame - age, 6)
        if not to_uniform(words[0]) < probability:
            continue
        if age >= max(int(np.rint(frames * to_uniform(words[1]))), 1):
            continue
        # 0, 1: left eye; 2, 3: right eye; 4: both; 5: both with the same offset
        kind = int(6.0 * to_uniform(words[2]))
        if (kind < 2 and eye == 1) or (2 <= kind < 4 and eye == 0):
            continue
        words = _words(key, frame - age, 7)
        if eye == 0 or kind == 5:
            return _random_offset(conditions.false_detection_px, words[0], words[1])
        return _random_offset(conditions.false_detection_px, words[2], words[3])
    return 0.0, 0.0


@inlined
def frame_arrival_time(
    conditions: TrialConditions, exposed_s: float, extra_latency_s: float, latest_s: float
) -> float:
    """Time at which a frame becomes readable, never before an earlier frame, s."""
    late_s = exposed_s + eye_skew_s(conditions) + conditions.latency_s + extra_latency_s
    return max(late_s, latest_s)


class TrueHeadsAndTargets(NamedTuple):
    """The true heads and their targets at present."""

    heads: FloatArray  # (n or 1, PACKED) the true heads, see `vergence.models.kinematics`
    motions: FloatArray  # (n, MOTION) motions of the targets, see `vergence.envs.targets.motion`
    necks: FloatArray  # (n, 3) the neck's angles at the trials' start, rad
    step: IntArray  # (n,) control periods since the trials' start
    positions: FloatArray  # (n, 7) joint angles, rad
    velocities: FloatArray  # (n, 7) joint velocities, rad/s


@inlined
def true_head_row(scene: TrueHeadsAndTargets, n: EnvIndex) -> PackedHead:
    """(PACKED,) true head of an environment."""
    head: PackedHead = scene.heads[np.uintp(n) * np.uintp(scene.heads.shape[0] > 1)]
    return head


@inlined
def target_position_in_n(
    p: PackedHead, motion: FloatArray, neck_at_start: FloatArray, neck: FloatArray | Vector,
    target_time_s: float,
) -> Vector:  # fmt: skip
    """Position of the target at its own time, in frame N as the neck holds it now, m."""
    x, y, z = motion_position_at(motion, target_time_s)
    if neck[0] == neck_at_start[0] and neck[1] == neck_at_start[1] and neck[2] == neck_at_start[2]:
        return x, y, z
    start = neck_frame(p, neck_at_start[0], neck_at_start[1], neck_at_start[2])
    x, y, z = point_to_outer(start, x, y, z)
    return point_to_local(neck_frame(p, neck[0], neck[1], neck[2]), x, y, z)


@inlined
def distorted_eye_pixel(
    p: PackedHead, eye: int, q: FloatArray, point: Vector
) -> tuple[float, float]:
    """Pixel of a point of N in an eye's image, distorted, px."""
    x, y, z = point_in_eye(p, eye, q[3 + 2 * eye], q[4 + 2 * eye], point[0], point[1], point[2])
    return point_to_pixel(p, eye, x, y, z, True)


@inlined
def image_displacement(
    p: PackedHead, motion: FloatArray, neck_at_start: FloatArray, eye: int, q: FloatArray,
    v: FloatArray, target_time_s: float, half_exposure_s: float,
) -> tuple[float, float]:  # fmt: skip
    """Displacement of the target's image while the shutter is open, px.

    A jump is not motion: a frame shows the target where it is in the middle of the exposure. So the
    first frame at or after a jump shows the target after the jump, without blur.
    """
    tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
    dt, dp = v[3 + 2 * eye] * half_exposure_s, v[4 + 2 * eye] * half_exposure_s
    yaw, roll, pitch = v[0] * half_exposure_s, v[1] * half_exposure_s, v[2] * half_exposure_s
    begin, end = target_time_s - half_exposure_s, target_time_s + half_exposure_s
    own = view_motion(motion)
    for jump in (own.jump_time, own.second_jump_time):
        if target_time_s >= jump:
            begin = max(begin, jump)
        elif end >= jump:
            end = min(end, target_time_s)
    ax, ay, az = target_position_in_n(
        p, motion, neck_at_start, (q[0] - yaw, q[1] - roll, q[2] - pitch), begin
    )
    bx, by, bz = target_position_in_n(
        p, motion, neck_at_start, (q[0] + yaw, q[1] + roll, q[2] + pitch), end
    )
    x, y, z = point_in_eye(p, eye, tilt - dt, pan - dp, ax, ay, az)
    ua, va = point_to_pixel(p, eye, x, y, z, True)
    x, y, z = point_in_eye(p, eye, tilt + dt, pan + dp, bx, by, bz)
    ub, vb = point_to_pixel(p, eye, x, y, z, True)
    return ub - ua, vb - va


@compiled
def update_truth(
    nominal: PackedHead, period_s: float, target_time_s: FloatArray, scene: TrueHeadsAndTargets,
    truth: Truth,
) -> None:  # fmt: skip
    """Update the ground truth, with the targets at their own times (n,)."""
    for n in range(scene.step.shape[0]):
        truth.time_s[n] = scene.step[n] * period_s
        p, q = true_head_row(scene, n), scene.positions[n]
        for j in range(7):
            truth.positions[n, j], truth.velocities[n, j] = q[j], scene.velocities[n, j]
        point = target_position_in_n(p, scene.motions[n], scene.necks[n], q, target_time_s[n])
        truth.target[n, 0], truth.target[n, 1], truth.target[n, 2] = point
        for eye in range(2):
            u, v = distorted_eye_pixel(p, eye, q, point)
            truth.image_visible[n, eye] = inside_image(p, eye, u, v)
            truth.pixels[n, eye, 0], truth.pixels[n, eye, 1] = u, v
            du, dv = pixel_error(nominal, eye, u, v)
            truth.pixel_error[n, eye, 0], truth.pixel_error[n, eye, 1] = du, dv


# widths of a board's cells, px, at which the detector finds the board (measured): reliably, for
# boards of width `fit`, and at least; OpenCV's search for the squares needs larger cells
_RELIABLE_CELL_PX: Final[dict[type[PlanarTarget], float]] = {AprilTag: 6.0, Checkerboard: 11.0}
_MIN_CELL_PX: Final[dict[type[PlanarTarget], float]] = {AprilTag: 2.5, Checkerboard: 10.0}
_BOARD_BORDER_PX: Final = 3.0
"""Clear border that the detector needs around a board, px (chosen: detection against room for
targets)."""
_POINT_HALF_M: Final = 0.01
"""Half the side of the part of a poster that both eyes must see, m (chosen: a patch round its
middle)."""
_WALL_M: Final = 2.5
"""Distance of the walls for their motion blur, m (chosen)."""


class BoardImageRenderer:
    """Renderer of both eyes' images of a board, seen by a true head.

    The ratio `width_rad` of the board's width, rim included, to its distance makes it look equally
    large near and far: `fit` is a ratio that the detector finds reliably with the model's cameras,
    None the board's own size at any distance. The model, by default the head itself, also sets the
    images' grey levels.
    """

    def __init__(
        self, head: HeadModel, target: PlanarTarget, *,
        width_rad: float | Literal["fit"] | None = None,
        facing: Literal["head", "forward"] = "head", model: HeadModel | None = None,
    ) -> None:  # fmt: skip
        if facing not in ("head", "forward"):
            raise ConfigurationError(f"facing: expected 'head' or 'forward', got {facing!r}")
        self._head = head
        self._target = target
        self._facing: Literal["head", "forward"] = facing
        model = head if model is None else model
        self._natural_m = _natural_m(model, target, width_rad)
        self._left, self._right = (
            TargetRenderer(Camera.of(head, eye), target, model.rendering) for eye in range(2)
        )

    @property
    def frames(self) -> tuple[Image, Image]:
        """Left and right image, (height, width) grey levels; the next drawing overwrites them."""
        return self._left.frame, self._right.frame

    @property
    def board_in_image(self) -> tuple[bool, bool]:
        """True for each image that shows any of the board; else it is plain background."""
        return self._left.region is not None, self._right.region is not None

    @property
    def board(self) -> Board:
        """Shape of the target; the eyes must see all of it."""
        corners = outline_m(self._target)
        # between the corners a lens may bend an edge outwards
        halves = 0.5 * (corners + np.roll(corners, -1, axis=0))
        cells_px = min(self._target.cells.shape) * _MIN_CELL_PX[type(self._target)]
        return Board(
            outline=np.stack([corners, halves], axis=1).reshape(-1, 2),
            true_size_distance_m=np.nan if self._natural_m is None else self._natural_m,
            facing_head=self._facing == "head", border_px=_BOARD_BORDER_PX,
            min_outline_segment_px=0.5 * cells_px,
        )  # fmt: skip

    def room(self, q: FloatArray, v: FloatArray) -> None:
        """Take the joint angles, rad, and velocities, rad/s, of the next `draw_poses`."""

    def draw(
        self, q: FloatArray, v: FloatArray, point: ArrayLike,
        rng: np.random.Generator | None = None, point_velocity: ArrayLike = (0.0, 0.0, 0.0),
        axes: ArrayLike | None = None,
    ) -> tuple[Image, Image]:  # fmt: skip
        """Draw both eyes' images of a point (3,) in the present N, m, in the middle of an exposure.

        Its velocity is in the world, in the axes of the present N, m/s; `axes` (3, 3) are the
        board's, as columns, None for those of `facing`. Without `rng` there is no noise, and
        without a point (nan) no board.
        """
        point = np.asarray(point, dtype=np.float64)
        self.room(q, v)
        if np.isnan(point).any():
            nothing = np.tile(np.eye(4), (2, 1, 1))
            nothing[:, 2, 3] = -1.0  # behind the cameras
            return self.draw_poses(nothing, rng)
        T_N_C = self._head.camera_poses(q)
        T_N_T = board_pose(point, self._facing)
        if axes is not None:
            T_N_T[:3, :3] = axes
        T_C_T = np.linalg.inv(T_N_C) @ T_N_T
        return self.draw_poses(T_C_T, rng, self._smear_px(q, v, point, point_velocity))

    def _smear_px(
        self, q: FloatArray, v: FloatArray, point: FloatArray, point_velocity: ArrayLike = 0.0
    ) -> FloatArray:
        """(2, 2) displacement of the point's images from an exposure's beginning to its end, px."""
        half_exposure_s = 0.5 * self._head.timing.exposure_s
        if half_exposure_s == 0.0:
            return np.zeros((2, 2))
        ends_s = half_exposure_s * np.array([[-1.0], [1.0]])
        angles, points = q + ends_s * v, point + ends_s * np.asarray(point_velocity)
        # the point belongs to the world, while N moves with the neck
        T_N_now = np.linalg.inv(self._head.base_pose(angles)) @ self._head.base_pose(q)
        points = np.einsum("eij,ej->ei", T_N_now[:, :3, :3], points) + T_N_now[:, :3, 3]
        begin, end = self._head.project(angles, points)
        return np.asarray(np.nan_to_num(end - begin))

    def draw_poses(
        self, T_C_T: FloatArray, rng: np.random.Generator | None = None,
        smear_px: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
    ) -> tuple[Image, Image]:  # fmt: skip
        """Draw the board at poses (2, 4, 4) in the cameras; one behind a camera is not drawn."""
        if self._natural_m is not None:
            # a board scaled by s looks like the original one at 1/s of the distance
            away = np.linalg.norm(T_C_T[:, :3, 3], axis=-1).mean()
            T_C_T = T_C_T.copy()
            T_C_T[:, :3, 3] *= self._natural_m / away
        smears = np.asarray(smear_px, dtype=np.float64)
        for eye, drawing in enumerate((self._left, self._right)):
            drawing.draw(T_C_T[eye], rng, smears[eye])
        return self.frames


class RoomImageRenderer(BoardImageRenderer):
    """Renderer of both eyes' colour images of an object in a room.

    The room stands upright around the head: its frame is N with the neck at rest.
    """

    def __init__(self, head: HeadModel, scene: Scene, model: HeadModel | None = None) -> None:
        self._head, self._scene, self._facing = head, scene, "head"
        model = head if model is None else model
        self._eyes = [
            RoomRenderer(Camera.of(head, eye), scene, model.rendering) for eye in range(2)
        ]
        self._T_room_0 = np.linalg.inv(head.base_pose(head.rest()))
        self._T_room_C, self._room_smears_px = np.tile(np.eye(4), (2, 1, 1)), np.zeros((2, 2))

    @property
    def frames(self) -> tuple[Image, Image]:
        """(height, width, 3) blue, green and red; the next drawing overwrites them."""
        return self._eyes[0].frame, self._eyes[1].frame

    @property
    def board_in_image(self) -> tuple[bool, bool]:
        """True: a room is never plain."""
        return True, True

    @property
    def board(self) -> Board:
        """Shape of the target: all of a ball, or some of a poster around its measured point."""
        half_m = _POINT_HALF_M if self._scene.thing == "poster" else 0.5 * self._scene.size_m
        outline = half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return POINT._replace(outline=outline, border_px=_BOARD_BORDER_PX)

    def room(self, q: FloatArray, v: FloatArray) -> None:
        """See `BoardImageRenderer.room`."""
        poses = self._head.camera_poses(q)
        self._T_room_C = self._T_room_0 @ self._head.base_pose(q) @ poses
        for eye, pose in enumerate(poses):  # a point of the wall that the eye looks at
            wall = pose[:3, 3] + _WALL_M * pose[:3, 2]
            self._room_smears_px[eye] = self._smear_px(q, v, wall)[eye]

    def surface(self, q: FloatArray, eye: int, pixel: ArrayLike) -> FloatArray:
        """(3,) point of a wall, in the present N, m, that an eye sees at a pixel (u, v)."""
        T_room_N = self._T_room_0 @ self._head.base_pose(q)
        T_room_C = (T_room_N @ self._head.camera_poses(q))[eye]
        ray = line_of_sight(Camera.of(self._head, eye), T_room_C, np.asarray(pixel, float))
        point = hit(self._scene, T_room_C[:3, 3], ray)
        return np.asarray(T_room_N[:3, :3].T @ (point - T_room_N[:3, 3]))

    def draw_poses(
        self, T_C_T: FloatArray, rng: np.random.Generator | None = None,
        smear_px: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
    ) -> tuple[Image, Image]:  # fmt: skip
        """Draw the room, and the object at its poses; one behind a camera is not drawn."""
        smears = np.asarray(smear_px, dtype=np.float64)
        for eye, drawing in enumerate(self._eyes):
            T_room_T = self._T_room_C[eye] @ T_C_T[eye]
            T_room_T[:3, 3] -= T_room_T[:3, :2] @ self._scene.measured_m
            if T_C_T[eye, 2, 3] <= 0.0:
                T_room_T = np.full((4, 4), np.nan)
            drawing.draw(self._T_room_C[eye], T_room_T, rng, self._room_smears_px[eye], smears[eye])
        return self.frames


def _natural_m(
    head: HeadModel, target: PlanarTarget, width_rad: float | Literal["fit"] | None
) -> float | None:
    """Distance at which a board of this width has its own size, m; None if it always has it."""
    if width_rad is None:
        return None
    if width_rad == "fit":
        cells: int = target.cells.shape[1]
        width = cells * _RELIABLE_CELL_PX[type(target)] / float(np.mean(head.cameras.focal))
    else:
        width = check_finite_number("width_rad", width_rad)
        if not 0.0 < width < 1.0:
            raise ConfigurationError(f"width_rad: expected 0 to 1, got {width_rad!r}")
    return float(np.ptp(outline_m(target)[:, 0])) / width
