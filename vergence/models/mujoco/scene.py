"""Surroundings of the head in the MuJoCo model: floor, lights, target boards, a fixed pair.

All positions are in the upright frame of `vergence.models.mujoco.posture`, which is frame 0 for the
article's head.
"""

from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.boards import PlanarTarget, make_planar_target, texture
from vergence.models.head import HeadModel
from vergence.models.mujoco.bodies import pos_and_quat
from vergence.models.mujoco.library import mujoco
from vergence.models.mujoco.posture import rest_poses
from vergence.models.mujoco.shapes import (
    COLOURS,
    DARK,
    LENS,
    METAL,
    VISUAL_ONLY,
    add_segment,
    add_shape,
)
from vergence.models.parts import FloatArray

_GEOM: Final = mujoco.mjtGeom

MAST_Y_M: Final = 0.075
"""y of the fixed pair's mast, behind the skull, in the upright frame, m (chosen: clear of the
skull)."""
_TEXELS_PER_CELL: Final = 32
"""Texture pixels along a cell of a board (chosen: sharp edges under OpenGL's interpolation against
memory)."""
_FACING_HEAD_QUAT: Final = (0.0, 0.0, 0.5**0.5, -(0.5**0.5))
"""Quaternion (w, x, y, z) of an upright board in front of the head at rest: x_T = -x_0, y_T = -z_0,
z_T = -y_0 (numerical)."""


class ObserverCameras(NamedTuple):
    """A stereo camera that does not move, like the article's ZED Mini (Table 6)."""

    width: int = 1280
    height: int = 720
    focal_px: float = 676.21
    principal_px: tuple[float, float] = (645.09, 368.27)
    baseline_m: float = 0.063
    position_m: tuple[float, float, float] = (-0.0122, -0.078, 0.14)
    """Midpoint between both optical centres in the upright frame, above the eyes at rest."""


OBSERVER_CAMERAS: Final = ObserverCameras()


class Surroundings(NamedTuple):
    """Upright frame, floor, stand and size of a head's surroundings."""

    upright_frame: FloatArray
    """(4, 4) pose of the upright frame in frame 0."""
    floor_m: float = -0.26
    """Height of the floor in the upright frame, m."""
    stand_foot_m: tuple[float, float] = (0.0, 0.0)
    """Position of the stand on the floor, x and y in the upright frame, m."""
    extent_m: float = 0.6
    """Extent of the scene for the viewer (MuJoCo's `stat.extent`), m."""

    @property
    def gravity(self) -> FloatArray:
        """(3,) acceleration of gravity in frame 0, m/s^2."""
        return 0.0 - 9.81 * self.upright_frame[:3, 2]

    def to_frame_0(self, point: ArrayLike) -> FloatArray:
        """Transform a point (3,) from the upright frame to frame 0."""
        return np.asarray(
            self.upright_frame[:3, :3] @ np.asarray(point) + self.upright_frame[:3, 3]
        )

    def pos_and_quat(
        self, point: ArrayLike, quat: ArrayLike = (1.0, 0.0, 0.0, 0.0)
    ) -> dict[str, Any]:
        """Convert a position and a quaternion in the upright frame to MuJoCo's attributes."""
        if np.array_equal(self.upright_frame, np.eye(4)):
            return {"pos": point, "quat": quat}
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, np.asarray(quat, np.float64))
        pose = np.eye(4)
        pose[:3, :3] = self.upright_frame[:3, :3] @ rotation.reshape(3, 3)
        pose[:3, 3] = self.to_frame_0(point)
        return pos_and_quat(pose)


def surroundings_of(head: HeadModel) -> Surroundings:
    """Place the floor, the stand and the view around a head at rest, and size them by it.

    The article's head keeps the article's values.
    """
    posture = rest_poses(head)
    if posture.is_article_head:
        return Surroundings(posture.upright_frame)
    x, y, _z = (posture.stand_top - posture.upright_frame[:3, 3]) @ posture.upright_frame[:3, :3]
    return Surroundings(
        posture.upright_frame,
        stand_foot_m=(float(x), float(y)),
        floor_m=posture.lowest_m - 0.26,
        extent_m=0.6 * max(1.0, posture.baseline_m / 0.3),
    )


