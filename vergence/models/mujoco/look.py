"""What the MuJoCo model shows: shapes of the head, and its surroundings."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.mujoco.bodies import Bodies, pos_and_quat
from vergence.models.parts import NECK, FloatArray
from vergence.models.posture import EYE_RADIUS_M, RestPoses, n_and_camera_bodies, rest_poses

SHELL: Final = "shell"
METAL: Final = "metal"
DARK: Final = "dark"
LENS: Final = "lens"
COLOURS: Final = {
    SHELL: (0.80, 0.82, 0.85, 1.0),
    METAL: (0.45, 0.47, 0.50, 1.0),
    DARK: (0.13, 0.14, 0.16, 1.0),
    LENS: (0.05, 0.12, 0.28, 1.0),
}
_SHININESS: Final = {SHELL: 0.4, METAL: 0.7, DARK: 0.3, LENS: 0.9}

VISUAL_ONLY: Final = {"contype": 0, "conaffinity": 0, "mass": 0.0}


def add_materials(spec: mujoco.MjSpec) -> None:
    """Add the materials of the head's shapes."""
    for name, rgba in COLOURS.items():
        spec.add_material(name=name, rgba=rgba, shininess=_SHININESS[name], specular=0.4)


def add_segment(
    body: Any,
    material_or_colour: str | Sequence[float],
    start: Any,
    end: Any,
    radius: float,
    kind: mujoco.mjtGeom = mujoco.mjtGeom.mjGEOM_CYLINDER,
) -> None:
    """Add a cylinder or a capsule between two points, see `add_shape`."""
    ends = np.concatenate([start, end])
    add_shape(body, kind, material_or_colour, size=[radius, 0.0, 0.0], fromto=ends)


def add_shape(
    body: Any, kind: mujoco.mjtGeom, material_or_colour: str | Sequence[float], **where: Any
) -> None:
    """Add a shape with a material of the head, or with a colour of its own.

    The surroundings use colours, not the head's materials, so both can be in separate files.
    """
    colour = (
        {"material": material_or_colour}
        if isinstance(material_or_colour, str)
        else {"rgba": material_or_colour}
    )
    body.add_geom(type=kind, **colour, **where, **VISUAL_ONLY)


_GEOM: Final = mujoco.mjtGeom
SKULL_CENTRE_M: Final = (-0.055, 0.030, 0.001)
"""Centre of the article's skull, an ellipsoid behind the eyes, in frame 3, m (chosen: looks
only)."""
SKULL_AXES_M: Final = (0.062, 0.082, 0.074)
"""Semi-axes of that ellipsoid in frame 3, m (chosen: looks only)."""
_SKULL_BEHIND_M: Final = (0.0, -0.030, -0.080)
"""Centre of any other head's skull, from the midpoint between the cameras, in N's axes, m (chosen:
looks only)."""
_SKULL_AXES_IN_N_M: Final = (0.074, 0.082, 0.062)
"""Semi-axes of any other head's skull, along N's axes, m (chosen: looks only)."""
_MAX_SKULL_BASELINE_M: Final = 0.16
"""Largest baseline for a skull, m; the eyes of a wider head are on a bar (chosen: looks only)."""
IRIS_RADIUS_M: Final = 0.009
"""Radius of the iris in an eyeball of full size, m (chosen: looks only)."""
_MAX_CENTRED_OFFSET_M: Final = 0.004
"""Distance of a camera from its last joint's origin below which the eyeball is centred on the
joint, m (chosen: looks only)."""
_STAND_BELOW_HEAD_M: Final = 0.25
"""Length of the stand below the lowest joint, m (chosen: looks only)."""
_MIN_MOTOR_DISTANCE_M: Final = 0.05
"""Least distance of the neck's first motor from the midpoint between the cameras for it to be
drawn, m (chosen: a nearer one would hide the eyes)."""


def add_appearance(spec: mujoco.MjSpec, bodies: Bodies, head: HeadModel) -> None:
    """Add the visible shapes of a head with two eyes; they have no mass and no contacts.

    Args:
        spec: the specification to extend.
        bodies: the body of each link; -1 for the world.
        head: the head; its link lengths determine the shapes.
    """
    add_materials(spec)
    posture, links = rest_poses(head), head.links.bodies()
    skull, *ends = n_and_camera_bodies(head)
    _add_stand(bodies[-1], posture)
    for place, link in enumerate(links):
        body, size = bodies[place], posture.scale
        rod = 0.006
        if link.joints[0] < NECK.stop:
            first = link.parent == -1
            rod = 0.007 if place == skull else 0.011 if first else 0.009
            to_eyes = posture.links[place, :3, 3] - posture.cameras[:, :3, 3].mean(axis=0)
            if first and np.linalg.norm(to_eyes) > _MIN_MOTOR_DISTANCE_M * size:
                bottom, top = [0.0, 0.0, -0.03 * size], [0.0, 0.0, 0.018 * size]
                add_segment(body, DARK, bottom, top, 0.03 * size)
            elif not first and place != skull:
                add_segment(body, DARK, [0.0, 0.0, -0.025 * size], [0.0, 0.0, 0.0], 0.022 * size)
        if place == skull and posture.is_article_head:
            add_shape(body, _GEOM.mjGEOM_ELLIPSOID, SHELL, size=SKULL_AXES_M, pos=SKULL_CENTRE_M)
        for other in links:
            if other.parent == place and not (place == skull and _on_bar(posture)):
                _add_rod(body, other.pose[:3, 3], rod * size)
    if not posture.is_article_head:
        _add_face(bodies[skull], skull, posture)
    for eye, place in enumerate(ends):
        _add_eye(bodies[place], head.camera_in_last_link(eye), posture, place != skull)


