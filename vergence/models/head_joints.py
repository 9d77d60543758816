"""Joints, frame N and actuators in a head file: read, checked and written.

Joints go from the base outwards. Each is given by its origin and axis in the frame of the one
before, as in a URDF, or by a row of modified D-H numbers.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from math import atan2, hypot, inf, nan
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.camera import Cameras
from vergence.models.geometry import (
    PARTS,
    DenavitHartenberg,
    JointAxes,
    Links,
    dh_pose,
    multiply_poses,
)
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, LINKS, Actuators, FloatArray, JointLimits
from vergence.models.toml_table import Rule, Table

METRES: Final[Rule] = (lambda x: abs(x) < 1.0, "metres below 1 in size (is it in millimetres?)")
LENGTH: Final[Rule] = (lambda x: abs(x) < 3.0, "metres below 3 in size (is it in millimetres?)")
RADIANS: Final[Rule] = (lambda x: abs(x) < 6.3, "radians below 6.3 in size (is it in degrees?)")
_FACTOR: Final[Rule] = (lambda x: abs(x) <= 1.0 + 1e-9, "an element of a rotation matrix, -1 to 1")
SPEED: Final[Rule] = (lambda x: 0.0 < x < 100.0, "rad/s above 0 and below 100 (is it in degrees?)")
ACCELERATION: Final[Rule] = (lambda x: x > 0.0, "rad/s^2 above 0, or inf for no limit")
SECONDS: Final[Rule] = (lambda x: 0.0 <= x < 1.0, "seconds, 0 to 1 (is it in milliseconds?)")
SIGMA: Final[Rule] = (lambda x: 0.0 <= x < 100.0, "a number from 0 to 100")
STEP: Final[Rule] = (lambda x: 0.0 <= x < 0.05, "radians, 0 to 0.05 (is it in degrees?)")
_UNIT: Final[Rule] = (lambda x: abs(x) <= 10.0, "up to 10 in size, as in the direction [0, 0, 1]")
_RATIO: Final[Rule] = (
    lambda x: 0.0 < abs(x) <= 10.0,
    "radians of the joint per radian of the actuator, not 0, up to 10 in size",
)

_LIMITS: Final[dict[str, tuple[str, Rule]]] = {
    "lower_rad": ("lower", RADIANS),
    "upper_rad": ("upper", RADIANS),
    "velocity_rad_s": ("velocity", SPEED),
    "acceleration_rad_s2": ("acceleration", ACCELERATION),
}
"""Limits of a joint or an actuator: field of `JointLimits` and `Actuators`, and rule, by key."""
_DH_ROW: Final[dict[str, tuple[str, Rule]]] = {
    "alpha_rad": ("alpha", RADIANS),
    "a_m": ("a", METRES),
    "d_m": ("d", METRES),
    "offset_rad": ("offset", RADIANS),
}
"""A row of modified (Craig) D-H numbers: field of `DenavitHartenberg`, and rule, by key."""
_ACTUATOR_OWN: Final = {
    "lag_s": (SECONDS, nan),
    "encoder_resolution_rad": (STEP, nan),
    "velocity_resolution_rad_s": (SIGMA, nan),
    "backlash_rad": (STEP, 0.0),
}
"""Optional fields of an actuator that override the head's timing or sensor: rule, and default."""
_ORDER: Final = {"neck": 0, "both": 1, "left": 2, "right": 2}
"""Place of a joint in a file, by its part."""
_MOST_JOINTS: Final = (
    ("neck", ("neck",), 3, ""),
    *((f"{eye} eye", ("both", eye), 2, " in an eye's chain") for eye in EYE_NAMES),
)
"""Greatest number of joints of the neck and in an eye's chain, with the parts of these joints."""


class _Joint(NamedTuple):
    name: str
    part: str
    pose: FloatArray  # (4, 4) in the previous joint, z along its axis
    limits: dict[str, float] | None  # by field; None if they follow from the actuators
    row: dict[str, float] | None  # D-H numbers by field, if it is given by them


def _read_row(table: Table, keys: Mapping[str, tuple[str, Rule]]) -> dict[str, float]:
    """Numbers by field."""
    return {field: table.number(key, rule) for key, (field, rule) in keys.items()}


def _written_row(part: Any, keys: Mapping[str, tuple[str, Rule]], place: int) -> dict[str, float]:
    """Numbers by key, of one joint, link or actuator."""
    return {key: float(getattr(part, field)[place]) for key, (field, _) in keys.items()}


def _columns(rows: Sequence[Mapping[str, float] | None]) -> dict[str, Any]:
    """(n,) numbers of the rows by field."""
    return {field: [row[field] for row in rows if row] for field in rows[0] or ()}


