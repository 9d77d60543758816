"""Joint axes of any head: each joint is described by its pose in the frame of the one before."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from vergence.models.joints import EYE_NAMES, JOINTS, NECK
from vergence.models.links import Body, inverse_pose, multiply_poses, pose_parameter_twists
from vergence.models.parts import FloatArray, FrozenArrays, Parameter

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
