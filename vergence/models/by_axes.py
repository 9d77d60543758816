"""Conversion of a head to joint axes, see `JointAxes`."""

from dataclasses import replace
from typing import Final

import numpy as np

from vergence.models.head import HeadModel
from vergence.models.joint_axes import JointAxes
from vergence.models.joints import NECK
from vergence.models.links import multiply_poses

_DROPPED_KEY_PREFIXES: Final = ("links", "eyes")
"""Prefixes of assumption keys that refer to D-H numbers, which the converted head lacks."""


def dh_to_joint_axes(head: HeadModel) -> HeadModel:
    """Convert a head with D-H links to one with a free axis per joint; its geometry stays."""
    if isinstance(head.links, JointAxes):
        return head
    bodies = head.links.bodies()
    links = JointAxes(
        names=tuple(body.name for body in bodies),
        parts=tuple(_part(body.joints) for body in bodies),
        pose=np.array([body.pose for body in bodies]),
        frame=head.links.frame_n_pose(),
    )
    mounts = np.array([head.links.camera_mount(eye) for eye in range(2)])
    record = head.calibration
    if record is not None:
        cameras = {name: each for name, each in record.sigma.items() if ".camera." in name}
        record = replace(record, sigma=cameras)
    return replace(
        head,
        links=links,
        head_eye=multiply_poses(mounts, head.head_eye),
        calibration=record,
        assumptions={
            key: why
            for key, why in head.assumptions.items()
            if not key.startswith(_DROPPED_KEY_PREFIXES)
        },
    )


def _part(joints: tuple[int, ...]) -> str:
    if joints[0] < NECK.stop:
        return "neck"
    return "both" if len(joints) > 1 else ("left", "right")[(joints[0] - NECK.stop) // 2]