def read_joints(
    root: Table, cameras: Cameras, last_rows: Sequence[dict[str, float] | None]
) -> dict[str, Any]:
    """Joints, frame N and actuators, and cameras in their links, as arguments of `HeadModel`."""
    joints, last = _read_joint_tables(root)
    if not joints:  # perhaps the joints stand under a misspelt key: refuse unknown ones now
        root.close(
            ("frame", "actuators", "timing", "sensor", "rendering", "assumptions", "calibration")
        )
    if any(row is not None for row in last_rows):
        links = _dh_links(joints, last_rows)
        limits = _limits_of_joints(links, joints, None)
        return {"links": links, "cameras": cameras, "limits": limits}
    mounts = [multiply_poses(last[eye], cameras[i].pose) for i, eye in enumerate(EYE_NAMES)]
    # N is fixed to the neck's last link, whose frame is rotated from that of the neck's last joint
    axes = JointAxes(
        names=tuple(joint.name for joint in joints),
        parts=tuple(joint.part for joint in joints),
        pose=np.array([joint.pose for joint in joints]).reshape(-1, 4, 4),
        frame=last["neck"],
    )
    if root.has("frame"):
        table = root.table("frame")
        frame = read_pose(table, "origin_m")
        table.close()
    else:
        poses = axes.constant_poses()
        chains = [multiply_poses(*poses[4:7], mounts[0]), multiply_poses(*poses[7:], mounts[1])]
        frame = frame_between_cameras(np.stack(chains))
    axes = dataclasses.replace(axes, frame=multiply_poses(last["neck"], frame))
    actuators = _read_actuators(root, axes.joints[EYES])
    return {
        "links": axes,
        "cameras": cameras.replaced(pose=np.stack(mounts)),
        "limits": _limits_of_joints(axes, joints, actuators),
        "actuators": actuators,
    }


def _read_joint_tables(root: Table) -> tuple[list[_Joint], dict[str, FloatArray]]:
    """Joints from the base outwards; (4, 4) last links in their joints' frames, by neck and eye."""
    joints: list[_Joint] = []
    last = dict.fromkeys(("neck", *EYE_NAMES), np.eye(4))
    for table in root.tables("joints") if root.has("joints") else []:
        name = table.text("name", "a joint's name")
        known = [joint.name for joint in joints]
        table.expect(name not in known, "name", name, "a name that no other joint has")
        part = table.choice("part", PARTS)
        in_order = not joints or _ORDER[joints[-1].part] <= _ORDER[part]
        expected = "the neck's joints first, then both eyes', then those of one"
        table.expect(in_order, "part", part, expected)
        before = last["left" if part == "both" else part]
        row = read_dh_row(table)
        pose, out = (dh_pose(**row), np.eye(4)) if row else _read_joint_pose(table)
        pose = multiply_poses(before, pose)
        limits = _read_limits(table, name) if any(table.has(key) for key in _LIMITS) else None
        joints.append(_Joint(name, part, pose, limits, row))
        last |= dict.fromkeys({"neck": tuple(last), "both": EYE_NAMES}.get(part, (part,)), out)
        table.close()
    for owner, own, most, where in _MOST_JOINTS:
        count = sum(joint.part in own for joint in joints)
        if count > most:
            raise HeadFileError("joints", f"{count} of the {owner}", f"at most {most}{where}")
    return joints, last


def read_dh_row(table: Table) -> dict[str, float] | None:
    """D-H numbers of a joint or of an eye's last link, by the fields of `DenavitHartenberg`."""
    return _read_row(table, _DH_ROW) if table.has("alpha_rad") else None


def _dh_links(
    joints: Sequence[_Joint], last_rows: Sequence[dict[str, float] | None]
) -> DenavitHartenberg:
    """Links of a head whose seven joints and both eyes are given by D-H rows alone."""
    rows = [joint.row for joint in joints]
    rows = [*rows[:5], last_rows[0], *rows[5:], last_rows[1]]
    named = [(joint.name, joint.part) for joint in joints]
    if named != list(zip(JOINTS, DenavitHartenberg.parts, strict=True)) or None in rows:
        raise HeadFileError(
            "eyes.alpha_rad",
            f"joints {', '.join(joint.name for joint in joints) or 'none'}",
            f"D-H numbers of the joints {', '.join(JOINTS)} and of both eyes, or of no eye",
        )
    return DenavitHartenberg(**_columns(rows))


def _read_joint_pose(table: Table) -> tuple[FloatArray, FloatArray]:
    """Pose of a joint, z along its axis, and in that frame the pose of the link that it moves."""
    pose = read_pose(table, "origin_m")
    axis = table.numbers("axis", (3,), _UNIT)
    length = hypot(*axis)
    table.expect(length > 1e-6, "axis", axis.tolist(), "a direction")
    x, y, z = axis / length
    turn = np.eye(4)  # the smallest rotation that takes z to the axis
    if aside := hypot(x, y):
        from scipy.spatial.transform import Rotation

        about = np.array([-y, x, 0.0])
        turn[:3, :3] = Rotation.from_rotvec(atan2(aside, z) * about / aside).as_matrix()
    elif z < 0.0:
        turn[[1, 2], [1, 2]] = -1.0
    return multiply_poses(pose, turn), turn.T


