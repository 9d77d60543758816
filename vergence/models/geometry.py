"""Geometry of a head's links, by D-H rows or by joint axes, and the parameters that may differ."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from math import cos, sin
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from vergence.models.camera import Cameras
from vergence.models.parts import (
    EYE_NAMES,
    JOINTS,
    LINKS,
    NECK,
    FloatArray,
    FrozenArrays,
    Parameter,
)
from vergence.operands import as_operand

T_3_N: Final = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From frame 3 to N: x3 is z_N, y3 is -y_N, z3 is x_N; its own inverse (physical: the definition of
N)."""


class Body(NamedTuple):
    """Body that one joint carries. The z axis of its frame is the joint's axis."""

    name: str
    """The joint's name."""
    joints: tuple[int, ...]
    """Indices of the joint in an array of all seven; two for a joint that both eyes share."""
    parent: int
    """Index in `Links.bodies` of the body that carries this one; -1 for the base."""
    pose: FloatArray
    """(4, 4) pose of its frame in the parent's at a joint angle of zero, metres."""


class Links(Protocol):
    """Protocol of a description of joint axes: a frozen dataclass of arrays, batched or not."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Seven names in joint order; empty for a joint that the head does not have."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Numbers that a calibration may change; the neck's are excluded, as the neck moves N."""

    def arrays(self) -> Mapping[str, tuple[FloatArray, int]]:
        """The numeric fields by name, each with its number of dimensions for one head."""

    def fields(self, reference: Any) -> dict[str, FloatArray]:
        """Arrays that hold the parameters, (..., k) each; rotations are relative to `reference`."""

    def with_fields(self, fields: Mapping[str, FloatArray]) -> Any:
        """A copy of these links with other parameters: the inverse of `fields`."""

    def constant_poses(self) -> list[FloatArray]:
        """(..., 4, 4) B_0-B_3 of the neck, M_0-M_2 of each eye; M_2 without head-eye."""

    def twists(self, reference: Any) -> FloatArray:
        """(n, 6, 6) body twists `M^-1 dM` by parameter and by M_0-M_2, left then right."""

    def bodies(self) -> tuple[Body, ...]:
        """The bodies that the joints carry, parents first; for one head, not for a population."""

    def frame_n_pose(self) -> FloatArray:
        """(4, 4) pose of frame N in the body that carries it: the neck's last body or the base."""

    def camera_mount(self, eye: int) -> FloatArray:
        """(4, 4) pose of the head-eye transform's frame in the last body of an eye's chain."""


