"""Joints, frame N and actuators in a head file: read, checked and written.

Joints go from the base outwards. Each is given by its origin and axis in the frame of the one
before, as in a URDF, or by a row of modified D-H numbers.
"""

import dataclasses
from collections.abc import Sequence
from math import atan2, hypot
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.camera import Cameras
from vergence.models.geometry import PARTS, DenavitHartenberg, JointAxes, dh_pose, multiply_poses
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, EYES, JOINTS, LINKS, Actuators, FloatArray, JointLimits
from vergence.models.toml_table import Rule, Table

METRES: Final[Rule] = (lambda x: abs(x) < 1.0, "metres below 1 in size (is it in millimetres?)")
LENGTH: Final[Rule] = (lambda x: abs(x) < 3.0, "metres below 3 in size (is it in millimetres?)")
RADIANS: Final[Rule] = (lambda x: abs(x) < 6.3, "radians below 6.3 in size (is it in degrees?)")
_FACTOR: Final[Rule] = (lambda x: abs(x) <= 1.0 + 1e-9, "an element of a rotation matrix, -1 to 1")
SPEED: Final[Rule] = (lambda x: 0.0 < x < 100.0, "rad/s, 0 to 100 (is it in degrees?)")
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
    "lag_s": SECONDS,
    "encoder_resolution_rad": STEP,
    "velocity_resolution_rad_s": SIGMA,
    "backlash_rad": STEP,
}
"""Optional fields of an actuator that override the head's timing or sensor."""
_MAX_JOINTS: Final = {"neck": 3, "eye": 2}
"""Largest number of joints in the neck and in an eye's chain."""


class _Joints(NamedTuple):
    """Joints of a file, from the base outwards, and where the last link of each chain is."""

    names: list[str]
    parts: list[str]
    pose: FloatArray  # (J, 4, 4) of each joint in the previous one, z along its axis
    limits: list[FloatArray | None]  # (4,); None if they follow from the actuators
    last_link_poses: dict[str, FloatArray]  # (4, 4) in the frame of its joint, by neck and eye
    rows: list[dict[str, float] | None]  # D-H numbers


def read_joints(
    root: Table, cameras: Cameras, last_rows: Sequence[dict[str, float] | None]
) -> dict[str, Any]:
    """Joints, frame N and actuators, and cameras in their links, as arguments of `HeadModel`."""
    joints = _read_joint_tables(root)
    if not joints.names:  # perhaps the joints stand under a misspelt key: refuse unknown ones now
        root.close(
            ("frame", "actuators", "timing", "sensor", "rendering", "assumptions", "calibration")
        )
    if any(row is not None for row in last_rows):
        links = _dh_links(joints, last_rows)
        limits = np.array([_given_limits(joints, i) for i in range(len(JOINTS))]).T
        return {"links": links, "cameras": cameras, "limits": _joint_limits(limits)}
    last = joints.last_link_poses
    mounts = [multiply_poses(last[eye], cameras[i].pose) for i, eye in enumerate(EYE_NAMES)]
    # N is fixed to the neck's last link, whose frame is rotated from that of the neck's last joint
    axes = JointAxes(
        names=tuple(joints.names), parts=tuple(joints.parts), pose=joints.pose, frame=last["neck"]
    )
    if root.has("frame"):
        table = root.table("frame")
        frame = read_pose(table, "origin_m")
        table.close()
    else:
        eyes = [axes.constant_poses()[4 + 3 * eye : 7 + 3 * eye] for eye in range(2)]
        chains = [multiply_poses(m0, m1, m2, mounts[eye]) for eye, (m0, m1, m2) in enumerate(eyes)]
        frame = frame_between_cameras(np.stack(chains))
    axes = dataclasses.replace(axes, frame=multiply_poses(last["neck"], frame))
    actuators = _read_actuators(root, axes)
    return {
        "links": axes,
        "cameras": cameras.replaced(pose=np.stack(mounts)),
        "limits": _limits_of_joints(axes, joints, actuators),
        "actuators": actuators,
    }


