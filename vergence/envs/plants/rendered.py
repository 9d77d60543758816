"""The rendered plant: MuJoCo's dynamics, drawn images, and a real detector that looks at them."""

from collections.abc import Mapping
from typing import Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence._jit import compiled
from vergence.envs.fields import number
from vergence.envs.plant import TrialStart
from vergence.envs.plants.conditions import Drawn, loop_of
from vergence.envs.plants.frames import SAME_S, Exposures, Frames, comes_at, faults_of, outlier
from vergence.envs.plants.mujoco import MujocoPlant
from vergence.envs.plants.scene import Scene, head_of, image_motion, target_in_n
from vergence.envs.plants.variation import RANGES
from vergence.envs.reading import BoolArray, Image, Reading
from vergence.envs.saved_state import Arrays
from vergence.envs.streams import IntArray, Key, Keys, Purpose
from vergence.envs.targets.board import Board, board_axes
from vergence.envs.targets.motion import is_shown, motion_of
from vergence.errors import ConfigurationError
from vergence.models.boards import (
    AprilTag,
    Checkerboard,
    PlanarTarget,
    make_planar_target,
    outline_m,
)
from vergence.models.head import HeadModel
from vergence.models.kinematics import eye_frames
from vergence.models.parts import FloatArray
from vergence.models.pose import into, turn_back
from vergence.vision.detectors import make_detector
from vergence.vision.drawing import TargetDrawing
from vergence.vision.optics import EyeCamera
from vergence.vision.tracking import Tracker


class CellSize(NamedTuple):
    """How wide, in px of the image, the cells of a board are that the detector finds."""

    fit: float
    """That of a board that fits: well found, and small."""
    least: float
    """Below it some images of a still board show nothing to the detector."""
    most: float


CELL_SIZES: Final[dict[type[PlanarTarget], CellSize]] = {
    AprilTag: CellSize(6.0, 2.5, np.inf),
    # OpenCV's search for the squares asks for larger cells
    Checkerboard: CellSize(11.0, 10.0, np.inf),
}
BOARD_BORDER_PX: Final = 3.0
"""Room that the detector needs around a board, px."""


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


class _Eye(NamedTuple):
    """One eye: what draws its images, and what follows the target through them."""

    drawing: TargetDrawing
    tracker: Tracker