def _on_bar(posture: RestPoses) -> bool:
    """True if the eyes are on a bar instead of in a skull."""
    return not posture.is_article_head and posture.baseline_m > _MAX_SKULL_BASELINE_M


def _add_stand(world: Any, posture: RestPoses) -> None:
    """Add a stand from the floor to the first joint of the neck, or to the bar of the eyes."""
    top, up = posture.stand_top, posture.upright_frame[:3, 2]
    height = up @ (top - posture.upright_frame[:3, 3]) - (posture.lowest_m - _STAND_BELOW_HEAD_M)
    add_segment(world, METAL, top - height * up, top, 0.022 * posture.scale)


def _add_face(body: Any, skull: int, posture: RestPoses) -> None:
    """Add a skull behind the eyes, or a bar that carries them, to the body that carries N."""
    frame = posture.links[skull] if skull >= 0 else np.eye(4)
    into = inverse_pose(frame)
    middle = posture.cameras[:, :3, 3].mean(axis=0)
    rotation, size = into[:3, :3] @ posture.frame_n[:3, :3], posture.scale
    if skull >= 0 and not _on_bar(posture):
        centre = middle + size * posture.frame_n[:3, :3] @ _SKULL_BEHIND_M
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).ravel())
        add_shape(
            body,
            _GEOM.mjGEOM_ELLIPSOID,
            SHELL,
            size=size * np.array(_SKULL_AXES_IN_N_M),
            pos=into[:3, :3] @ centre + into[:3, 3],
            quat=quat,
        )
        return
    held = [into[:3, :3] @ end + into[:3, 3] for end in posture.bar_ends]
    fronts = [into[:3, :3] @ root + into[:3, 3] for root in posture.eye_roots]
    _add_rod(body, held[1], 0.009 * size, held[0])
    for back, front in zip(held, fronts, strict=True):
        _add_rod(body, front, 0.006 * size, back)
    if skull >= 0:
        _add_rod(body, 0.5 * (held[0] + held[1]), 0.009 * size)


def _add_eye(body: Any, camera: FloatArray, posture: RestPoses, moves: bool) -> None:
    """Add an eyeball around the camera, with an iris in front."""
    radius, forward = posture.eye_radius_m, camera[:3, 2]
    small = radius / EYE_RADIUS_M
    centre = camera[:3, 3]
    if moves and np.linalg.norm(centre) < _MAX_CENTRED_OFFSET_M:
        centre = np.zeros(3)
    elif moves:
        _add_rod(body, centre, 0.006 * posture.scale)
    add_shape(body, _GEOM.mjGEOM_SPHERE, SHELL, size=[radius, 0.0, 0.0], pos=centre)
    # they start behind the optical centre: OpenGL does not draw faces seen from behind
    start, front = -0.005 * small * forward, (radius + 0.001 * small) * forward
    iris = IRIS_RADIUS_M * small
    ends = [start, front, 1.05 * front]
    if centre.any():
        ends = [centre + end for end in ends]
    add_segment(body, DARK, ends[0], ends[1], iris)
    add_segment(body, LENS, ends[0], ends[2], 0.6 * iris)


def _add_rod(body: Any, end: FloatArray, radius: float, start: Any = (0.0, 0.0, 0.0)) -> None:
    """Add a rod between two points that are more than 1 mm apart."""
    if np.linalg.norm(end - np.asarray(start)) > 1e-3:
        add_segment(body, METAL, start, end, radius, _GEOM.mjGEOM_CAPSULE)


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


class Board(Protocol):
    """Pattern on a target: a planar target of `vergence.vision`."""

    @property
    def cells(self) -> NDArray[np.uint8]:
        """(rows, columns) grey levels."""

    @property
    def cell_m(self) -> float:
        """Edge of one cell, m."""

    @property
    def origin_cells(self) -> tuple[float, float]:
        """The origin of T, in cells from the upper left corner, (x, y)."""


def add_target(spec: mujoco.MjSpec, name: str, board: Board, surroundings: Surroundings) -> None:
    """Add the mocap body of a target, whose frame is T, one metre ahead of the head."""
    rows, columns = board.cells.shape
    size = board.cell_m * np.array([columns, rows])
    centre = size / 2.0 - board.cell_m * np.array(board.origin_cells)
    file = f"assets/{name}.png"
    texels = board.cells.repeat(_TEXELS_PER_CELL, axis=0).repeat(_TEXELS_PER_CELL, axis=1)
    spec.assets = {**spec.assets, file: bytes(cv2.imencode(".png", texels)[1])}
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