def _read_joint_tables(root: Table) -> _Joints:
    joints = _Joints(
        [], [], np.empty((0, 4, 4)), [], dict.fromkeys(("neck", *EYE_NAMES), np.eye(4)), []
    )
    poses: list[FloatArray] = []
    # the rotation from a joint's frame, z along its axis, to the frame of the link that it moves
    last = joints.last_link_poses
    for table in root.tables("joints") if root.has("joints") else []:
        name = table.text("name", "a joint's name")
        if name in joints.names:
            raise table.error("name", name, "a name that no other joint has")
        part = table.choice("part", PARTS)
        _refuse_order(table, joints.parts, part)
        before = last["left" if part == "both" else part]
        row = read_dh_row(table) if table.has("alpha_rad") else None
        pose, out = _read_joint_pose(table) if row is None else (dh_pose(**row), np.eye(4))
        poses.append(multiply_poses(before, pose))
        joints.names.append(name)
        joints.parts.append(part)
        joints.limits.append(_read_joint_limits(table, name))
        joints.rows.append(row)
        for chain in {"neck": tuple(last), "both": EYE_NAMES}.get(part, (part,)):
            last[chain] = out
        table.close()
    _refuse_crowd(joints.parts)
    return joints._replace(pose=np.array(poses).reshape(-1, 4, 4))


def read_dh_row(table: Table) -> dict[str, float]:
    """D-H numbers of a joint or of an eye's last link, by the fields of `DenavitHartenberg`."""
    return {field: table.number(key, rule) for key, (field, rule) in _DH_ROW.items()}


def _dh_links(joints: _Joints, last_rows: Sequence[dict[str, float] | None]) -> DenavitHartenberg:
    """Links of a head whose seven joints and both eyes are given by D-H rows alone."""
    tree = (*["neck"] * 3, *["left"] * 2, *["right"] * 2)
    rows = [*joints.rows[:5], last_rows[0], *joints.rows[5:], last_rows[1]]
    if tuple(joints.names) != JOINTS or tuple(joints.parts) != tree or None in rows:
        raise HeadFileError(
            "eyes.alpha_rad",
            f"joints {', '.join(joints.names) or 'none'}",
            f"D-H numbers of the joints {', '.join(JOINTS)} and of both eyes, or of no eye",
        )
    return DenavitHartenberg(
        **{field: [row[field] for row in rows if row] for field, _ in _DH_ROW.values()}  # type: ignore[arg-type]
    )


def _refuse_order(table: Table, parts: Sequence[str], part: str) -> None:
    """Refuse joints out of order: the neck's first, then those of both eyes, then those of one."""
    allowed = {"neck": {"neck"}, "both": {"neck", "both"}}.get(part, set(PARTS))
    if set(parts) - allowed:
        raise table.error(
            "part", part, "the neck's joints first, then both eyes', then those of one"
        )


def _refuse_crowd(parts: Sequence[str]) -> None:
    if parts.count("neck") > _MAX_JOINTS["neck"]:
        raise HeadFileError("joints", f"{parts.count('neck')} of the neck", "at most 3")
    for eye in EYE_NAMES:
        own = parts.count("both") + parts.count(eye)
        if own > _MAX_JOINTS["eye"]:
            raise HeadFileError("joints", f"{own} of the {eye} eye", "at most 2 in an eye's chain")


def _read_joint_pose(table: Table) -> tuple[FloatArray, FloatArray]:
    """Pose of a joint, z along its axis, and in that frame the pose of the link that it moves."""
    pose = read_pose(table, "origin_m")
    axis = table.numbers("axis", (3,), _UNIT)
    length = hypot(*axis)
    if not length > 1e-6:
        raise table.error("axis", axis.tolist(), "a direction")
    turn, back = np.eye(4), np.eye(4)
    turn[:3, :3] = _z_to(axis / length)
    back[:3, :3] = turn[:3, :3].T
    return multiply_poses(pose, turn), back


def _z_to(axis: FloatArray) -> FloatArray:
    """(3, 3) smallest rotation that takes z to a direction."""
    x, y, z = axis
    if abs(x) + abs(y) == 0.0:  # exact, so that what is written is read back unchanged
        return np.eye(3) if z > 0.0 else np.diag([1.0, -1.0, -1.0])
    from scipy.spatial.transform import Rotation

    turn = np.array([-y, x, 0.0])
    angle = atan2(hypot(x, y), z)
    return np.asarray(Rotation.from_rotvec(angle * turn / hypot(x, y)).as_matrix())