def read_pose(table: Table, position_key: str) -> FloatArray:
    """(4, 4) a pose, m, from a position and an optional `rotation` (3, 3) or `rpy_rad` (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = table.numbers(position_key, (3,), LENGTH)
    if table.has("rpy_rad"):
        alone = not table.has("rotation")
        table.expect(alone, "rotation", "both", "one of rotation and rpy_rad")
        from scipy.spatial.transform import Rotation

        roll, pitch, yaw = table.numbers("rpy_rad", (3,), RADIANS)
        pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    elif table.has("rotation"):
        pose[:3, :3] = read_rotation(table, "rotation")
    return pose


def read_rotation(table: Table, key: str) -> FloatArray:
    """(3, 3) a rotation matrix."""
    rotation = table.numbers(key, (3, 3), _FACTOR)
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    fits = off <= 1e-9 and np.linalg.det(rotation) >= 0
    expected = "a rotation matrix, orthonormal to 1e-9 with determinant 1"
    table.expect(fits, key, rotation.tolist(), expected)
    return rotation


def pose_fields(position_key: str, pose: FloatArray) -> dict[str, Any]:
    """Fields of a pose: position and rotation."""
    return {position_key: pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist()}


def _read_limits(table: Table, owner: str) -> dict[str, float]:
    """Limits of a joint or an actuator, by field."""
    limits = _read_row(table, _LIMITS)
    _refuse_empty_range(owner, limits["lower"], limits["upper"])
    return limits


def _refuse_empty_range(owner: str, lower: float, upper: float) -> None:
    if not lower < upper:
        raise HeadFileError(
            f"limits of {owner}", [float(lower), float(upper)], "lower_rad below upper_rad"
        )


def _limits_of_joints(
    links: Links, joints: Sequence[_Joint], actuators: Actuators | None
) -> JointLimits:
    """Limits of the seven joints: those in the file, or else the range that the actuators reach."""
    seven = np.zeros((4, len(JOINTS)))
    seven[3] = inf
    for joint, places in zip(joints, links.joint_indices, strict=True):
        eye = places[0] - EYES.start
        if joint.limits is not None:
            seven[:, places] = np.array([*joint.limits.values()])[:, None]
        elif actuators is None or eye < 0:
            missing = f"{', '.join(_LIMITS)} (the keys are missing)"
            raise HeadFileError(f"joints {joint.name}", None, missing)
        else:
            row = actuators.matrix[eye]
            ends = np.stack([row * actuators.lower, row * actuators.upper])
            seven[0, places] = actuators.offset[eye] + ends.min(axis=0).sum()
            seven[1, places] = actuators.offset[eye] + ends.max(axis=0).sum()
            seven[2, places] = np.abs(row) @ actuators.velocity
            used = row != 0.0
            seven[3, places] = np.abs(row[used]) @ actuators.acceleration[used]
    return JointLimits(**dict(zip((field for field, _ in _LIMITS.values()), seven, strict=True)))


def read_numbered_links(root: Table) -> dict[str, Any]:
    """Links and limits of older files of the article's head: nine `[[links]]`, and `[limits]`."""
    rows = []
    for table, link in zip(root.tables("links", 9), LINKS, strict=True):
        for key, expected in zip(("frame", "parent", "joint"), link, strict=True):
            table.require_equal(key, expected)
        rows.append(_read_row(table, _DH_ROW))
        table.close()
    table = root.table("limits")
    limits = {field: table.numbers(key, (7,), rule) for key, (field, rule) in _LIMITS.items()}
    table.close()
    for joint, lower, upper in zip(JOINTS, limits["lower"], limits["upper"], strict=True):
        _refuse_empty_range(joint, lower, upper)
    return {"links": DenavitHartenberg(**_columns(rows)), "limits": JointLimits(**limits)}


