"""What the MuJoCo model shows: shapes of the head, and its surroundings."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.models.geometry import chain_end, inverse_pose
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.parts import NECK, FloatArray
from vergence.models.posture import EYE_RADIUS_M, N_UPRIGHT, RestPoses

_Kind: Final = mujoco.mjtGeom
_MATERIALS: Final = {
    "shell": ((0.80, 0.82, 0.85, 1.0), 0.4),
    "metal": ((0.45, 0.47, 0.50, 1.0), 0.7),
    "dark": ((0.13, 0.14, 0.16, 1.0), 0.3),
    "lens": ((0.05, 0.12, 0.28, 1.0), 0.9),
}
"""Colour and shininess of the head's materials (chosen: looks only)."""
_METAL, _DARK, _LENS = (_MATERIALS[name][0] for name in ("metal", "dark", "lens"))
# the surroundings use colours, not the head's materials, so that both can be in separate files
_VISUAL_ONLY: Final = {"contype": 0, "conaffinity": 0, "mass": 0.0}
_SKULL_BEHIND_M: Final = (0.0, -0.030, -0.080)
"""Centre of the skull, an ellipsoid, from the midpoint between the eyes' first joints, in N's axes,
m (chosen: looks only)."""
_SKULL_AXES_M: Final = (0.074, 0.082, 0.062)
"""Semi-axes of the skull along N's axes, m (chosen: looks only)."""
_MAX_SKULL_BASELINE_M: Final = 0.16
"""Largest baseline for a skull, m; the eyes of a wider head are on a bar (chosen: looks only)."""
_MAX_CENTRED_OFFSET_M: Final = 0.004
"""Distance of a camera from its last joint's origin below which the eyeball is centred on the
joint, m (chosen: looks only)."""
_MIN_MOTOR_DISTANCE_M: Final = 0.05
"""Least distance of the neck's first motor from the midpoint between the cameras for it to be
drawn, m (chosen: a nearer one would hide the eyes)."""
_TEXELS_PER_CELL: Final = 32
"""Texture pixels along a cell of a board (chosen: sharp edges under OpenGL's interpolation against
memory)."""

_FROM_OPTICAL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
"""Pose of MuJoCo's camera frame, which looks along -z with y up, in C: a turn by 180 degrees about
x (physical: MuJoCo's convention)."""


def add_appearance(
    spec: mujoco.MjSpec, bodies: Mapping[int, Any], head: HeadModel, posture: RestPoses
) -> None:
    """Add the visible shapes of a head with two eyes; they have no mass and no contacts."""
    for name, (rgba, shininess) in _MATERIALS.items():
        spec.add_material(name=name, rgba=rgba, shininess=shininess, specular=0.4)
    links, size, middle = head.links.bodies(), posture.scale, posture.cameras[:, :3, 3].mean(axis=0)
    top, up = posture.stand_top, posture.upright_frame[:3, 2]
    height = up @ (top - posture.upright_frame[:3, 3]) - posture.floor_m - 0.01
    _add_rod(bodies[-1], top, 0.022 * size, top - height * up, kind=_Kind.mjGEOM_CYLINDER)
    skull, on_bar = chain_end(links, None), posture.baseline_m > _MAX_SKULL_BASELINE_M
    for place, link in enumerate(links):
        body, rod = bodies[place], 0.006
        if link.joints[0] < NECK.stop:
            first = link.parent == -1
            rod = 0.007 if place == skull else 0.011 if first else 0.009
            away = np.linalg.norm(posture.links[place, :3, 3] - middle)
            if first and away > _MIN_MOTOR_DISTANCE_M * size:
                _add_motor(body, -0.03 * size, 0.018 * size, 0.03 * size)
            elif not first and place != skull:
                _add_motor(body, -0.025 * size, 0.0, 0.022 * size)
        for other in links:
            if other.parent == place and not (place == skull and on_bar):
                _add_rod(body, other.pose[:3, 3], rod * size)
    _add_face(bodies[skull], skull, posture, on_bar)
    for eye in range(2):
        place = chain_end(links, eye)
        _add_eye(bodies[place], head.camera_in_last_link(eye), posture, place != skull)


def _add_motor(body: Any, bottom: float, top: float, radius: float) -> None:
    _add_rod(body, [0.0, 0.0, top], radius, [0.0, 0.0, bottom], "dark", _Kind.mjGEOM_CYLINDER)