def add_target(
    spec: mujoco.MjSpec, name: str, board: PlanarTarget | None = None, *, surroundings: Surroundings
) -> None:
    """Add the mocap body of a target, whose frame is T, one metre ahead of the head.

    Args:
        spec: the specification to extend.
        name: name of the body.
        board: the board on the target; None for the board of that name with its default size.
        surroundings: the surroundings of the head.

    Raises:
        UnknownNameError: there is no board of that name.
    """
    board = make_planar_target(name) if board is None else board
    rows, columns = board.cells.shape
    size = board.cell_m * np.array([columns, rows])
    centre = size / 2.0 - board.cell_m * np.array(board.origin_cells)
    file = f"assets/{name}.png"
    spec.assets = {**spec.assets, file: _png(texture(board, _TEXELS_PER_CELL))}
    # textures are upside down on the face of a box that looks along -z
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file, vflip=True)
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, emission=0.4)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    place = surroundings.pos_and_quat([-0.011, -1.064, 0.1], _FACING_HEAD_QUAT)
    body = spec.worldbody.add_body(name=name, mocap=True, **place)
    body.add_geom(
        name=name,
        type=_GEOM.mjGEOM_BOX,
        pos=[*centre, 0.001],
        size=[*size / 2.0, 0.001],
        material=name,
        **VISUAL_ONLY,
    )


def _png(image: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".png", image)[1])


def add_observer_cameras(
    spec: mujoco.MjSpec, surroundings: Surroundings, cameras: ObserverCameras = OBSERVER_CAMERAS
) -> None:
    """Add the body `fixed_pair`: x right, y down, z forward, origin midway between its cameras."""
    place = surroundings.pos_and_quat(cameras.position_m, _FACING_HEAD_QUAT)
    body = spec.worldbody.add_body(name="fixed_pair", **place)
    size = np.array([cameras.width, cameras.height])
    buffer = spec.visual.global_
    buffer.offwidth = max(buffer.offwidth, cameras.width)
    buffer.offheight = max(buffer.offheight, cameras.height)
    box = {"size": [0.062, 0.0133, 0.012], "pos": [0.0, 0.0, -0.013]}
    add_shape(body, _GEOM.mjGEOM_BOX, COLOURS[DARK], **box)
    x, y, z = cameras.position_m
    elbow = surroundings.to_frame_0([x, MAST_Y_M, z])
    for end in ([x, MAST_Y_M, surroundings.floor_m + 0.01], [x, y + 0.02, z]):
        metal, capsule = COLOURS[METAL], _GEOM.mjGEOM_CAPSULE
        add_segment(spec.worldbody, metal, elbow, surroundings.to_frame_0(end), 0.006, capsule)
    for side, name in ((-1, "fixed_left"), (1, "fixed_right")):
        centre = [side * cameras.baseline_m / 2.0, 0.0, 0.0]
        # MuJoCo's cameras look along -z with y up, and count the principal point from the
        # image's centre towards the left and up, in edges instead of centres of pixels
        body.add_camera(
            name=name,
            pos=centre,
            quat=[0.0, 1.0, 0.0, 0.0],
            resolution=size,
            sensor_size=2e-6 * size,
            focal_pixel=[cameras.focal_px, cameras.focal_px],
            principal_pixel=size / 2.0 - (np.array(cameras.principal_px) + 0.5),
        )
        add_segment(body, COLOURS[LENS], [centre[0], 0.0, -0.002], centre, 0.007)


def add_scenery(spec: mujoco.MjSpec, surroundings: Surroundings) -> None:
    """Add a floor, lights and a dim sky."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.35, 0.40, 0.46],
        rgb2=[0.10, 0.11, 0.13],
        width=256,
        height=256,
    )
    spec.add_material(name="floor", rgba=[0.30, 0.31, 0.33, 1.0], specular=0.1, shininess=0.1)
    spec.worldbody.add_geom(
        name="floor",
        type=_GEOM.mjGEOM_PLANE,
        size=[0.0, 0.0, 0.5],
        material="floor",
        **surroundings.pos_and_quat([0.0, 0.0, surroundings.floor_m]),
        **VISUAL_ONLY,
    )
    bottom = surroundings.to_frame_0([*surroundings.stand_foot_m, surroundings.floor_m])
    top = surroundings.to_frame_0([*surroundings.stand_foot_m, surroundings.floor_m + 0.012])
    add_segment(spec.worldbody, COLOURS[DARK], bottom, top, 0.09)
    # offscreen multisampling and shadow maps take most of a frame's time on a CPU
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 0
    spec.visual.rgba.haze = [0.16, 0.17, 0.19, 1.0]
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.25, 0.25, 0.25]
    spec.visual.headlight.specular = [0.0, 0.0, 0.0]
    spec.worldbody.add_light(
        name="key",
        pos=surroundings.to_frame_0([0.6, -0.8, 1.2]),
        dir=surroundings.upright_frame[:3, :3] @ [-0.4, 0.5, -0.8],
        diffuse=[0.6, 0.6, 0.6],
    )
    spec.visual.map.znear = 0.005
    spec.stat.center = surroundings.to_frame_0([0.0, -0.05, 0.0])
    spec.stat.extent = surroundings.extent_m