class RenderedPlant(MujocoPlant):
    """Heads whose eyes see drawn images, in which a detector finds the target.

    Detection noise is the detector's own; the grey levels' noise is the preset's rendering. A
    variation cannot draw it, nor the head, whose lenses are prepared once for all images. Missed
    detections and outliers come on top of the detector's own.

    Args:
        head: the model that a controller knows.
        num: how many heads move side by side.
        board: what the target shows: `tag` (AprilTag 36h11) or `checkerboard`.
        facing: where the board looks, see `board_pose`.
        width_rad: how wide the board is by its distance, rim included: one that looks equally
            large near and far. `fit`: as wide as the detector finds it well with this head's
            cameras; None: its own size at any distance.
        **options: those of `MujocoPlant`.

    Raises:
        ConfigurationError: an option has a value that cannot be.
    """

    workspace_options: ClassVar[Mapping[str, Any]] = {"width_rad": "fit"}
    _varies: ClassVar[frozenset[str]] = frozenset(RANGES) - {"detection_noise_px"}

    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        board: Literal["tag", "checkerboard"] = "tag",
        facing: Literal["head", "forward"] = "head",
        width_rad: float | Literal["fit"] | None = None,
        **options: Any,
    ) -> None:
        if facing not in ("head", "forward"):
            raise ConfigurationError(f"facing: expected 'head' or 'forward', got {facing!r}")
        super().__init__(head, num, **options)
        self._board = make_planar_target(board)
        self._natural_m = _natural_m(self._board, head, width_rad)
        self._facing: Literal["head", "forward"] = facing
        many = bool(self.true_head.batch_shape)
        self._true = [
            self.true_head[i % len(self.conditions.heads)] if many else self.true_head
            for i in range(num)
        ]
        self._eyes = [self._make_eyes(place) for place in range(num)]
        self._T_C_T = np.empty((2, 4, 4))
        self._smear_px = np.empty((2, 2))
        self._found = np.zeros((*self._exposures.time_s.shape, 2, 2))
        self._seen = np.zeros((*self._exposures.time_s.shape, 2), dtype=np.bool_)

    def _make_eyes(self, place: int) -> tuple[_Eye, _Eye]:
        left, right = (
            _Eye(
                TargetDrawing(
                    EyeCamera.of(self._true[place], eye), self._board, self.head.rendering
                ),
                Tracker(make_detector(self._board, EyeCamera.of(self.head, eye))),
            )
            for eye in range(2)
        )
        return left, right

    @property
    def board(self) -> Board:
        """What a target looks like to the eyes, see `Simulation.board`."""
        corners = outline_m(self._board)
        # between the corners a lens may bend an edge outwards
        halves = 0.5 * (corners + np.roll(corners, -1, axis=0))
        size = CELL_SIZES[type(self._board)]
        return Board(
            outline=np.stack([corners, halves], axis=1).reshape(-1, 2),
            natural_m=np.nan if self._natural_m is None else self._natural_m,
            facing_head=self._facing == "head",
            border_px=BOARD_BORDER_PX,
            least_px=0.5 * min(self._board.cells.shape) * size.least,
            most_px=0.5 * max(self._board.cells.shape) * size.most,
        )

    def frames(self, place: int = 0) -> tuple[Image, Image]:
        """See `Plant.frames`."""
        left, right = self._eyes[place]
        return left.drawing.frame, right.drawing.frame

    def _arrays(self) -> Arrays:
        raise ConfigurationError(
            "state: expected the plant kinematic or mujoco, got rendered, "
            "whose detectors remember what they have seen"
        )

    def begin(self, start: TrialStart) -> Reading:
        """See `SimulatedPlant.begin`."""
        for place in start.ids.tolist():
            for eye in self._eyes[place]:
                eye.tracker.forget()
        return super().begin(start)

    def _expose(self, ids: IntArray) -> None:
        for place in ids.tolist():
            count = int(self._exposures.taken[place])
            first = int(self._frames.next[place])
            for i in range(count):
                self._photograph(place, first + i, i)
        own = self._bare
        take_detections(
            ids, own.drawn, own.keys, own.exposures, own.frames, self._found, self._seen
        )

    def _photograph(self, place: int, frame: int, i: int) -> None:
        """Take both eyes' frames, the i-th of the period, and keep what is found."""
        there = view(
            place,
            i,
            0.5 * self.head.timing.exposure_s,
            self._facing == "head",
            self._bare.scene,
            self._bare.exposures,
            float(self.conditions.onset_s[place]),
            self._T_C_T,
            self._smear_px,
        )
        if self._natural_m is not None:
            # a board s times as large looks as this one does at 1/s of the way
            away = np.linalg.norm(self._T_C_T[:, :3, 3], axis=-1).mean()
            self._T_C_T[:, :3, 3] *= self._natural_m / away
        if not there:
            self._T_C_T[:, 2, 3] = -1.0  # nothing to see behind a camera
        # as the joints tell a controller of the head that it knows
        positions = self._exposures.positions[place, i]
        T_0_C = self.head.base_pose(positions) @ self.head.camera_poses(positions)
        # the frames before time zero have the odd blocks, as many as there are
        rng = self._streams.at(place, Purpose.IMAGE, 2 * frame if frame >= 0 else -2 * frame - 1)
        for eye, (drawing, tracker) in enumerate(self._eyes[place]):
            drawing.draw(self._T_C_T[eye], rng, self._smear_px[eye])
            # without a drawn region the whole frame is plain background: nothing to search
            found = tracker.find(drawing.frame, T_0_C=T_0_C[eye], search=drawing.region is not None)
            self._seen[place, i, eye] = found is not None
            if found is not None:
                self._found[place, i, eye] = found.point_px


def _natural_m(
    board: PlanarTarget, head: HeadModel, width_rad: float | Literal["fit"] | None
) -> float | None:
    """Where a board of this width has its own size, m; None for one that always has it."""
    if width_rad is None:
        return None
    if width_rad == "fit":
        cells: int = board.cells.shape[1]
        width = cells * CELL_SIZES[type(board)].fit / float(np.mean(head.cameras.focal))
    else:
        width = number("width_rad", width_rad)
        if not 0.0 < width < 1.0:
            raise ConfigurationError(f"width_rad: expected 0 to 1, got {width_rad!r}")
    return float(np.ptp(outline_m(board)[:, 0])) / width


