"""Geometry of a head's links, by D-H rows or by joint axes, and the parameters that may differ."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, sin
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.errors import ConfigurationError
from vergence.models.camera import STACKED, Cameras
from vergence.models.parts import (
    EYE_NAMES,
    JOINTS,
    LINKS,
    FloatArray,
    FrozenArrays,
    Parameter,
)
from vergence.operands import as_operand

T_3_N: Final = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From frame 3 to N: x3 is z_N, y3 is -y_N, z3 is x_N; its own inverse (physical: a definition)."""
PARTS: Final = ("neck", "both", "left", "right")
"""Names of a joint's load: the whole head (neck), both eyes, or one eye."""
_STEPS: Final = {"alpha": (0, True), "a": (0, False), "offset": (2, True), "d": (2, False)}
"""By field of `DenavitHartenberg`: the axis of its motion, and True if it is a rotation."""
_FACTORS: Final = (
    (("alpha", 0), ("a", 0), ("offset", 0)),
    (("d", 0), ("alpha", 1), ("a", 1), ("offset", 1)),
    (("d", 1), ("alpha", 2), ("a", 2), ("offset", 2), ("d", 2)),
)
"""Factors of the constants M_0 to M_2: field, and link counted from an eye's first."""
_CONSTANT_OF_JOINT: Final = (0, 1, 2, 4, 5, 7, 8)
"""Index in `Links.constant_poses` of the pose before each of the seven joints (numerical)."""
_PINHOLE: Final = ("focal", "principal", "distortion")
_CAMERA_FIELDS: Final = tuple((name, len(core)) for name, core in STACKED.items() if core)
"""Values of a pair of cameras that differ in a population, and their dimensions for one head."""


class Body(NamedTuple):
    """Body that one joint carries. The z axis of its frame is the joint's axis."""

    name: str  # the joint's name
    joints: tuple[int, ...]
    """Indices of the joint in an array of all seven; two for a joint that both eyes share."""
    parent: int  # index in `Links.bodies` of the body that carries this one; -1 for the base
    pose: FloatArray  # (4, 4) pose of its frame in the parent's at a joint angle of zero, metres


class Links(FrozenArrays, ABC):
    """Description of joint axes: a frozen dataclass of arrays, batched or not."""

    names: tuple[str, ...]
    parts: tuple[str, ...]
    pose: FloatArray
    frame: FloatArray
    """(4, 4) pose of frame N in the body that carries it: the neck's last body or the base."""
    parameters: tuple[Parameter, ...]
    """Numbers that a calibration may change; the neck's are excluded, as the neck moves N."""
    _dimensions: tuple[tuple[str, int], ...]

    @property
    def joint_indices(self) -> tuple[tuple[int, ...], ...]:
        """(J,) indices of each joint in an array of all seven; two for a joint of both eyes."""
        used = {"neck": 0, "left": 3, "right": 5}
        out = []
        for part in self.parts:
            loads = EYE_NAMES if part == "both" else (part,)
            out.append(tuple(used[load] for load in loads))
            used |= {load: used[load] + 1 for load in loads}
        return tuple(out)

    @property
    def joints(self) -> tuple[str, ...]:
        """Seven names in joint order; empty for a joint that the head does not have."""
        pairs = zip(self.names, self.joint_indices, strict=True)
        names = {place: name for name, places in pairs for place in places}
        return tuple(names.get(place, "") for place in range(len(JOINTS)))

    def bodies(self) -> tuple[Body, ...]:
        """The bodies that the joints carry, parents first; for one head, not for a population."""
        out: list[Body] = []
        for name, part, places, pose in zip(
            self.names, self.parts, self.joint_indices, self.pose, strict=True
        ):
            parent = chain_end(out, {"neck": None, "right": 1}.get(part, 0))
            out.append(Body(name, places, parent, pose))
        return tuple(out)

    def fields(self, reference: Any) -> dict[str, FloatArray]:
        """Arrays that hold the parameters, (..., k) each; rotations are relative to `reference`."""
        return {name: getattr(self, name) for name, _ in self._dimensions}

    def with_fields(self, fields: Mapping[str, FloatArray]) -> Any:
        """A copy of these links with other parameters: the inverse of `fields`."""
        links: Any = self
        return replace(links, **{name: fields[name] for name, _ in self._dimensions})

    @abstractmethod
    def constant_poses(self) -> list[FloatArray]:
        """(..., 4, 4) B_0-B_3 of the neck, M_0-M_2 of each eye; M_2 without head-eye."""

    @abstractmethod
    def twists(self, reference: Any) -> FloatArray:
        """(n, 6, 6) body twists `M^-1 dM` by parameter and by M_0-M_2, left then right."""

    def camera_mount(self, eye: int) -> FloatArray:
        """(4, 4) pose of the head-eye transform's frame in the last body of an eye's chain."""
        return np.eye(4)


