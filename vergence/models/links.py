"""Descriptions of a head's joint axes, from which all kinematics is computed.

A description states how the joints and their bodies are connected at the zero posture. There are
two: `DenavitHartenberg`, the article's nine links, and `JointAxes` (`vergence.models.joint_axes`),
which holds the pose of each joint in the frame of the one before, as a URDF does. Both implement
the protocol `Links`; kinematics, perturbation, calibration, drawing and export use only that.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from vergence.models.joints import EYE_NAMES, JOINTS, LINKS, NECK
from vergence.models.parts import FloatArray, FrozenArrays, Parameter

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
    field has the shape (..., 9) in the order of `vergence.models.joints.LINKS`.
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
