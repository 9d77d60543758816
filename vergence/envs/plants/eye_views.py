"""Rendered images of a board in both eyes of a head."""

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.envs.reading import Image
from vergence.envs.targets.board import POINT, Board
from vergence.envs.validation import check_finite_number
from vergence.errors import ConfigurationError
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.vision.drawing import TargetRenderer
from vergence.vision.objects.room import RoomRenderer
from vergence.vision.objects.scenes import Scene, hit
from vergence.vision.objects.sights import line_of_sight
from vergence.vision.targets import AprilTag, Checkerboard, PlanarTarget, board_pose, outline_m


class DetectableCellWidths(NamedTuple):
    """Widths of a board's cells, px, at which the detector finds the board."""

    reliable_px: float
    """Width for boards of width `fit`: reliably found, yet small."""
    min_px: float
    """Least width; below it the detector misses a still board in some images."""
    max_px: float


CELL_SIZES: Final[dict[type[PlanarTarget], DetectableCellWidths]] = {
    AprilTag: DetectableCellWidths(6.0, 2.5, np.inf),
    # OpenCV's search for the squares needs larger cells
    Checkerboard: DetectableCellWidths(11.0, 10.0, np.inf),
}
BOARD_BORDER_PX: Final = 3.0
"""Clear border that the detector needs around a board, px (chosen: detection against room for
targets)."""


_POINT_HALF_M: Final = 0.01
"""Half the side of the part of a poster that both eyes must see, m (chosen: a patch round its
middle)."""
_WALL_M: Final = 2.5
"""Distance of the walls for their motion blur, m (chosen)."""


class BoardImageRenderer:
    """Renderer of both eyes' images of a board.

    Args:
        head: the true head, a single one.
        target: the board.
        width_rad: ratio of the board's width, rim included, to its distance, so that it looks
            equally large near and far. `fit`: a width that the detector finds reliably with the
            model's cameras; None: the board's own size at any distance.
        facing: orientation of the board, see `board_pose`.
        model: the head that a controller knows, which sets the images' grey levels; None for
            `head`.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self,
        head: HeadModel,
        target: PlanarTarget,
        *,
        width_rad: float | Literal["fit"] | None = None,
        facing: Literal["head", "forward"] = "head",
        model: HeadModel | None = None,
    ) -> None:
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
        size = CELL_SIZES[type(self._target)]
        return Board(
            outline=np.stack([corners, halves], axis=1).reshape(-1, 2),
            true_size_distance_m=np.nan if self._natural_m is None else self._natural_m,
            facing_head=self._facing == "head",
            border_px=BOARD_BORDER_PX,
            min_outline_segment_px=0.5 * min(self._target.cells.shape) * size.min_px,
            max_outline_segment_px=0.5 * max(self._target.cells.shape) * size.max_px,
        )

    def room(self, q: FloatArray, v: FloatArray) -> None:
        """Take the joint angles, rad, and velocities, rad/s, of the next `draw_poses`."""

    def draw(
        self,
        q: FloatArray,
        v: FloatArray,
        point: ArrayLike,
        rng: np.random.Generator | None = None,
        point_velocity: ArrayLike = (0.0, 0.0, 0.0),
        axes: ArrayLike | None = None,
    ) -> tuple[Image, Image]:
        """Draw both eyes' images for the middle of an exposure.

        Args:
            q: (7,) joint angles, rad.
            v: (7,) joint velocities, rad/s.
            point: (3,) the board's measured point in the present N, m; nan for no board.
            rng: generator of the noise; None for noise-free images.
            point_velocity: (3,) its velocity in the world, in the axes of the present N, m/s.
            axes: (3, 3) the board's axes in the present N, as columns; None for those of `facing`.

        Returns:
            Left and right image, see `frames`.
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
        self,
        T_C_T: FloatArray,
        rng: np.random.Generator | None = None,
        smear_px: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
    ) -> tuple[Image, Image]:
        """Draw the board at given poses; a board behind a camera leaves plain background.

        Args:
            T_C_T: (2, 4, 4) the board's poses in the cameras, with its measured point at its true
                position.
            rng: generator of the noise; None for noise-free images.
            smear_px: (2, 2) displacement of the board's images during the exposure, px.

        Returns:
            Left and right image, see `frames`.
        """
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

    Args:
        head: the true head, a single one.
        scene: the room, and the object at the target's place.
        model: the head that a controller knows, which sets the images' grey levels; None for
            `head`.
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
        return POINT._replace(outline=outline, border_px=BOARD_BORDER_PX)

    def room(self, q: FloatArray, v: FloatArray) -> None:
        """See `BoardImageRenderer.room`."""
        poses = self._head.camera_poses(q)
        self._T_room_C = self._T_room_0 @ self._head.base_pose(q) @ poses
        for eye, pose in enumerate(poses):  # a point of the wall that the eye looks at
            wall = pose[:3, 3] + _WALL_M * pose[:3, 2]
            self._room_smears_px[eye] = self._smear_px(q, v, wall)[eye]

    def surface(self, q: FloatArray, eye: int, pixel: ArrayLike) -> FloatArray:
        """(3,) point of a wall, in the present N, m, that an eye sees at a pixel (u, v).

        Args:
            q: (7,) joint angles, rad.
            eye: 0 for left, 1 for right.
            pixel: (2,) raw pixel.
        """
        T_room_N = self._T_room_0 @ self._head.base_pose(q)
        T_room_C = (T_room_N @ self._head.camera_poses(q))[eye]
        ray = line_of_sight(Camera.of(self._head, eye), T_room_C, np.asarray(pixel, float))
        point = hit(self._scene, T_room_C[:3, 3], ray)
        return np.asarray(T_room_N[:3, :3].T @ (point - T_room_N[:3, 3]))

    def draw_poses(
        self,
        T_C_T: FloatArray,
        rng: np.random.Generator | None = None,
        smear_px: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
    ) -> tuple[Image, Image]:
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
        width = cells * CELL_SIZES[type(target)].reliable_px / float(np.mean(head.cameras.focal))
    else:
        width = check_finite_number("width_rad", width_rad)
        if not 0.0 < width < 1.0:
            raise ConfigurationError(f"width_rad: expected 0 to 1, got {width_rad!r}")
    return float(np.ptp(outline_m(target)[:, 0])) / width