def read_pose(table: Table, position_key: str) -> FloatArray:
    """(4, 4) a pose, m, from a position and an optional `rotation` (3, 3) or `rpy_rad` (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = table.numbers(position_key, (3,), LENGTH)
    if table.has("rpy_rad"):
        if table.has("rotation"):
            raise table.error("rotation", "both", "one of rotation and rpy_rad")
        from scipy.spatial.transform import Rotation

        roll, pitch, yaw = table.numbers("rpy_rad", (3,), RADIANS)
        pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    elif table.has("rotation"):
        pose[:3, :3] = read_rotation(table, "rotation")
    return pose


def read_rotation(table: Table, key: str) -> FloatArray:
    """(3, 3) a rotation matrix."""
    rotation = table.numbers(key, (3, 3), _FACTOR)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
        raise table.error(
            key,
            rotation.tolist(),
            "a rotation matrix, orthonormal to 1e-9 with determinant 1",
        )
    return rotation


def pose_fields(position_key: str, pose: FloatArray) -> dict[str, Any]:
    """Fields of a pose: position and rotation."""
    return {position_key: pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist()}


def _read_limits(table: Table, owner: str) -> FloatArray:
    """(4,) limits of a joint or an actuator."""
    values = [table.number(key, rule) for key, (_, rule) in _LIMITS.items()]
    _refuse_empty_range(owner, values[0], values[1])
    return np.array(values)


def _read_joint_limits(table: Table, name: str) -> FloatArray | None:
    return _read_limits(table, name) if any(table.has(key) for key in _LIMITS) else None


def _refuse_empty_range(owner: str, lower: float, upper: float) -> None:
    if not lower < upper:
        raise HeadFileError(
            f"limits of {owner}", [float(lower), float(upper)], "lower_rad below upper_rad"
        )


def _joint_limits(rows: FloatArray) -> JointLimits:
    """Limits from rows (4, 7) in the order of a file's keys."""
    return JointLimits(
        **{field: row for (field, _), row in zip(_LIMITS.values(), rows, strict=True)}
    )


def _given_limits(joints: _Joints, place: int) -> FloatArray:
    own = joints.limits[place]
    if own is None:
        raise HeadFileError(
            f"joints {joints.names[place]}", None, f"{', '.join(_LIMITS)} (the keys are missing)"
        )
    return own


def _limits_of_joints(
    links: JointAxes, joints: _Joints, actuators: Actuators | None
) -> JointLimits:
    """Limits of the seven joints: those in the file, or else the range that the actuators reach."""
    seven = np.zeros((4, len(JOINTS)))
    seven[3] = np.inf
    for i, places in enumerate(links.joint_indices):
        if joints.limits[i] is not None or actuators is None or places[0] < EYES.start:
            seven[:, places] = _given_limits(joints, i)[:, None]
            continue
        row = actuators.matrix[places[0] - EYES.start]
        centre = actuators.offset[places[0] - EYES.start]
        ends = np.stack([row * actuators.lower, row * actuators.upper])
        seven[0, places] = centre + ends.min(axis=0).sum()
        seven[1, places] = centre + ends.max(axis=0).sum()
        seven[2, places] = np.abs(row) @ actuators.velocity
        used = row != 0.0
        seven[3, places] = np.abs(row[used]) @ actuators.acceleration[used]
    return _joint_limits(seven)


def read_numbered_links(root: Table) -> dict[str, Any]:
    """Links and limits of older files of the article's head: nine `[[links]]`, and `[limits]`."""
    columns: dict[str, list[float]] = {field: [] for field, _ in _DH_ROW.values()}
    for table, (frame, parent, joint) in zip(root.tables("links", 9), LINKS, strict=True):
        table.require_equal("frame", frame)
        table.require_equal("parent", parent)
        table.require_equal("joint", joint)
        for field, value in read_dh_row(table).items():
            columns[field].append(value)
        table.close()
    table = root.table("limits")
    rows = np.array([table.numbers(key, (7,), rule) for key, (_, rule) in _LIMITS.items()])
    table.close()
    for joint, lower, upper in zip(JOINTS, rows[0], rows[1], strict=True):
        _refuse_empty_range(joint, lower, upper)
    links = DenavitHartenberg(**columns)  # type: ignore[arg-type]
    return {"links": links, "limits": _joint_limits(rows)}