@compiled
def take_detections(
    ids: IntArray,
    drawn: Drawn,
    keys: Keys,
    exposures: Exposures,
    frames: Frames,
    found: FloatArray,
    seen: BoolArray,
) -> None:
    """Take what the detectors found in some places' frames into their rings.

    Args:
        ids: (m,) the places.
        drawn: `bare`, as are the following three; what the trials run with.
        keys: those of the trials' random numbers.
        exposures: when the frames were taken.
        frames: the rings, brought up to date.
        found: (n, E, 2, 2) px.
        seen: (n, E, 2) whether anything was found.
    """
    drawn, keys = Drawn(*drawn), Keys(*keys)
    exposures, frames = Exposures(*exposures), Frames(*frames)
    mask = frames.dropped.shape[1] - 1
    for n in ids:
        loop, key = loop_of(drawn, n), Key(keys.seeds[n], keys.trials[n])
        for i in range(exposures.taken[n]):
            f, time_s = frames.next[n], exposures.time_s[n, i]
            frames.next[n] = f + 1
            slot, faults = np.uintp(f & mask), faults_of(loop, key, f)
            frames.exposed_s[n, slot], frames.dropped[n, slot] = time_s, faults.dropped
            if faults.dropped:
                continue
            comes_s = comes_at(loop, time_s, faults.late_s, frames.latest_s[n])
            frames.comes_s[n, slot] = frames.latest_s[n] = comes_s
            for eye in range(2):
                missed = faults.missed_right if eye else faults.missed_left
                visible = seen[n, i, eye] and not missed
                frames.visible[n, slot, eye] = visible
                if visible:
                    du, dv = outlier(loop, key, f, eye)
                    frames.pixels[n, slot, eye, 0] = found[n, i, eye, 0] + du
                    frames.pixels[n, slot, eye, 1] = found[n, i, eye, 1] + dv


@compiled
def view(
    n: int,
    i: int,
    half_s: float,
    facing_head: bool,
    scene: Scene,
    exposures: Exposures,
    onset_s: float,
    T_C_T: FloatArray,
    smear_px: FloatArray,
) -> bool:
    """Where both cameras see the board, see `board_pose`, and how far its image moves.

    Args:
        n: the place whose eyes look.
        i: which exposure of the period.
        half_s: half the time that the shutter is open.
        facing_head: whether the board is square to the line from N's origin.
        scene: `bare`.
        exposures: `bare`.
        onset_s: when the target's own time begins.
        T_C_T: (2, 4, 4) result, the board's poses in the cameras.
        smear_px: (2, 2) result, the way of the target's image while the shutter is open, px.

    Returns:
        Whether there is a target at that time.
    """
    scene, exposures = Scene(*scene), Exposures(*exposures)
    p, time_s = head_of(scene, n), exposures.time_s[n, i]
    q, v = exposures.positions[n, i], exposures.velocities[n, i]
    motion, own_time_s = motion_of(scene.motions[n]), time_s - onset_s + SAME_S
    x, y, z = target_in_n(p, motion, scene.necks[n], q, own_time_s)
    # columns of the board's rotation in N
    axes = board_axes((x, y, z), facing_head)
    for eye in range(2):
        camera = eye_frames(p, eye, q[3 + 2 * eye], q[4 + 2 * eye]).camera
        out = T_C_T[eye]
        for j in range(3):
            axis = axes[j]
            out[0, j], out[1, j], out[2, j] = turn_back(camera, axis[0], axis[1], axis[2])
        out[0, 3], out[1, 3], out[2, 3] = into(camera, x, y, z)
        out[3, 0] = out[3, 1] = out[3, 2] = 0.0
        out[3, 3] = 1.0
        du = dv = 0.0
        if half_s > 0.0:
            du, dv = image_motion(p, motion, scene.necks[n], eye, q, v, own_time_s, half_s)
        smear_px[eye, 0], smear_px[eye, 1] = du if du == du else 0.0, dv if dv == dv else 0.0
    return is_shown(motion, own_time_s)