def _read_actuators(root: Table, eyes: Sequence[str]) -> Actuators | None:
    """Actuators of the eyes' joints, given by name; None if each joint has its own.

    Each table gives the ratio of joint angle to actuator angle for every joint that it moves, such
    as `joints = { left_pan = 0.5, right_pan = -0.5 }`.
    """
    if not root.has("actuators"):
        return None
    tables = root.tables("actuators")
    if not 1 <= len(tables) <= 4:
        raise HeadFileError("actuators", f"{len(tables)} tables", "1 to 4 tables [[actuators]]")
    names: list[str] = []
    rows: list[dict[str, float]] = []
    matrix, offset = np.zeros((4, len(tables))), np.zeros(4)
    for k, table in enumerate(tables):
        name = table.text("name", "an actuator's name")
        table.expect(name not in names, "name", name, "a name that no other actuator has")
        names.append(name)
        moves = table.table("joints")
        known = ", ".join(dict.fromkeys(filter(None, eyes)))
        for joint in moves.names():
            moves.expect(joint in eyes, joint, joint, f"a joint of the eyes: {known}")
            matrix[np.array(eyes) == joint, k] = moves.number(joint, _RATIO)
        limits = _read_limits(table, name)
        own = {
            field: table.number(field, rule) if table.has(field) else default
            for field, (rule, default) in _ACTUATOR_OWN.items()
        }
        rows.append(limits | own)
        table.close()
    if root.has("joint_offsets_rad"):
        offsets = root.table("joint_offsets_rad")
        for joint in offsets.names():
            offsets.expect(joint in eyes, joint, None, "a joint of the eyes")
            offset[np.array(eyes) == joint] = offsets.number(joint, RADIANS)
    still = sorted({each for each, row in zip(eyes, matrix, strict=True) if each and not row.any()})
    if still:
        raise HeadFileError(
            "actuators",
            f"none that moves {', '.join(still)}",
            "an actuator for each joint of the eyes (or no [[actuators]]: then each has its own)",
        )
    if np.linalg.matrix_rank(matrix) < len(tables):
        raise HeadFileError(
            "actuators", matrix.tolist(), "actuators none of which does what others can do"
        )
    return Actuators(names=tuple(names), matrix=matrix, offset=offset, **_columns(rows))


def written_joints(head: HeadModel) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Frame N, joints and actuators as tables by key; the D-H numbers of both eyes' last links."""
    links = head.links
    frame: dict[str, Any] = {}
    last: list[dict[str, Any]] = [{}, {}]
    if isinstance(links, DenavitHartenberg):
        rows = [_written_row(links, _DH_ROW, i) for i in range(len(LINKS))]
        last = [rows.pop(5), rows.pop()]
    else:
        frame = pose_fields("origin_m", links.frame)
        rows = [pose_fields("origin_m", pose) | {"axis": [0.0, 0.0, 1.0]} for pose in links.pose]
    joints = [
        {"name": name, "part": part, **row, **_written_row(head.limits, _LIMITS, places[0])}
        for name, part, row, places in zip(
            links.names, links.parts, rows, links.joint_indices, strict=True
        )
    ]
    return {"frame": frame, "joints": joints, **_written_actuators(head)}, last


def _written_actuators(head: HeadModel) -> dict[str, Any]:
    """Tables of the actuators; none if each joint has its own."""
    actuators, eyes = head.actuators, head.joints[EYES]
    if actuators is None:
        return {}
    tables = []
    for k, name in enumerate(actuators.names):
        ratios = zip(eyes, actuators.matrix[:, k].tolist(), strict=True)
        own = {field: float(getattr(actuators, field)[k]) for field in _ACTUATOR_OWN}
        tables.append(
            {"name": name, "joints": {joint: ratio for joint, ratio in ratios if ratio}}
            | _written_row(actuators, _LIMITS, k)
            | {field: value for field, value in own.items() if np.isfinite(value)}
        )
    offsets = zip(eyes, actuators.offset.tolist(), strict=True)
    named = {joint: offset for joint, offset in offsets if joint}
    return {"actuators": tables, "joint_offsets_rad": named if actuators.offset.any() else {}}


def frame_between_cameras(camera_poses: FloatArray) -> FloatArray:
    """(4, 4) default N of (2, 4, 4) cameras: midway, z along their mean axis, x to the right."""
    forward = camera_poses[:, :3, 2].sum(axis=0)
    across = camera_poses[1, :3, 3] - camera_poses[0, :3, 3]
    length = max(float((forward * forward).sum()), 1e-12)
    right = across - forward * float((forward * across).sum()) / length
    if not hypot(*across) > 1e-4:
        raise HeadFileError("eyes", "both at one place", "cameras at two places")
    if not (hypot(*forward) > 0.5 and hypot(*right) > 1e-4):
        cosine = np.clip(camera_poses[0, :3, 2] @ camera_poses[1, :3, 2], -1.0, 1.0)
        raise HeadFileError(
            "eyes",
            f"optical axes {np.degrees(np.arccos(cosine)):.0f} degrees apart and the right camera "
            f"{1000.0 * hypot(*right):.1f} mm beside the left one",
            "cameras side by side that look ahead when all joints are at zero, or N's pose in "
            "[frame]",
        )
    frame = np.eye(4)
    x, z = right / hypot(*right), forward / hypot(*forward)
    frame[:3] = np.column_stack([x, np.cross(z, x), z, camera_poses[:, :3, 3].mean(axis=0)])
    return frame