def chain_end(bodies: Sequence[Body], eye: int | None) -> int:
    """Index of the body that carries an eye's camera, or N if `eye` is None; -1 for the base."""
    carried = {0, 1, 2} if eye is None else {0, 1, 2, 3 + 2 * eye, 4 + 2 * eye}
    return max((i for i, body in enumerate(bodies) if carried & set(body.joints)), default=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class DenavitHartenberg(Links):
    """The nine links of Table 1 in the modified (Craig) convention.

    `T_(i-1)_i = RotX(alpha_i) TransX(a_i) RotZ(theta_i + offset_i) TransZ(d_i)`; each
    field has the shape (..., 9) in the order of `vergence.models.parts.LINKS`.
    """

    names = JOINTS
    parts = (*["neck"] * 3, *["left"] * 2, *["right"] * 2)
    frame = T_3_N
    parameters = tuple(
        Parameter(f"{eye}.{link}.{field}", "m" if field in "ad" else "rad", field, 3 + 3 * i + j)
        for i, eye in enumerate(EYE_NAMES)
        for j, link in enumerate(("tilt", "pan", "camera_link"))
        for field in ("a", "d", "alpha", "offset")[: 3 if link == "camera_link" else 4]
    )
    """The 22 numbers of the six links after N; the last link of an eye has no joint offset."""
    _dimensions = tuple(dict.fromkeys(_STEPS, 1).items())

    alpha: FloatArray
    """Link twists, in radians."""
    a: FloatArray
    """Link lengths, in metres."""
    d: FloatArray
    """Link offsets, in metres."""
    offset: FloatArray
    """Joint offsets, in radians."""

    @property
    def pose(self) -> FloatArray:  # type: ignore[override]
        """(..., 7, 4, 4) poses of the joints' frames in those before at zero angles, metres."""
        frames = (frame for frame, _, name in LINKS if name)
        return np.stack([np.matmul(*self.transforms(frame)) for frame in frames], axis=-3)

    def transforms(self, frame: int) -> tuple[FloatArray, FloatArray]:
        """(..., 4, 4) `RotX(alpha) TransX(a) RotZ(offset)` and `TransZ(d)` of one frame, 1 to 9."""
        values = {field: getattr(self, field)[..., frame - 1] for field in _STEPS}
        alpha, a, offset, d = map(_step, values, values.values())
        return alpha @ a @ offset, d

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
        rows = {(own.field, own.column): row for row, own in enumerate(self.parameters)}
        out = np.zeros((len(rows), 6, 6))
        for place in range(6):
            eye, constant = divmod(place, 3)
            after = np.eye(4)
            for field, link in reversed(_FACTORS[constant]):
                i = 3 + 3 * eye + link
                if (field, i) in rows:
                    twist = inverse_pose(after) @ _GENERATORS[field] @ after
                    out[rows[field, i], place] = twist[[2, 0, 1, 0, 1, 2], [1, 2, 0, 3, 3, 3]]
                after = _step(field, getattr(self, field)[i]) @ after
        return out

    def camera_mount(self, eye: int) -> FloatArray:
        """See `Links.camera_mount`; the pose of frame 6 in 5 (left) or 9 in 8 (right)."""
        return np.asarray(np.matmul(*self.transforms(6 + 3 * eye)))


def _step(field: str, value: ArrayLike) -> FloatArray:
    """(..., 4, 4) motion by one D-H number: a rotation about its axis, or a translation along."""
    axis, turns = _STEPS[field]
    value = np.asarray(value, np.float64)
    out = np.zeros((*value.shape, 4, 4))
    out[..., range(4), range(4)] = 1.0
    if turns:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[..., i, i] = out[..., j, j] = np.cos(value)
        out[..., j, i] = np.sin(value)
        out[..., i, j] = -out[..., j, i]
    else:
        out[..., axis, 3] = value
    return out


def rot_z(angle: ArrayLike) -> FloatArray:
    """(..., 4, 4) rotation about z by each angle, rad."""
    return _step("offset", angle)


_GENERATORS: Final = {
    # exact: the diagonals cancel
    field: 0.5 * (_step(field, by) - _step(field, -by))
    for field, by in (("alpha", 0.5 * np.pi), ("a", 1.0), ("offset", 0.5 * np.pi), ("d", 1.0))
}
"""Twists of unit speed in matrix form, by field."""


def pose_parameter_twists(reference_pose: FloatArray, rotation_vector: FloatArray) -> FloatArray:
    """(6, 6) rows `inv(T) dT/dx` (rotation, translation) for r, then p, of T = (R exp([r]), p)."""
    angle = float(np.linalg.norm(rotation_vector))
    x, y, z = rotation_vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # right Jacobian of SO(3), by its series for a small angle
    small = angle < 1e-4
    one = 0.5 - angle**2 / 24.0 if small else (1.0 - np.cos(angle)) / angle**2
    two = 1.0 / 6.0 - angle**2 / 120.0 if small else (angle - np.sin(angle)) / angle**3
    turn = np.eye(3) + (1.0 - angle**2 * two) * cross + one * cross @ cross
    out = np.zeros((6, 6))
    out[:3, :3] = (np.eye(3) - one * cross + two * cross @ cross).T
    out[3:, 3:] = reference_pose[:3, :3] @ turn
    return out


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
    x, y = [co, -so, 0.0, a], [ca * so, ca * co, -sa, -sa * d]
    return np.array([x, y, [sa * so, sa * co, ca, ca * d], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class JointAxes(Links):
    """Joints of any head: the pose of each in the frame of the one before; its axis is z.

    The chain of an eye is the neck's joints, then the joints that both eyes share, then those of
    the eye alone, each group in the order of the arrays. A frame turns with its joint. The
    head-eye transform is relative to the frame of the eye's last joint, or, for an eye that does
    not move, to the frame that N is fixed to.
    """

    _dimensions = (("pose", 3), ("frame", 2))

    names: tuple[str, ...]
    """(J,) names of the joints."""
    parts: tuple[str, ...]
    """(J,) load of each joint, one of `PARTS`."""
    pose: FloatArray
    """(..., J, 4, 4) poses at joint angles of zero, metres."""
    frame: FloatArray
    """(..., 4, 4) pose of frame N in that of the neck's last joint, or the base's, metres."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """Six by joint of the eyes, named by part, number in the chain and axis: `both.1.rz`."""
        out = []
        for joint, (part, places) in enumerate(zip(self.parts, self.joint_indices, strict=True)):
            if part != "neck":
                number = _CONSTANT_OF_JOINT[places[0]] % 3  # 1 or 2
                out += _pose_parameters(f"{part}.{number}", "axis_", joint)
        return tuple(out)

    def fields(self, reference: "JointAxes") -> dict[str, FloatArray]:
        """See `Links.fields`."""
        return _pose_fields("axis_", self.pose, None if reference is self else reference.pose)

    def with_fields(self, fields: Mapping[str, FloatArray]) -> "JointAxes":
        """See `Links.with_fields`."""
        return replace(self, pose=_moved_poses(self.pose, "axis_", fields))

    def constant_poses(self) -> list[FloatArray]:
        """See `Links.constant_poses`."""
        poses: list[FloatArray] = [np.eye(4)] * 10
        into_n = inverse_pose(self.frame)
        poses[3] = self.frame
        poses[4] = poses[7] = into_n
        for joint, places in enumerate(self.joint_indices):
            pose = self.pose[..., joint, :, :]
            for constant in (_CONSTANT_OF_JOINT[place] for place in places):
                poses[constant] = multiply_poses(into_n, pose) if constant in (4, 7) else pose
        return poses

    def twists(self, reference: "JointAxes") -> FloatArray:
        """See `Links.twists`."""
        rotations = self.fields(reference)["axis_rotation"].reshape(-1, 3)
        out = np.zeros((len(self.names), 6, 6, 6))
        for joint, places in enumerate(self.joint_indices):
            twists = pose_parameter_twists(reference.pose[joint], rotations[joint])
            for place in places:
                out[joint, :, _CONSTANT_OF_JOINT[place] - 4] = twists
        moved = [part != "neck" for part in self.parts]
        return out[moved].reshape(-1, 6, 6)


def _pose_parameters(prefix: str, of: str, index: int) -> list[Parameter]:
    """Six parameters of a pose at an index of fields whose names begin with `of`."""
    return [
        Parameter(f"{prefix}.{name}", unit, f"{of}{field}", 3 * index + i)
        for field, unit, names in (
            ("rotation", "rad", ("rx", "ry", "rz")),
            ("position", "m", ("x", "y", "z")),
        )
        for i, name in enumerate(names)
    ]


def _pose_fields(of: str, poses: FloatArray, about: FloatArray | None) -> dict[str, FloatArray]:
    """Rotation vectors about other poses (None for zeros) and positions of (..., k, 4, 4) poses."""
    shape = (*poses.shape[:-3], 3 * poses.shape[-3])
    rotation = np.zeros(shape)
    if about is not None and poses.size:
        from scipy.spatial.transform import Rotation

        relative = np.swapaxes(about[..., :3, :3], -1, -2) @ poses[..., :3, :3]
        vectors = Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec()
        rotation = vectors.reshape(*relative.shape[:-3], shape[-1])
    return {f"{of}rotation": rotation, f"{of}position": poses[..., :3, 3].reshape(shape)}


def _moved_poses(poses: FloatArray, of: str, fields: Mapping[str, FloatArray]) -> FloatArray:
    """Poses turned by rotation vectors, at other positions: the inverse of `_pose_fields`."""
    rotation, position = fields[f"{of}rotation"], fields[f"{of}position"]
    shape = (*rotation.shape[:-1], *poses.shape[-3:-2])
    out = np.broadcast_to(poses, (*shape, 4, 4)).copy()
    if poses.size:
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_rotvec(rotation.reshape(-1, 3)).as_matrix()
        out[..., :3, :3] @= turn.reshape(*shape, 3, 3)
        out[..., :3, 3] = position.reshape(*shape, 3)
    return out


class Geometry(NamedTuple):
    """The parts in which a real head differs from its model."""

    links: Links
    cameras: Cameras


class Parameters(NamedTuple):
    """A head's geometry as a vector."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray  # (..., n): one vector per head


def combine_geometries(
    geometries: Sequence[Geometry], make: Callable[[Sequence[FloatArray], int], FloatArray]
) -> Geometry:
    """One geometry of `make(arrays of all, their number of dimensions for one head)` by field."""
    first: Any = geometries[0]
    made = []
    for part, arrays in enumerate((first.links._dimensions, _CAMERA_FIELDS)):
        own = [geometry[part] for geometry in geometries]
        made.append({name: make([getattr(one, name) for one in own], n) for name, n in arrays})
    return Geometry(replace(first.links, **made[0]), first.cameras.replaced(**made[1]))


def parameters_of(geometry: Geometry, reference: Geometry | None = None) -> Parameters:
    """Flatten a geometry; rotation vectors are relative to `reference`, by default to itself."""
    parameters = _parameters(geometry)
    if reference is not None and reference.links.parameters != geometry.links.parameters:
        raise ConfigurationError(
            f"about: expected a head with the joints {geometry.links.joints} in the same parts, "
            f"got one with {reference.links.joints}"
        )
    fields = _fields(geometry, reference)
    batch = np.broadcast_shapes(*(field.shape[:-1] for field in fields.values()))
    values = np.empty((*batch, len(parameters)))
    for place, one in enumerate(parameters):
        values[..., place] = fields[one.field][..., one.column]
    names, units, *_ = zip(*parameters, strict=True)
    return Parameters(names, units, values)


def geometry_with(reference: Geometry, values: ArrayLike) -> Geometry:
    """Rebuild a geometry from (..., n) `parameters_of`; the neck is copied from the reference."""
    parameters, (links, cameras) = _parameters(reference), reference
    vector = as_operand("values", values, len(parameters))
    batch = vector.shape[:-1]
    fields = {
        name: np.broadcast_to(field, (*batch, field.shape[-1])).copy()
        for name, field in _fields(reference, None).items()
    }
    for place, one in enumerate(parameters):
        fields[one.field][..., one.column] = vector[..., place]
    pinholes = {name: fields[name].reshape(*batch, 2, -1) for name in _PINHOLE}
    pose = _moved_poses(cameras.pose, "", fields)
    return Geometry(links.with_fields(fields), cameras.replaced(**pinholes, pose=pose))


def _parameters(geometry: Geometry) -> tuple[Parameter, ...]:
    left, right = (_pose_parameters(f"{eye}.head_eye", "", i) for i, eye in enumerate(EYE_NAMES))
    return (*geometry.links.parameters, *left, *right, *geometry.cameras.parameters)


def _fields(geometry: Geometry, reference: Geometry | None) -> dict[str, FloatArray]:
    """Every field that holds parameters, by name, with its own dimensions flattened."""
    links, cameras = geometry
    about = None if reference is None else reference.cameras.pose
    pairs = ((name, getattr(cameras, name)) for name in _PINHOLE)
    return {
        **links.fields(links if reference is None else reference.links),
        **{name: pair.reshape(*pair.shape[:-2], 2 * pair.shape[-1]) for name, pair in pairs},
        **_pose_fields("", cameras.pose, about),
    }
