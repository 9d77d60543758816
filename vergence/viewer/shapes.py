"""Shapes of a head as triangle meshes, taken from its MuJoCo model: links, eyes, stand."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.mujoco import mujoco
from vergence.models.mujoco.model import compile_model, find_model_indices
from vergence.models.parts import FloatArray
from vergence.models.posture import rest_poses

_GEOM: Final = mujoco.mjtGeom
_SIDES: Final = 24
"""Sides of a round shape (chosen: smoothness against triangles)."""
_MIN_AREA: Final = 1e-9
"""Area of a triangle, by the largest one's, below which it is a line (numerical)."""
_RINGS: Final = 8
"""Rings of half a sphere (chosen: smoothness against triangles)."""


class Mesh(NamedTuple):
    """A rigid triangle mesh of one colour."""

    body: int
    """Index of the body that it moves with, see `HeadShapes.body_poses`."""
    vertices: FloatArray
    """(v, 3) in the body's frame, m."""
    faces: NDArray[np.int64]
    """(f, 3) indices of vertices, counterclockwise as seen from outside."""
    colour: tuple[int, int, int]
    """RGB, 0 to 255."""


class HeadShapes:
    """Meshes of a head, and their poses for any joint angles.

    All is in the head's upright frame: z up, and the head at rest looks along -y.

    Args:
        head: one head, not a population.

    Attributes:
        meshes: meshes of links, eyes and stand.
        baseline_m: distance of the cameras at rest, m.
    """

    def __init__(self, head: HeadModel) -> None:
        self._head = head
        self._model = compile_model(head)
        self._data = mujoco.MjData(self._model)
        self._places = find_model_indices(self._model, head).joint_of_qpos
        posture = rest_poses(head)
        self._from_base = inverse_pose(posture.upright_frame)
        self.baseline_m = posture.baseline_m
        self.meshes = tuple(
            _mesh(self._model, geom)
            for geom in range(self._model.ngeom)
            if self._model.geom_type[geom] != _GEOM.mjGEOM_PLANE
        )

    def body_poses(self, positions: FloatArray) -> FloatArray:
        """Poses of all bodies.

        Args:
            positions: (7,) joint angles, rad.

        Returns:
            (bodies, 4, 4) in the upright frame.
        """
        self._data.qpos[: len(self._places)] = positions[self._places]
        mujoco.mj_kinematics(self._model, self._data)
        poses = np.tile(np.eye(4), (self._model.nbody, 1, 1))
        poses[:, :3, :3] = self._data.xmat.reshape(-1, 3, 3)
        poses[:, :3, 3] = self._data.xpos
        return np.asarray(self._from_base @ poses)

    def pose_of_n(self, positions: FloatArray) -> FloatArray:
        """(4, 4) pose of frame N in the upright frame.

        Args:
            positions: (7,) joint angles, rad.
        """
        return np.asarray(self._from_base @ self._head.base_pose(positions))


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """Convert one shape of a MuJoCo model to a mesh."""
    kind, (a, b, c) = model.geom_type[geom], model.geom_size[geom]
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    if kind == _GEOM.mjGEOM_BOX:
        vertices, faces = _box()
        vertices = vertices * [a, b, c]
    else:
        vertices, faces = revolve(_profile(kind, a, b))
        if kind == _GEOM.mjGEOM_ELLIPSOID:
            vertices = vertices * [a, b, c]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return Mesh(
        body=int(model.geom_bodyid[geom]),
        vertices=vertices @ turn.reshape(3, 3).T + model.geom_pos[geom],
        faces=faces,
        colour=tuple(np.round(255.0 * rgba[:3]).astype(int).tolist()),
    )


def _profile(kind: int, radius: float, half_length: float) -> FloatArray:
    """(k, 2) radius and height along the profile of a round shape, from the bottom up.

    A corner of the profile is given twice, so that shading does not round it.
    """
    if kind == _GEOM.mjGEOM_CYLINDER:
        r, h = radius, half_length
        return np.array([[0.0, -h], [r, -h], [r, -h], [r, h], [r, h], [0.0, h]])
    angles = np.linspace(0.0, 0.5 * np.pi, _RINGS + 1)
    upper = np.column_stack([np.cos(angles), np.sin(angles)])
    if kind == _GEOM.mjGEOM_CAPSULE:
        upper = radius * upper + [0.0, half_length]
    elif kind == _GEOM.mjGEOM_SPHERE:
        upper = radius * upper
    return np.concatenate([upper[::-1] * [1.0, -1.0], upper])


def revolve(profile: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices and faces of the surface that a profile sweeps around the z axis."""
    around = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    rings = profile[:, None, :1] * circle
    heights = np.broadcast_to(profile[:, None, 1:], (*rings.shape[:2], 1))
    vertices = np.concatenate([rings, heights], axis=-1).reshape(-1, 3)
    ring, side = np.meshgrid(np.arange(len(profile) - 1), np.arange(_SIDES), indexing="ij")
    a, b = ring * _SIDES + side, ring * _SIDES + (side + 1) % _SIDES
    faces = np.stack([[a, b, b + _SIDES], [a, b + _SIDES, a + _SIDES]])
    faces = np.moveaxis(faces, 1, -1).reshape(-1, 3)
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    return vertices, faces[area > _MIN_AREA * area.max()]


def _box() -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices and faces of a box from -1 to 1; each side has its own vertices."""
    vertices: list[FloatArray] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            n = sign * np.eye(3)[axis]
            first = len(vertices)
            vertices += [n - u - v, n + u - v, n + u + v, n - u + v]
            order = [0, 1, 2, 0, 2, 3] if sign > 0.0 else [0, 2, 1, 0, 3, 2]
            faces += [[first + i for i in order[:3]], [first + i for i in order[3:]]]
    return np.array(vertices), np.array(faces)
