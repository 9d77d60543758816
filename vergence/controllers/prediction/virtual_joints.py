"""Joints that an eye lacks, made up so that any direction has its two angles.

The predictor tells where a target is by the two joint angles that would put it on the eye's optical
axis. An eye that cannot look everywhere, as one that only pans, gets joints for that which never
move: no actuator turns them.
"""

from collections.abc import Sequence

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joints import EYES
from vergence.models.links import inverse_pose
from vergence.models.packed import pack
from vergence.models.parts import FloatArray

_PARALLEL = 1e-3


def two_joints_an_eye(head: HeadModel) -> FloatArray:
    """A head's packed row with two joints for either eye.

    Args:
        head: the model of the head.

    Returns:
        (PACKED,) the head's own row where it has all four. At the angles that the head can have,
        with zero for joints that it lacks, cameras stand where they stand in it.
    """
    lacks = [not name for name in head.joints[EYES]]
    if not any(lacks):
        return head.packed
    poses = head.links.folded()
    for eye in range(2):
        first, second = lacks[2 * eye : 2 * eye + 2]
        before, between, after = poses[4 + 3 * eye : 7 + 3 * eye]
        after = after @ head.head_eye[eye]
        if first:  # then the second as well: a tilt and a pan about the camera's own axes
            camera = before @ between @ after
            tilt, pan = _about(camera, camera[:3, 0]), _about(camera, camera[:3, 1])
            before, between, after = tilt, inverse_pose(tilt) @ pan, inverse_pose(pan) @ camera
        elif second:
            camera = between @ after
            axis = np.cross([0.0, 0.0, 1.0], camera[:3, 2])
            across = _about(camera, axis if axis @ axis > _PARALLEL else camera[:3, 0])
            between, after = across, inverse_pose(across) @ camera
        poses[4 + 3 * eye : 7 + 3 * eye] = before, between, after
    return pack(poses, head.cameras, head.actuation, ())


def _about(camera: FloatArray, axis: Sequence[float] | FloatArray) -> FloatArray:
    """(4, 4) a frame in a camera's origin whose z axis is one across the optical axis."""
    pose = np.eye(4)
    z = np.asarray(axis) / np.linalg.norm(axis)
    x = camera[:3, 2] - (camera[:3, 2] @ z) * z
    x /= np.linalg.norm(x)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = x, np.cross(z, x), z
    pose[:3, 3] = camera[:3, 3]
    return pose
