"""Read and write joints, given by their axes, and frame N as TOML.

Heads other than the article's take this form: `[[joints]]` from the base outwards, each with its
origin and axis in the frame of the previous joint, as in a URDF, or with a row of modified D-H
parameters.
"""

from collections.abc import Sequence
from math import atan2, cos, hypot, sin
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.files.head_rules import (
    FACTOR,
    JOINT_LIMITS,
    LENGTH,
    LIMIT_FIELDS,
    LINK_FIELDS,
    RADIANS,
    UNIT,
)
from vergence.models.files.toml_table import Table
from vergence.models.joint_axes import PARTS, JointAxes
from vergence.models.joints import EYE_NAMES
from vergence.models.links import multiply_poses
from vergence.models.parts import FloatArray, JointLimits

_MAX_JOINTS: Final = {"neck": 3, "eye": 2}
"""Largest number of joints in the neck and in an eye's chain."""
_LIMIT_KEYS: Final = tuple(JOINT_LIMITS)


class ParsedJoints(NamedTuple):
    """Joints of a head file, from the base outwards, and where the last link of each chain is."""

    names: list[str]
    parts: list[str]
    pose: FloatArray
    """(J, 4, 4) pose of each joint in the previous one, z along its axis."""
    limits: list[FloatArray | None]
    """(4,) limits of each joint; None if they follow from the actuators."""
    last_link_poses: dict[str, FloatArray]
    """(4, 4) pose of the last link in the frame of its joint, for the neck and each eye."""


def parse_joints(root: Table) -> ParsedJoints:
    """Parse the joints of a head file."""
    names: list[str] = []
    parts: list[str] = []
    poses: list[FloatArray] = []
    limits: list[FloatArray | None] = []
    # the rotation from a joint's frame, z along its axis, to the frame of the link that it moves
    carried: dict[str, FloatArray] = {"neck": np.eye(4), "left": np.eye(4), "right": np.eye(4)}
    for table in root.tables("joints") if root.has("joints") else []:
        name = table.text("name", "a joint's name")
        if name in names:
            raise HeadFileError(table.key("name"), name, "a name that no other joint has")
        part = table.choice("part", PARTS)
        _refuse_order(table, parts, part)
        before = carried["left" if part == "both" else part]
        pose, out = _parse_pose(table)
        names.append(name)
        parts.append(part)
        poses.append(multiply_poses(before, pose))
        limits.append(_parse_limits(table, name))
        for chain in {"neck": tuple(carried), "both": EYE_NAMES}.get(part, (part,)):
            carried[chain] = out
        table.close()
    _refuse_crowd(parts)
    return ParsedJoints(names, parts, np.array(poses).reshape(-1, 4, 4), limits, carried)


def _refuse_order(table: Table, parts: Sequence[str], part: str) -> None:
    """Refuse joints out of order: the neck's first, then those of both eyes, then those of one."""
    allowed = {"neck": {"neck"}, "both": {"neck", "both"}}.get(part, set(PARTS))
    wrong = set(parts) - allowed
    if wrong:
        raise HeadFileError(
            table.key("part"), part, "the neck's joints first, then both eyes', then those of one"
        )


def _refuse_crowd(parts: Sequence[str]) -> None:
    if parts.count("neck") > _MAX_JOINTS["neck"]:
        raise HeadFileError("joints", f"{parts.count('neck')} of the neck", "at most 3")
    for eye in EYE_NAMES:
        own = parts.count("both") + parts.count(eye)
        if own > _MAX_JOINTS["eye"]:
            raise HeadFileError("joints", f"{own} of the {eye} eye", "at most 2 in an eye's chain")


