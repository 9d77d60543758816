"""Virtual joints for eyes with fewer than two, so that every direction has two joint angles.

The predictor describes a target by the two joint angles that would put it on the eye's optical
axis. An eye that cannot look in every direction, such as one that only pans, gets virtual joints
for this; they never move, as no actuator turns them.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from vergence.models.geometry import inverse_pose
from vergence.models.head import HeadModel
from vergence.models.kinematics import pack_constants
from vergence.models.parts import EYES, FloatArray

_MAX_PARALLEL_SQUARED_SINE: Final = 1e-3
"""Squared sine below which the first joint's axis counts as parallel to the optical axis
(numerical)."""


def with_virtual_joints(head: HeadModel) -> FloatArray:
    """Pack a head with two joints in each eye.

    Args:
        head: the model of the head.

    Returns:
        (PACKED,) the head's own packed row if it has all four joints. Otherwise the cameras have
        the poses of the head itself at all its joint angles, with the virtual joints at zero.
    """
    lacks = [not name for name in head.joints[EYES]]
    if not any(lacks):
        return head.packed
    poses = head.links.constant_poses()
    for eye in range(2):
        first, second = lacks[2 * eye : 2 * eye + 2]
        before, between, after = poses[4 + 3 * eye : 7 + 3 * eye]
        after = after @ head.head_eye[eye]
        if first:  # then the second is missing too: tilt and pan about the camera's own axes
            camera = before @ between @ after
            tilt, pan = _about(camera, camera[:3, 0]), _about(camera, camera[:3, 1])
            before, between, after = tilt, inverse_pose(tilt) @ pan, inverse_pose(pan) @ camera
        elif second:
            camera = between @ after
            axis = np.cross([0.0, 0.0, 1.0], camera[:3, 2])
            across = _about(
                camera, axis if axis @ axis > _MAX_PARALLEL_SQUARED_SINE else camera[:3, 0]
            )
            between, after = across, inverse_pose(across) @ camera
        poses[4 + 3 * eye : 7 + 3 * eye] = before, between, after
    return pack_constants(poses, head.cameras.rows, head.actuation)


def _about(camera: FloatArray, axis: Sequence[float] | FloatArray) -> FloatArray:
    """(4, 4) frame at a camera's origin with its z axis along `axis`, across the optical axis."""
    pose = np.eye(4)
    z = np.asarray(axis) / np.linalg.norm(axis)
    x = camera[:3, 2] - (camera[:3, 2] @ z) * z
    x /= np.linalg.norm(x)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = x, np.cross(z, x), z
    pose[:3, 3] = camera[:3, 3]
    return pose
