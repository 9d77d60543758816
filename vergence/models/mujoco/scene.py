"""What is seen in the MuJoCo model and does not move it: shapes, target boards, a fixed pair."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from vergence.models.boards import PlanarTarget, make_planar_target, texture
from vergence.models.head import HeadModel

_GEOM = mujoco.mjtGeom
_SHELL: Final = "shell"
_METAL: Final = "metal"
_DARK: Final = "dark"
_LENS: Final = "lens"
_COLOURS: Final = {
    _SHELL: (0.80, 0.82, 0.85, 1.0),
    _METAL: (0.45, 0.47, 0.50, 1.0),
    _DARK: (0.13, 0.14, 0.16, 1.0),
    _LENS: (0.05, 0.12, 0.28, 1.0),
}
_SHININESS: Final = {_SHELL: 0.4, _METAL: 0.7, _DARK: 0.3, _LENS: 0.9}

SKULL_CENTRE_M: Final = (-0.055, 0.030, 0.001)
SKULL_AXES_M: Final = (0.062, 0.082, 0.074)
"""Ellipsoid behind the eyes, in frame 3."""
MAST_Y_M: Final = 0.075
"""The mast of the fixed pair, behind the skull, in frame 0."""
IRIS_RADIUS_M: Final = 0.009
EYE_RADIUS_M: Final = 0.018
"""Radius of the drawn eyeball, about that of the housing of a small camera module."""

_UNTOUCHABLE: Final = {"contype": 0, "conaffinity": 0, "mass": 0.0}
_TEXELS: Final = 32
"""Pixels of a board's texture along a cell: edges stay sharp under OpenGL's interpolation."""


class FixedPair(NamedTuple):
    """A stereo camera that does not move, like the article's ZED Mini (Table 6)."""

    width: int = 1280
    height: int = 720
    focal_px: float = 676.21
    principal_px: tuple[float, float] = (645.09, 368.27)
    baseline_m: float = 0.063
    position_m: tuple[float, float, float] = (-0.0122, -0.078, 0.14)
    """Midpoint between both optical centres, in frame 0: above the eyes of the head at rest."""


FIXED_PAIR: Final = FixedPair()


def add_target(spec: mujoco.MjSpec, name: str, board: PlanarTarget | None = None) -> None:
    """Add the mocap body of a target, whose frame is T, one metre ahead of the head.

    Args:
        spec: the specification to extend.
        name: of the body.
        board: what it shows; None for the board of that name with its default size.

    Raises:
        UnknownNameError: there is no board of that name.
    """
    board = make_planar_target(name) if board is None else board
    rows, columns = board.cells.shape
    size = board.cell_m * np.array([columns, rows])
    centre = size / 2.0 - board.cell_m * np.array(board.origin_cells)
    file = f"assets/{name}.png"
    spec.assets = {**spec.assets, file: _png(texture(board, _TEXELS))}
    # on the face of a box that looks along -z, textures stand upside down
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file, vflip=True)
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, emission=0.4)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    # upright before the head at rest: x_T = -x_0, y_T = -z_0, z_T = -y_0
    body = spec.worldbody.add_body(
        name=name, mocap=True, pos=[-0.011, -1.064, 0.1], quat=[0.0, 0.0, 0.5**0.5, -(0.5**0.5)]
    )
    body.add_geom(
        name=name,
        type=_GEOM.mjGEOM_BOX,
        pos=[*centre, 0.001],
        size=[*size / 2.0, 0.001],
        material=name,
        **_UNTOUCHABLE,
    )


def _png(image: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".png", image)[1])


def add_fixed_pair(spec: mujoco.MjSpec, pair: FixedPair = FIXED_PAIR) -> None:
    """Add the body `fixed_pair`, its frame x right, y down, z forward, midway of its cameras."""
    body = spec.worldbody.add_body(
        name="fixed_pair", pos=pair.position_m, quat=[0.0, 0.0, 0.5**0.5, -(0.5**0.5)]
    )
    size = np.array([pair.width, pair.height])
    buffer = spec.visual.global_
    buffer.offwidth = max(buffer.offwidth, pair.width)
    buffer.offheight = max(buffer.offheight, pair.height)
    box = {"size": [0.062, 0.0133, 0.012], "pos": [0.0, 0.0, -0.013]}
    _shape(body, _GEOM.mjGEOM_BOX, _COLOURS[_DARK], **box)
    x, y, z = pair.position_m
    elbow = [x, MAST_Y_M, z]
    for end in ([x, MAST_Y_M, -0.25], [x, y + 0.02, z]):
        metal, capsule = _COLOURS[_METAL], _GEOM.mjGEOM_CAPSULE
        _segment(spec.worldbody, metal, elbow, end, 0.006, capsule)
    for side, name in ((-1, "fixed_left"), (1, "fixed_right")):
        centre = [side * pair.baseline_m / 2.0, 0.0, 0.0]
        # MuJoCo's cameras look along -z with y up, and count the principal point from the
        # image's centre towards the left and up, in edges instead of centres of pixels
        body.add_camera(
            name=name,
            pos=centre,
            quat=[0.0, 1.0, 0.0, 0.0],
            resolution=size,
            sensor_size=2e-6 * size,
            focal_pixel=[pair.focal_px, pair.focal_px],
            principal_pixel=size / 2.0 - (np.array(pair.principal_px) + 0.5),
        )
        _segment(body, _COLOURS[_LENS], [centre[0], 0.0, -0.002], centre, 0.007)