def _add_rod(
    body: Any,
    end: ArrayLike,
    radius: float,
    start: ArrayLike = (0.0, 0.0, 0.0),
    look: str | Sequence[float] = "metal",
    kind: mujoco.mjtGeom = _Kind.mjGEOM_CAPSULE,
) -> None:
    """Add a rod, or a cylinder, between two points that are more than 1 mm apart."""
    if np.linalg.norm(np.subtract(end, start)) > 1e-3:
        _add_shape(body, kind, look, size=[radius, 0.0, 0.0], fromto=np.concatenate([start, end]))


def _add_shape(body: Any, kind: mujoco.mjtGeom, look: str | Sequence[float], **where: Any) -> None:
    """Add a shape with a material by its name, or with a colour of its own."""
    colour = {"material" if isinstance(look, str) else "rgba": look}
    body.add_geom(type=kind, **colour, **where, **_VISUAL_ONLY)


def _add_face(body: Any, skull: int, posture: RestPoses, on_bar: bool) -> None:
    """Add a skull behind the eyes, or a bar that carries them, to the body that carries N."""
    into = inverse_pose(posture.links[skull]) if skull >= 0 else np.eye(4)
    size, roots = posture.scale, posture.eye_roots
    if skull >= 0 and not on_bar:
        axes, quat = size * np.array(_SKULL_AXES_M), np.empty(4)
        mujoco.mju_mat2Quat(quat, (into @ posture.frame_n)[:3, :3].ravel())
        centre = roots.mean(axis=0) + size * posture.frame_n[:3, :3] @ _SKULL_BEHIND_M
        place = {"size": axes, "pos": _moved(into, centre), "quat": quat}
        _add_shape(body, _Kind.mjGEOM_ELLIPSOID, "shell", **place)
        return
    held, fronts = (_moved(into, points) for points in (posture.bar_ends, roots))
    _add_rod(body, held[1], 0.009 * size, held[0])
    for back, front in zip(held, fronts, strict=True):
        _add_rod(body, front, 0.006 * size, back)
    if skull >= 0:
        _add_rod(body, held.mean(axis=0), 0.009 * size)


def _moved(pose: FloatArray, points: ArrayLike) -> FloatArray:
    """Transform points (..., 3) by a pose."""
    return np.asarray(np.asarray(points) @ pose[:3, :3].T + pose[:3, 3])


def _add_eye(body: Any, camera: FloatArray, posture: RestPoses, moves: bool) -> None:
    """Add an eyeball around the camera, with an iris in front."""
    radius, centre, forward = posture.eye_radius_m, camera[:3, 3], camera[:3, 2]
    small = radius / EYE_RADIUS_M
    if moves and np.linalg.norm(centre) < _MAX_CENTRED_OFFSET_M:
        centre = np.zeros(3)
    elif moves:
        _add_rod(body, centre, 0.006 * posture.scale)
    _add_shape(body, _Kind.mjGEOM_SPHERE, "shell", size=[radius, 0.0, 0.0], pos=centre)
    # they start behind the optical centre: OpenGL does not draw faces seen from behind
    start, front = centre - 0.005 * small * forward, (radius + 0.001 * small) * forward
    iris, kind = 0.5 * radius, _Kind.mjGEOM_CYLINDER
    _add_rod(body, centre + front, iris, start, "dark", kind)
    _add_rod(body, centre + 1.05 * front, 0.6 * iris, start, "lens", kind)


def add_camera(
    body: Any, name: str, pose: FloatArray, optics: Sequence[ArrayLike], pixel_m: float = 3e-6
) -> None:
    """Add a camera by its optical frame; optics are its size, focal length and principal point, px.

    The edge of a pixel, m, cancels in the image.
    MuJoCo counts the principal point from the image's centre, with right and down negative.
    OpenCV's (0, 0) is the centre of the upper left pixel, hence `W / 2 - (u_0 + 1/2)`.
    """
    size, focal, principal = map(np.asarray, optics)
    seen = {"focal_pixel": focal, "principal_pixel": size / 2.0 - (principal + 0.5)}
    seen |= {"resolution": size, "sensor_size": pixel_m * size}
    body.add_camera(name=name, **seen, **pos_and_quat(pose @ _FROM_OPTICAL))