def chain_end(bodies: tuple[Body, ...], eye: int | None) -> int:
    """Index of the body that carries an eye's camera, or N if `eye` is None; -1 for the base."""
    carried = set(range(NECK.stop))
    if eye is not None:
        carried |= {3 + 2 * eye, 4 + 2 * eye}
    return max((i for i, body in enumerate(bodies) if carried & set(body.joints)), default=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class DenavitHartenberg(FrozenArrays):
    """The nine links of Table 1 in the modified (Craig) convention.

    `T_(i-1)_i = RotX(alpha_i) TransX(a_i) RotZ(theta_i + offset_i) TransZ(d_i)`; each
    field has the shape (..., 9) in the order of `vergence.models.parts.LINKS`.
    """

    alpha: FloatArray
    """Link twists, in radians."""
    a: FloatArray
    """Link lengths, in metres."""
    d: FloatArray
    """Link offsets, in metres."""
    offset: FloatArray
    """Joint offsets, in radians."""

    @property
    def joints(self) -> tuple[str, ...]:
        """See `Links.joints`."""
        return JOINTS

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The 22 numbers of the six links after N; the last link of an eye has no joint offset."""
        return _LINK_PARAMETERS

    def arrays(self) -> Mapping[str, tuple[FloatArray, int]]:
        """See `Links.arrays`."""
        return {name: (value, 1) for name, value in vars(self).items()}

    def fields(self, reference: "DenavitHartenberg") -> dict[str, FloatArray]:
        """See `Links.fields`; none of them is a rotation vector, so `reference` is not used."""
        return dict(vars(self))

    def with_fields(self, fields: Mapping[str, FloatArray]) -> "DenavitHartenberg":
        """See `Links.with_fields`."""
        return replace(self, **{name: fields[name] for name in vars(self)})

    def transforms(self, frame: int) -> tuple[FloatArray, FloatArray]:
        """The two constant factors of one link, before and after its rotation about z.

        Args:
            frame: the link's frame, 1 to 9.

        Returns:
            `RotX(alpha) TransX(a) RotZ(offset)` and `TransZ(d)`, each (..., 4, 4).
        """
        i = frame - 1
        before = _rot_x(self.alpha[..., i]) @ _translation(0, self.a[..., i])
        return before @ rot_z(self.offset[..., i]), _translation(2, self.d[..., i])

    def constant_poses(self) -> list[FloatArray]:
        """See `Links.constant_poses`."""
        pre, post = zip(*(self.transforms(frame) for frame in range(1, 10)), strict=True)
        poses = [pre[0], post[0] @ pre[1], post[1] @ pre[2], post[2] @ T_3_N]
        for tilt in (3, 6):
            fixed = post[tilt + 1] @ pre[tilt + 2] @ post[tilt + 2]
            poses += [T_3_N @ pre[tilt], post[tilt] @ pre[tilt + 1], fixed]
        return poses

    def twists(self, reference: "DenavitHartenberg") -> FloatArray:
        """See `Links.twists`: each factor of a constant commutes with its own generator."""
        found: dict[tuple[str, int], tuple[int, FloatArray]] = {}
        for eye, tilt in enumerate((3, 6)):
            for k, factors in enumerate(_FACTORS):
                after = np.eye(4)
                for field, link in reversed(factors):
                    i = tilt + link
                    twist = twist_vector(inverse_pose(after) @ _GENERATORS[field] @ after)
                    found[field, i] = 3 * eye + k, twist
                    after = _factor(field, getattr(self, field)[i]) @ after
        out = np.zeros((len(self.parameters), 6, 6))
        for row, parameter in zip(out, self.parameters, strict=True):
            constant, twist = found[parameter.field, parameter.column]
            row[constant] = twist
        return out

    def bodies(self) -> tuple[Body, ...]:
        """See `Links.bodies`; one body for each link with a joint."""
        places: dict[int, int] = {0: -1}
        bodies: list[Body] = []
        for frame, parent, name in LINKS:
            if name:
                pose = np.asarray(np.matmul(*self.transforms(frame)))
                bodies.append(Body(name, (JOINTS.index(name),), places[parent], pose))
                places[frame] = len(bodies) - 1
        return tuple(bodies)

    def frame_n_pose(self) -> FloatArray:
        """See `Links.frame_n_pose`."""
        return T_3_N

    def camera_mount(self, eye: int) -> FloatArray:
        """See `Links.camera_mount`; the pose of frame 6 in 5 (left) or 9 in 8 (right)."""
        return np.asarray(np.matmul(*self.transforms(6 + 3 * eye)))


_LINK_PARAMETERS: Final = tuple(
    Parameter(f"{eye}.{link}.{field}", "m" if field in "ad" else "rad", field, 3 + 3 * i + j)
    for i, eye in enumerate(EYE_NAMES)
    for j, link in enumerate(("tilt", "pan", "camera_link"))
    for field in ("a", "d", "alpha", "offset")[: 3 if link == "camera_link" else 4]
)


_FACTORS: Final = (
    (("alpha", 0), ("a", 0), ("offset", 0)),
    (("d", 0), ("alpha", 1), ("a", 1), ("offset", 1)),
    (("d", 1), ("alpha", 2), ("a", 2), ("offset", 2), ("d", 2)),
)
"""Factors of the constants M_0 to M_2 in their order: field, and link counted from an eye's
first."""


def _generator(axis: int, turns: bool) -> FloatArray:
    out = np.zeros((4, 4))
    if turns:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[j, i], out[i, j] = 1.0, -1.0
    else:
        out[axis, 3] = 1.0
    return out


_GENERATORS: Final = {
    "alpha": _generator(0, True),
    "a": _generator(0, False),
    "offset": _generator(2, True),
    "d": _generator(2, False),
}


def _factor(field: str, value: float) -> FloatArray:
    number = np.float64(value)
    make = {"alpha": _rot_x, "offset": rot_z}.get(field)
    if make is not None:
        return make(np.asarray(number))
    return _translation(0 if field == "a" else 2, np.asarray(number))


def twist_vector(matrix: FloatArray) -> FloatArray:
    """(..., 6) vector (rotation, then translation) of a twist in matrix form (..., 4, 4)."""
    return np.stack(
        [matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0],
         matrix[..., 0, 3], matrix[..., 1, 3], matrix[..., 2, 3]],
        axis=-1,
    )  # fmt: skip


def pose_parameter_twists(reference_pose: FloatArray, rotation_vector: FloatArray) -> FloatArray:
    """(6, 6) rows `inv(T) dT/dx` (rotation, translation) for r, then p, of T = (R exp([r]), p)."""
    angle = float(np.linalg.norm(rotation_vector))
    x, y, z = rotation_vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # right Jacobian of SO(3), by its series for a small angle
    small = angle < 1e-4
    one = 0.5 - angle**2 / 24.0 if small else (1.0 - np.cos(angle)) / angle**2
    two = 1.0 / 6.0 - angle**2 / 120.0 if small else (angle - np.sin(angle)) / angle**3
    jacobian = np.eye(3) - one * cross + two * cross @ cross
    turn = np.eye(3) + (1.0 - angle**2 * two) * cross + one * cross @ cross
    out = np.zeros((6, 6))
    out[:3, :3] = jacobian.T
    out[3:, 3:] = reference_pose[:3, :3] @ turn
    return out


def map_arrays(links: Any, pick: Callable[[FloatArray, int], FloatArray]) -> Any:
    """Copy links; each array becomes `pick(array, its number of dimensions for one head)`."""
    arrays = {name: pick(value, own) for name, (value, own) in links.arrays().items()}
    return replace(links, **arrays)


def multiply_poses(*poses: FloatArray) -> FloatArray:
    """(..., 4, 4) product, equal bit for bit on every machine, unlike BLAS, as digests need."""
    made, *others = poses
    for other in others:
        terms = [made[..., :, k, None] * other[..., None, k, :] for k in range(4)]
        made = terms[0] + terms[1] + terms[2] + terms[3]
    return made


def inverse_pose(pose: FloatArray) -> FloatArray:
    """(..., 4, 4) inverse of a pose: T_B_A from T_A_B."""
    out = np.zeros_like(pose)
    out[..., :3, :3] = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", out[..., :3, :3], pose[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def dh_pose(alpha: float, a: float, d: float, offset: float) -> FloatArray:
    """(4, 4) `RotX(alpha) TransX(a) RotZ(offset) TransZ(d)`."""
    ca, sa, co, so = cos(alpha), sin(alpha), cos(offset), sin(offset)
    return np.array(
        [
            [co, -so, 0.0, a],
            [ca * so, ca * co, -sa, -sa * d],
            [sa * so, sa * co, ca, ca * d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _rot_x(angle: FloatArray) -> FloatArray:
    out = np.zeros((*angle.shape, 4, 4))
    out[..., 0, 0] = out[..., 3, 3] = 1.0
    out[..., 1, 1] = out[..., 2, 2] = np.cos(angle)
    out[..., 2, 1] = np.sin(angle)
    out[..., 1, 2] = -out[..., 2, 1]
    return out


def rot_z(angle: FloatArray) -> FloatArray:
    """(..., 4, 4) rotation about z by each angle, rad."""
    out = np.zeros((*angle.shape, 4, 4))
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0] = np.sin(angle)
    out[..., 0, 1] = -out[..., 1, 0]
    return out


def _translation(axis: int, length: FloatArray) -> FloatArray:
    out = np.zeros((*length.shape, 4, 4))
    out[..., range(4), range(4)] = 1.0
    out[..., axis, 3] = length
    return out


PARTS: Final = ("neck", "both", "left", "right")
"""Names of a joint's load: the whole head (neck), both eyes, or one eye."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointAxes(FrozenArrays):
    """Joints of any head: the pose of each in the frame of the one before; its axis is z.

    The chain of an eye is the neck's joints, then the joints that both eyes share, then those of
    the eye alone, each group in the order of the arrays. A frame turns with its joint. The
    head-eye transform is relative to the frame of the eye's last joint, or, for an eye that does
    not move, to the frame that N is fixed to.
    """

    names: tuple[str, ...]
    """(J,) names of the joints."""
    parts: tuple[str, ...]
    """(J,) load of each joint, one of `PARTS`."""
    pose: FloatArray
    """(..., J, 4, 4) poses at joint angles of zero, metres."""
    frame: FloatArray
    """(..., 4, 4) pose of frame N in the frame of the neck's last joint, or in the base's,
    metres."""

    @property
    def joint_indices(self) -> tuple[tuple[int, ...], ...]:
        """(J,) indices of each joint in an array of all seven; two for a joint of both eyes."""
        used = {"neck": 0, "left": 3, "right": 5}
        out = []
        for part in self.parts:
            names = EYE_NAMES if part == "both" else (part,)
            out.append(tuple(used[name] for name in names))
            for name in names:
                used[name] += 1
        return tuple(out)

    @property
    def joints(self) -> tuple[str, ...]:
        """See `Links.joints`."""
        names = [""] * len(JOINTS)
        for name, places in zip(self.names, self.joint_indices, strict=True):
            for place in places:
                names[place] = name
        return tuple(names)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Six for each joint of the eyes: rotation vector and position of its frame.

        A name consists of the part, the joint's number in the chain and the axis, as `both.1.rz`.
        """
        out, seen = [], dict.fromkeys(PARTS, 0)
        for joint, part in enumerate(self.parts):
            seen[part] += 1
            if part == "neck":
                continue
            # joints that both eyes share come first in the chain of an eye
            number = seen[part] + (seen["both"] if part != "both" else 0)
            for field, unit, names in _POSE_FIELDS:
                out += [
                    Parameter(f"{part}.{number}.{name}", unit, field, 3 * joint + i)
                    for i, name in enumerate(names)
                ]
        return tuple(out)

    def arrays(self) -> Mapping[str, tuple[FloatArray, int]]:
        """See `Links.arrays`."""
        return {"pose": (self.pose, 3), "frame": (self.frame, 2)}

    def fields(self, reference: "JointAxes") -> dict[str, FloatArray]:
        """See `Links.fields`."""
        rotation = np.zeros((*self.pose.shape[:-3], 3 * len(self.names)))
        if reference is not self and self.names:
            relative = np.swapaxes(reference.pose[..., :3, :3], -1, -2) @ self.pose[..., :3, :3]
            from scipy.spatial.transform import Rotation

            vectors = Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec()
            rotation = vectors.reshape(*relative.shape[:-3], 3 * len(self.names))
        position = self.pose[..., :3, 3]
        return {
            "axis_rotation": rotation,
            "axis_position": position.reshape(*position.shape[:-2], 3 * len(self.names)),
        }

    def with_fields(self, fields: Mapping[str, FloatArray]) -> "JointAxes":
        """See `Links.with_fields`."""
        rotation, position = fields["axis_rotation"], fields["axis_position"]
        batch = np.broadcast_shapes(rotation.shape[:-1], position.shape[:-1])
        pose = np.broadcast_to(self.pose, (*batch, *self.pose.shape[-3:])).copy()
        if self.names:
            from scipy.spatial.transform import Rotation

            turn = Rotation.from_rotvec(rotation.reshape(-1, 3)).as_matrix()
            pose[..., :3, :3] @= turn.reshape(*rotation.shape[:-1], len(self.names), 3, 3)
            pose[..., :3, 3] = position.reshape(*position.shape[:-1], len(self.names), 3)
        return replace(self, pose=pose)

    def constant_poses(self) -> list[FloatArray]:
        """See `Links.constant_poses`."""
        poses: list[FloatArray] = [np.eye(4)] * 10
        into_n = inverse_pose(self.frame)
        poses[3] = self.frame
        poses[4] = poses[7] = into_n
        for joint, places in enumerate(self.joint_indices):
            pose = self.pose[..., joint, :, :]
            for place in places:
                if place < NECK.stop:
                    poses[place] = pose
                else:
                    eye, second = divmod(place - NECK.stop, 2)
                    poses[4 + 3 * eye + second] = pose if second else multiply_poses(into_n, pose)
        return poses

    def twists(self, reference: "JointAxes") -> FloatArray:
        """See `Links.twists`."""
        rotations = self.fields(reference)["axis_rotation"].reshape(-1, 3)
        out = np.zeros((len(self.parameters), 6, 6))
        row = 0
        for joint, places in enumerate(self.joint_indices):
            if self.parts[joint] == "neck":
                continue
            twists = pose_parameter_twists(reference.pose[joint], rotations[joint])
            for place in places:
                eye, second = divmod(place - NECK.stop, 2)
                out[row : row + 6, 3 * eye + second] = twists
            row += 6
        return out

    def bodies(self) -> tuple[Body, ...]:
        """See `Links.bodies`."""
        last = {"neck": -1, "left": -1, "right": -1}
        out = []
        for joint, (name, part) in enumerate(zip(self.names, self.parts, strict=True)):
            parent = last["left" if part == "both" else part]
            out.append(Body(name, self.joint_indices[joint], parent, self.pose[joint]))
            carried = {"neck": last, "both": EYE_NAMES}.get(part, (part,))
            last |= dict.fromkeys(carried, joint)
        return tuple(out)

    def frame_n_pose(self) -> FloatArray:
        """See `Links.frame_n_pose`."""
        return self.frame

    def camera_mount(self, eye: int) -> FloatArray:
        """See `Links.camera_mount`: the last body's own frame."""
        return np.eye(4)


_POSE_FIELDS: Final = (
    ("axis_rotation", "rad", ("rx", "ry", "rz")),
    ("axis_position", "m", ("x", "y", "z")),
)


_HEAD_EYE: Final = tuple(
    Parameter(f"{eye}.head_eye.{name}", unit, field, 3 * i + j)
    for i, eye in enumerate(EYE_NAMES)
    for field, unit, names in (
        ("rotation", "rad", ("rx", "ry", "rz")),
        ("position", "m", ("x", "y", "z")),
    )
    for j, name in enumerate(names)
)


_CAMERA_FIELDS: Final = ("focal", "principal", "distortion")


class Geometry(NamedTuple):
    """The parts in which a real head differs from its model."""

    links: Links
    cameras: Cameras


class Parameters(NamedTuple):
    """A head's geometry as a vector."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    """(..., n): one vector per head."""


def parameters_of(geometry: Geometry, reference: Geometry | None = None) -> Parameters:
    """Flatten a geometry; rotation vectors are relative to `reference`, by default to itself."""
    parameters = _parameters(geometry)
    fields = _fields(geometry, geometry if reference is None else reference)
    batch = np.broadcast_shapes(*(field.shape[:-1] for field in fields.values()))
    values = np.empty((*batch, len(parameters)))
    for name, (columns, places) in _places(parameters).items():
        values[..., places] = fields[name][..., columns]
    return Parameters(
        tuple(parameter.name for parameter in parameters),
        tuple(parameter.unit for parameter in parameters),
        values,
    )


def geometry_with(reference: Geometry, values: ArrayLike) -> Geometry:
    """Rebuild a geometry from (..., n) `parameters_of`; the neck is copied from the reference."""
    parameters = _parameters(reference)
    vector = as_operand("values", values, len(parameters))
    batch = vector.shape[:-1]
    fields = {
        name: np.broadcast_to(field, (*batch, field.shape[-1])).copy()
        for name, field in _fields(reference, reference).items()
    }
    for name, (columns, places) in _places(parameters).items():
        fields[name][..., columns] = vector[..., places]
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec(fields["rotation"].reshape(-1, 3)).as_matrix()
    head_eye = np.broadcast_to(reference.cameras.pose, (*batch, 2, 4, 4)).copy()
    head_eye[..., :3, :3] @= rotation.reshape(*batch, 2, 3, 3)
    head_eye[..., :3, 3] = fields["position"].reshape(*batch, 2, 3)
    cameras = {name: fields[name].reshape(*batch, 2, -1) for name in _CAMERA_FIELDS}
    return Geometry(
        reference.links.with_fields(fields), reference.cameras.replaced(**cameras, pose=head_eye)
    )


def _parameters(geometry: Geometry) -> tuple[Parameter, ...]:
    return (*geometry.links.parameters, *_HEAD_EYE, *geometry.cameras.parameters)


@lru_cache(maxsize=8)
def _places(parameters: tuple[Parameter, ...]) -> dict[str, tuple[list[int], list[int]]]:
    """By field: the columns that hold parameters, and the parameters' indices in the vector."""
    groups: dict[str, tuple[list[int], list[int]]] = {}
    for place, parameter in enumerate(parameters):
        columns, places = groups.setdefault(parameter.field, ([], []))
        columns.append(parameter.column)
        places.append(place)
    return groups


def _fields(geometry: Geometry, reference: Geometry) -> dict[str, FloatArray]:
    """Every field that holds parameters, by name, with its own dimensions flattened."""
    links, cameras = geometry
    head_eye = cameras.pose
    rotation = np.zeros((2, 3))
    if reference is not geometry:
        given = reference.cameras.pose[..., :3, :3]
        relative = np.swapaxes(given, -1, -2) @ head_eye[..., :3, :3]
        from scipy.spatial.transform import Rotation

        vectors = Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec()
        rotation = vectors.reshape(*relative.shape[:-2], 3)
    pairs = {name: getattr(cameras, name) for name in _CAMERA_FIELDS}
    pairs |= {"rotation": rotation, "position": head_eye[..., :3, 3]}
    return links.fields(reference.links) | {
        name: pair.reshape(*pair.shape[:-2], pair.shape[-2] * pair.shape[-1])
        for name, pair in pairs.items()
    }