def _read_actuators(root: Table, links: JointAxes) -> Actuators | None:
    """Actuators of the eyes' joints; None if each joint has its own.

    Each table gives the ratio of joint angle to actuator angle for every joint that it moves, such
    as `joints = { left_pan = 0.5, right_pan = -0.5 }`.
    """
    if not root.has("actuators"):
        return None
    tables = root.tables("actuators")
    if not 1 <= len(tables) <= 4:
        raise HeadFileError("actuators", f"{len(tables)} tables", "1 to 4 tables [[actuators]]")
    eyes = links.joints[EYES]
    names: list[str] = []
    matrix, limits = np.zeros((4, len(tables))), np.zeros((4, len(tables)))
    own: dict[str, list[float]] = {field: [] for field in _ACTUATOR_OWN}
    for k, table in enumerate(tables):
        name = table.text("name", "an actuator's name")
        if name in names:
            raise table.error("name", name, "a name that no other actuator has")
        names.append(name)
        moves = table.table("joints")
        for joint in moves.names():
            places = [i for i, each in enumerate(eyes) if each == joint]
            if not places:
                known = ", ".join(dict.fromkeys(filter(None, eyes)))
                raise moves.error(joint, joint, f"a joint of the eyes: {known}")
            matrix[places, k] = moves.number(joint, _RATIO)
        limits[:, k] = _read_limits(table, name)
        for field, rule in _ACTUATOR_OWN.items():
            unsaid = 0.0 if field == "backlash_rad" else np.nan
            own[field].append(table.number(field, rule) if table.has(field) else unsaid)
        table.close()
    offset = np.zeros(4)
    if root.has("joint_offsets_rad"):
        offsets = root.table("joint_offsets_rad")
        for joint in offsets.names():
            places = [i for i, each in enumerate(eyes) if each == joint]
            if not places:
                raise offsets.error(joint, None, "a joint of the eyes")
            offset[places] = offsets.number(joint, RADIANS)
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
    columns = {field: row for (field, _), row in zip(_LIMITS.values(), limits, strict=True)}
    columns |= {field: np.array(values) for field, values in own.items()}
    return Actuators(names=tuple(names), matrix=matrix, offset=offset, **columns)


def limit_fields(limits: JointLimits | Actuators, place: int) -> dict[str, float]:
    """Fields of the limits of one joint or actuator."""
    return {key: float(getattr(limits, field)[place]) for key, (field, _) in _LIMITS.items()}


def written_joints(head: HeadModel) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Tables of the joints, and the D-H numbers of both eyes' last links, if D-H gives the head."""
    links = head.links
    if isinstance(links, DenavitHartenberg):
        rows = [
            {key: float(getattr(links, field)[i]) for key, (field, _) in _DH_ROW.items()}
            for i in range(len(LINKS))
        ]
        last = [rows.pop(5), rows.pop()]
        parts = (*["neck"] * 3, *["left"] * 2, *["right"] * 2)
        named = zip(JOINTS, parts, rows, range(len(JOINTS)), strict=True)
    else:
        assert isinstance(links, JointAxes)
        rows = [pose_fields("origin_m", pose) | {"axis": [0.0, 0.0, 1.0]} for pose in links.pose]
        last = [{}, {}]
        places = (indices[0] for indices in links.joint_indices)
        named = zip(links.names, links.parts, rows, places, strict=True)
    tables = [
        {"name": name, "part": part, **row, **limit_fields(head.limits, place)}
        for name, part, row, place in named
    ]
    return tables, last


def written_actuators(head: HeadModel) -> dict[str, Any]:
    """Tables of the actuators; none if each joint has its own."""
    actuators = head.actuators
    if actuators is None:
        return {}
    eyes = head.joints[EYES]
    tables = [
        {
            "name": name,
            "joints": {
                joint: float(factor)
                for joint, factor in zip(eyes, actuators.matrix[:, k], strict=True)
                if factor != 0.0
            },
            **limit_fields(actuators, k),
            **{
                field: float(value)
                for field in _ACTUATOR_OWN
                if np.isfinite(value := getattr(actuators, field)[k])
            },
        }
        for k, name in enumerate(actuators.names)
    ]
    offsets = zip(eyes, actuators.offset, strict=True)
    named = {joint: float(offset) for joint, offset in offsets if joint}
    return {"actuators": tables} | ({"joint_offsets_rad": named} if actuators.offset.any() else {})


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