def _parse_pose(table: Table) -> tuple[FloatArray, FloatArray]:
    """Pose of a joint, z along its axis, and in that frame the pose of the link that it moves."""
    if table.has("alpha_rad"):
        alpha, a, d, offset = (table.number(name, rule) for name, rule in LINK_FIELDS.items())
        ca, sa, co, so = cos(alpha), sin(alpha), cos(offset), sin(offset)
        # RotX(alpha) TransX(a) RotZ(offset) TransZ(d); RotZ and TransZ commute
        pose = np.array(
            [
                [co, -so, 0.0, a],
                [ca * so, ca * co, -sa, -sa * d],
                [sa * so, sa * co, ca, ca * d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        return pose, np.eye(4)
    pose = parse_pose(table, "origin_m")
    axis = table.numbers("axis", (3,), UNIT)
    length = hypot(*axis)
    if not length > 1e-6:
        raise HeadFileError(table.key("axis"), axis.tolist(), "a direction")
    turn = np.eye(4)
    turn[:3, :3] = _z_to(axis / length)
    back = np.eye(4)
    back[:3, :3] = turn[:3, :3].T
    return multiply_poses(pose, turn), back


def _z_to(axis: FloatArray) -> FloatArray:
    """(3, 3) smallest rotation that takes z to a direction."""
    x, y, z = axis
    if abs(x) + abs(y) == 0.0:  # exact, so that `joints_to_toml` is read back unchanged
        return np.eye(3) if z > 0.0 else np.diag([1.0, -1.0, -1.0])
    from scipy.spatial.transform import Rotation

    turn = np.array([-y, x, 0.0])
    angle = atan2(hypot(x, y), z)
    return np.asarray(Rotation.from_rotvec(angle * turn / hypot(x, y)).as_matrix())


def parse_pose(table: Table, position_key: str) -> FloatArray:
    """(4, 4) a pose, m, from a position and an optional `rotation` (3, 3) or `rpy_rad` (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = table.numbers(position_key, (3,), LENGTH)
    if table.has("rpy_rad"):
        if table.has("rotation"):
            raise HeadFileError(table.key("rotation"), "both", "one of rotation and rpy_rad")
        from scipy.spatial.transform import Rotation

        roll, pitch, yaw = table.numbers("rpy_rad", (3,), RADIANS)
        pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    elif table.has("rotation"):
        pose[:3, :3] = parse_rotation(table, "rotation")
    return pose


def parse_rotation(table: Table, key: str) -> FloatArray:
    """(3, 3) a rotation matrix."""
    rotation = table.numbers(key, (3, 3), FACTOR)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
        raise HeadFileError(
            table.key(key),
            rotation.tolist(),
            "a rotation matrix, orthonormal to 1e-9 with determinant 1",
        )
    return rotation


def _parse_limits(table: Table, name: str) -> FloatArray | None:
    if not any(table.has(field) for field in _LIMIT_KEYS):
        return None
    values = np.array([table.number(field, rule) for field, rule in JOINT_LIMITS.items()])
    refuse_empty_range(name, values)
    return values


def refuse_empty_range(name: str, limits: FloatArray) -> None:
    """Refuse an empty range; the first two numbers are its lower and upper end, rad."""
    if not limits[0] < limits[1]:
        raise HeadFileError(
            f"limits of {name}", [float(limits[0]), float(limits[1])], "lower_rad below upper_rad"
        )


def parse_frame_n(root: Table) -> FloatArray | None:
    """(4, 4) frame N in the neck's last link; None if the file does not give it."""
    if not root.has("frame"):
        return None
    table = root.table("frame")
    frame = parse_pose(table, "origin_m")
    table.close()
    return frame


def frame_between_cameras(camera_poses: FloatArray) -> FloatArray:
    """(4, 4) default N of (2, 4, 4) cameras: midway, z along their mean axis, x to the right."""
    forward = camera_poses[:, :3, 2].sum(axis=0)
    across = camera_poses[1, :3, 3] - camera_poses[0, :3, 3]
    length = max(float((forward * forward).sum()), 1e-12)
    right = across - forward * float((forward * across).sum()) / length
    if not hypot(*across) > 1e-4:
        raise HeadFileError("eyes", "both at one place", "cameras at two places")
    if not (hypot(*forward) > 0.5 and hypot(*right) > 1e-4):
        between = np.degrees(
            np.arccos(np.clip(camera_poses[0, :3, 2] @ camera_poses[1, :3, 2], -1.0, 1.0))
        )
        raise HeadFileError(
            "eyes",
            f"optical axes {between:.0f} degrees apart and the right camera "
            f"{1000.0 * hypot(*right):.1f} mm beside the left one",
            "cameras side by side that look ahead when all joints are at zero, or N's pose in "
            "[frame]",
        )
    frame = np.eye(4)
    frame[:3, 2] = forward / hypot(*forward)
    frame[:3, 0] = right / hypot(*right)
    frame[:3, 1] = np.cross(frame[:3, 2], frame[:3, 0])
    frame[:3, 3] = camera_poses[:, :3, 3].mean(axis=0)
    return frame


def joints_to_toml(links: JointAxes, limits: JointLimits) -> dict[str, Any]:
    """Write the tables of joints and frame N; `parse_joints` and `parse_frame_n` read them back."""
    tables: dict[str, Any] = {
        "frame": {
            "origin_m": links.frame[:3, 3].tolist(),
            "rotation": links.frame[:3, :3].tolist(),
        }
    }
    if links.names:
        tables["joints"] = [
            {
                "name": name,
                "part": part,
                "origin_m": pose[:3, 3].tolist(),
                "rotation": pose[:3, :3].tolist(),
                "axis": [0.0, 0.0, 1.0],
                **{
                    key: float(getattr(limits, own)[places[0]]) for key, own in LIMIT_FIELDS.items()
                },
            }
            for name, part, places, pose in zip(
                links.names, links.parts, links.joint_indices, links.pose, strict=True
            )
        ]
    return tables