def add_appearance(spec: mujoco.MjSpec, bodies: dict[int, Any], head: HeadModel) -> None:
    """Give the links the look of a head with two eyes; nothing here touches or weighs.

    Args:
        spec: the specification to extend.
        bodies: the body of each moving frame, 0 being the world.
        head: the head, whose link lengths the shapes follow.
    """
    for name, rgba in _COLOURS.items():
        spec.add_material(name=name, rgba=rgba, shininess=_SHININESS[name], specular=0.4)
    _segment(bodies[0], _METAL, [0.0, 0.0, -0.25], [0.0, 0.0, -0.03], 0.022)
    _segment(bodies[1], _DARK, [0.0, 0.0, -0.03], [0.0, 0.0, 0.018], 0.03)
    _link(bodies[1], 2, head, _METAL, 0.011)
    _segment(bodies[2], _DARK, [0.0, 0.0, -0.025], [0.0, 0.0, 0.0], 0.022)
    _link(bodies[2], 3, head, _METAL, 0.009)
    _shape(bodies[3], _GEOM.mjGEOM_ELLIPSOID, _SHELL, size=SKULL_AXES_M, pos=SKULL_CENTRE_M)
    for tilt in (4, 7):
        _link(bodies[3], tilt, head, _METAL, 0.007)
        pan = tilt + 1
        _link(bodies[tilt], pan, head, _METAL, 0.006)
        eye = bodies[pan]
        forward = _fixed_rotation(head, pan)[:, 2]
        _shape(eye, _GEOM.mjGEOM_SPHERE, _SHELL, size=[EYE_RADIUS_M, 0.0, 0.0])
        # they begin behind the optical centre: OpenGL draws no face from its back
        start, front = -0.005 * forward, (EYE_RADIUS_M + 0.001) * forward
        _segment(eye, _DARK, start, front, IRIS_RADIUS_M)
        _segment(eye, _LENS, start, 1.05 * front, 0.6 * IRIS_RADIUS_M)


def _fixed_rotation(head: HeadModel, pan: int) -> NDArray[np.float64]:
    fixed = np.matmul(*head.links.transforms(pan + 1))
    return np.asarray((fixed @ head.head_eye[pan // 3 - 1])[:3, :3])


def _link(body: Any, frame: int, head: HeadModel, material: str, radius: float) -> None:
    """A rod from a body's origin to that of the frame that follows it."""
    end = np.matmul(*head.links.transforms(frame))[:3, 3]
    if np.linalg.norm(end) > 1e-3:
        _segment(body, material, np.zeros(3), end, radius, _GEOM.mjGEOM_CAPSULE)


def _segment(
    body: Any,
    look: str | Sequence[float],
    start: Any,
    end: Any,
    radius: float,
    kind: mujoco.mjtGeom = _GEOM.mjGEOM_CYLINDER,
) -> None:
    ends = np.concatenate([start, end])
    _shape(body, kind, look, size=[radius, 0.0, 0.0], fromto=ends)


def _shape(body: Any, kind: mujoco.mjtGeom, look: str | Sequence[float], **where: Any) -> None:
    """A shape that looks like a material of the head, or has a colour of its own.

    What surrounds the head names no material of it, so that files of the two can be separate.
    """
    colour = {"material": look} if isinstance(look, str) else {"rgba": look}
    body.add_geom(type=kind, **colour, **where, **_UNTOUCHABLE)


def add_scenery(spec: mujoco.MjSpec) -> None:
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
        pos=[0.0, 0.0, -0.26],
        size=[0.0, 0.0, 0.5],
        material="floor",
        **_UNTOUCHABLE,
    )
    _segment(spec.worldbody, _COLOURS[_DARK], [0.0, 0.0, -0.26], [0.0, 0.0, -0.248], 0.09)
    # offset samples and shadow maps cost most of a frame on a CPU, and pictures do without
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 0
    spec.visual.rgba.haze = [0.16, 0.17, 0.19, 1.0]
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.25, 0.25, 0.25]
    spec.visual.headlight.specular = [0.0, 0.0, 0.0]
    spec.worldbody.add_light(
        name="key", pos=[0.6, -0.8, 1.2], dir=[-0.4, 0.5, -0.8], diffuse=[0.6, 0.6, 0.6]
    )
    spec.visual.map.znear = 0.005
    spec.stat.center = [0.0, -0.05, 0.0]
    spec.stat.extent = 0.6