def pos_and_quat(pose: FloatArray) -> dict[str, FloatArray]:
    """Convert a pose (4, 4) in the parent to MuJoCo's attributes `pos` and `quat`."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, pose[:3, :3].ravel())
    return {"pos": pose[:3, 3], "quat": np.copysign(1.0, quat[0]) * quat}


def _place(posture: RestPoses, point: ArrayLike, faces_head: bool = False) -> dict[str, Any]:
    """Attributes of what stands upright, or faces the head at rest as N looks at it."""
    pose = posture.upright_frame.copy()
    pose[:3, 3] = _moved(pose, point)
    if faces_head:
        pose[:3, :3] @= N_UPRIGHT
    return pos_and_quat(pose)


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


def add_target(spec: mujoco.MjSpec, name: str, board: Board, posture: RestPoses) -> None:
    """Add the mocap body of a target, whose frame is T, one metre ahead of the head.

    T: origin at the measured point, x right and y down as seen from in front, z into the board.
    """
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
    place = _place(posture, [-0.011, -1.064, 0.1], faces_head=True)
    plate = {"name": name, "pos": [*centre, 0.001], "size": [*size / 2.0, 0.001]}
    body = spec.worldbody.add_body(name=name, mocap=True, **place)
    _add_shape(body, _Kind.mjGEOM_BOX, name, **plate)


def add_observer_cameras(spec: mujoco.MjSpec, posture: RestPoses) -> None:
    """Add a stereo camera that looks over the head, like the article's ZED Mini (Table 6).

    The body `fixed_pair` has x right, y down, z forward, and its origin midway between the cameras.
    """
    x, y, z = position = (-0.0122, -0.078, 0.14)
    body = spec.worldbody.add_body(name="fixed_pair", **_place(posture, position, faces_head=True))
    box = {"size": [0.062, 0.0133, 0.012], "pos": [0.0, 0.0, -0.013]}
    _add_shape(body, _Kind.mjGEOM_BOX, _DARK, **box)
    mast = [[x, 0.075, z], [x, 0.075, posture.floor_m + 0.01], [x, y + 0.02, z]]
    elbow, *ends = _moved(posture.upright_frame, mast)
    for end in ends:
        _add_rod(spec.worldbody, end, 0.006, elbow, _METAL)
    pose, optics = np.eye(4), ((1280, 720), (676.21, 676.21), (645.09, 368.27))
    for name, pose[0, 3] in (("fixed_left", -0.0315), ("fixed_right", 0.0315)):
        add_camera(body, name, pose, optics, pixel_m=2e-6)
        end, start = pose[:3, 3], pose[:3, 3] - [0.0, 0.0, 0.002]
        _add_rod(body, end, 0.007, start, _LENS, _Kind.mjGEOM_CYLINDER)


def add_scenery(spec: mujoco.MjSpec, posture: RestPoses) -> None:
    """Add a floor, lights and a dim sky."""
    sky: dict[str, Any] = {"rgb1": [0.35, 0.40, 0.46], "rgb2": [0.10, 0.11, 0.13]}
    sky |= {"builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, "width": 256, "height": 256}
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, **sky)
    spec.add_material(name="floor", rgba=[0.30, 0.31, 0.33, 1.0], specular=0.1, shininess=0.1)
    upright, floor_m = posture.upright_frame, posture.floor_m
    place = {"size": [0.0, 0.0, 0.5], **_place(posture, [0.0, 0.0, floor_m])}
    _add_shape(spec.worldbody, _Kind.mjGEOM_PLANE, "floor", name="floor", **place)
    x, y, _ = _moved(inverse_pose(upright), posture.stand_top)
    bottom, top = _moved(upright, [[x, y, floor_m], [x, y, floor_m + 0.012]])
    _add_rod(spec.worldbody, top, 0.09, bottom, _DARK, _Kind.mjGEOM_CYLINDER)
    # offscreen multisampling and shadow maps take most of a frame's time on a CPU
    spec.visual.quality.offsamples = spec.visual.quality.shadowsize = 0
    spec.visual.rgba.haze = [0.16, 0.17, 0.19, 1.0]
    light = spec.visual.headlight
    light.ambient, light.diffuse, light.specular = [0.35] * 3, [0.25] * 3, [0.0] * 3
    beam = {"dir": upright[:3, :3] @ [-0.4, 0.5, -0.8], "diffuse": [0.6, 0.6, 0.6]}
    spec.worldbody.add_light(name="key", pos=_moved(upright, [0.6, -0.8, 1.2]), **beam)
    spec.visual.map.znear = 0.005
    spec.stat.center = _moved(upright, [0.0, -0.05, 0.0])
    spec.stat.extent = 0.6 * max(1.0, posture.baseline_m / 0.3)
