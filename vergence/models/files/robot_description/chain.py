"""Kinematic chains of moving joints from a base to a camera; fixed joints merge into poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vergence.models.files.robot_description.mechanism import Joint, Mechanism
from vergence.models.parts import FloatArray


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A moving joint."""

    joint: Joint
    origin: FloatArray  # (4, 4) at its zero, in the previous joint's link, or the base


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """The moving joints from the base to a camera frame."""

    joints: tuple[ChainJoint, ...]  # from the base up
    camera_in_last_link: FloatArray  # (4, 4) in the last joint's link, or the base

    def pose(self, values: Mapping[str, float]) -> FloatArray:
        """T_base_frame, (4, 4), of the camera frame, at joint angles by name, rad."""
        pose = np.eye(4)
        for each in self.joints:
            turn = np.eye(4)
            turn[:3, :3] = each.joint.rotation(values[each.joint.name])
            pose = pose @ each.origin @ turn
        return np.asarray(pose @ self.camera_in_last_link)

    def axes(self, names: Sequence[str]) -> FloatArray:
        """(J, 3) axes of the named joints in the base's frame, at zero."""
        pose: FloatArray = np.eye(3)
        found: FloatArray = np.empty((0, 3))
        for each in self.joints:
            pose = pose @ each.origin[:3, :3]
            if each.joint.name in names:
                found = np.vstack([found, pose @ each.joint.axis])
        return found


@dataclass(frozen=True)
class JointPath:
    """Joints on the path from a base to a camera: up to the common ancestor, then down."""

    up: tuple[Joint, ...]
    down: tuple[Joint, ...]


def find_joint_path(mechanism: Mechanism, base: int, camera: int) -> JointPath:
    """Find the joints on the path from a base to a camera."""
    above, below = mechanism.ancestors(base), mechanism.ancestors(camera)
    frames = mechanism.frames
    return JointPath(
        up=tuple(j for i in above if i not in below for j in frames[i].joints),
        down=tuple(j for i in below if i not in above for j in frames[i].joints),
    )


def build_chain(
    mechanism: Mechanism, base: int, camera: int, fixed_values: Mapping[str, float]
) -> KinematicChain:
    """Build the chain of hinges from a base to a camera; fixed values in rad or m, by name."""
    above, below = mechanism.ancestors(base), mechanism.ancestors(camera)
    pending = np.linalg.inv(_still(mechanism, [i for i in above if i not in below], fixed_values))
    joints = []
    for index in (i for i in below if i not in above):
        frame = mechanism.frames[index]
        pending = pending @ frame.pose
        for joint in frame.joints:
            if joint.name in fixed_values:
                pending = pending @ joint.motion(fixed_values[joint.name])
                continue
            to_axis = np.eye(4)
            to_axis[:3, 3] = joint.anchor
            turned = np.eye(4)
            turned[:3, :3] = joint.rotation(-joint.reference)
            joints.append(ChainJoint(joint, pending @ to_axis @ turned))
            pending = np.linalg.inv(to_axis)
    return KinematicChain(tuple(joints), np.asarray(pending, dtype=np.float64))


def _still(mechanism: Mechanism, frames: Sequence[int], fixed: Mapping[str, float]) -> FloatArray:
    pose = np.eye(4)
    for index in frames:
        pose = pose @ mechanism.frames[index].pose
        for joint in mechanism.frames[index].joints:
            pose = pose @ joint.motion(fixed[joint.name])
    return pose
