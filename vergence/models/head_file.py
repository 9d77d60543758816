"""Read and write a head as TOML text; invalid heads are refused."""

import dataclasses
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib import resources
from math import atan2, cos, hypot, sin
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError, UnknownNameError, UnreadableFileError
from vergence.files import write_atomic
from vergence.models.actuation import Actuators
from vergence.models.camera import (
    EXPECTED,
    PINHOLE,
    Camera,
    CameraResponse,
    Cameras,
    Lens,
    camera_matrix,
    parse_response,
)
from vergence.models.geometry import PARTS, DenavitHartenberg, JointAxes, multiply_poses
from vergence.models.head import HeadModel
from vergence.models.lens import BROWN_CONRADY, LENSES
from vergence.models.parts import (
    ENCODER_SIDES,
    EYE_NAMES,
    EYES,
    JOINTS,
    LINKS,
    CalibrationRecord,
    FloatArray,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
)
from vergence.models.toml_table import Rule, Table, toml_text

_RESERVED: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""File names that Windows reserves for devices, with any suffix."""


def _is_name(text: str) -> bool:
    fits = re.fullmatch(r"\w([\w .-]{0,62}[\w-])?", text) is not None
    return fits and len(text.encode()) <= 128 and not _RESERVED.fullmatch(text)


NAME: Final[tuple[Callable[[str], bool], str]] = (
    _is_name,
    "a name that a file may have on any system: up to 64 letters, digits, '-', '_', '.' and "
    "spaces, a letter or digit first, no '.' or space last",
)
METRES: Final[Rule] = (lambda x: abs(x) < 1.0, "metres below 1 in size (is it in millimetres?)")
LENGTH: Final[Rule] = (lambda x: abs(x) < 3.0, "metres below 3 in size (is it in millimetres?)")
RADIANS: Final[Rule] = (lambda x: abs(x) < 6.3, "radians below 6.3 in size (is it in degrees?)")
PIXELS: Final[Rule] = (lambda x: abs(x) < 1e5, "pixels below 100000 in size")
FOCAL: Final[Rule] = (lambda x: 10.0 < x < 1e5, "a focal length in pixels, 10 to 100000")
COEFFICIENT: Final[Rule] = (lambda x: abs(x) < 10.0, "a distortion coefficient below 10 in size")
RATIO_COEFFICIENT: Final[Rule] = (
    lambda x: abs(x) < 1e4,
    "a distortion coefficient below 10000 in size",
)
FACTOR: Final[Rule] = (lambda x: abs(x) <= 1.0 + 1e-9, "an element of a rotation matrix, -1 to 1")
SPEED: Final[Rule] = (lambda x: 0.0 < x < 100.0, "rad/s, 0 to 100 (is it in degrees?)")
ACCELERATION: Final[Rule] = (lambda x: x > 0.0, "rad/s^2 above 0, or inf for no limit")
RATE: Final[Rule] = (lambda x: 1.0 <= x <= 10_000.0, "a rate in Hz, 1 to 10000")
SECONDS: Final[Rule] = (lambda x: 0.0 <= x < 1.0, "seconds, 0 to 1 (is it in milliseconds?)")
LATENCY: Final[Rule] = (lambda x: 0.0 <= x < 10.0, "seconds, 0 to 10 (is it in milliseconds?)")
SIGMA: Final[Rule] = (lambda x: 0.0 <= x < 100.0, "a number from 0 to 100")
STEP: Final[Rule] = (lambda x: 0.0 <= x < 0.05, "radians, 0 to 0.05 (is it in degrees?)")
UNIT: Final[Rule] = (lambda x: abs(x) <= 10.0, "up to 10 in size, as in the direction [0, 0, 1]")
RATIO: Final[Rule] = (
    lambda x: 0.0 < abs(x) <= 10.0,
    "radians of the joint per radian of the actuator, not 0, up to 10 in size",
)
PROBABILITY: Final[Rule] = (lambda x: 0.0 <= x < 1.0, "a probability from 0 to below 1")
NOT_NEGATIVE: Final[Rule] = (lambda x: x >= 0.0, "a number of at least 0")
POSITIVE: Final[Rule] = (lambda x: x > 0.0, "a number above 0")
GREY: Final[Rule] = (lambda x: 0.0 <= x <= 255.0, "a grey level, 0 to 255")
COUNT: Final[Rule] = (lambda x: 0 <= x <= 10_000, "a whole number, 0 to 10000")
SIZE: Final[Rule] = (lambda x: 16 <= x <= 20_000, "an image size in pixels, 16 to 20000")
SUPERSAMPLING: Final[Rule] = (lambda x: 1 <= x <= 16, "1 to 16")

DISTORTION: Final = {
    BROWN_CONRADY: COEFFICIENT,
    # one coefficient of a quotient, or of a narrow fisheye image, may be large and distort little
    "rational": RATIO_COEFFICIENT,
    "fisheye": RATIO_COEFFICIENT,
}
"""Rule for distortion coefficients by lens model."""
LINK_FIELDS: Final = {"alpha_rad": RADIANS, "a_m": METRES, "d_m": METRES, "offset_rad": RADIANS}
TIMING: Final = {"frame_rate_hz": RATE, "exposure_s": SECONDS, "lag_s": SECONDS}
"""Required fields of timing, besides the control rate and the latency.

Those two are read separately, since older files give the latency in control periods.
"""
TIMING_OPTIONS: Final = {"command_latency_s": SECONDS, "feedback_latency_s": SECONDS}
"""Optional fields of timing; 0 if a file leaves them out."""
SENSOR: Final = {
    "detection_noise_px": SIGMA,
    "encoder_resolution_rad": STEP,
    "velocity_resolution_rad_s": SIGMA,
    "dropped_frame_probability": PROBABILITY,
    "max_smear_px": POSITIVE,
}
SENSOR_OPTIONS: Final = {"command_resolution_rad_s": SIGMA, "backlash_rad": STEP}
"""Optional fields of the sensor; 0 if a file leaves them out."""
RENDERING: Final = {
    "blur_px": SIGMA,
    "noise_grey": SIGMA,
    "black_grey": GREY,
    "white_grey": GREY,
    "background_grey": GREY,
}
LIMITS: Final = {
    "lower_rad": RADIANS,
    "upper_rad": RADIANS,
    "velocity_rad_s": SPEED,
    "acceleration_rad_s2": ACCELERATION,
}
JOINT_LIMITS: Final = LIMITS
"""Limits of one joint or actuator, in the order of `JointLimits`."""
LIMIT_FIELDS: Final = {
    "lower_rad": "lower",
    "upper_rad": "upper",
    "velocity_rad_s": "velocity",
    "acceleration_rad_s2": "acceleration",
}
"""Fields of `JointLimits` and `Actuators` by the keys of a file."""
ACTUATOR_OWN: Final = {
    "lag_s": SECONDS,
    "encoder_resolution_rad": STEP,
    "velocity_resolution_rad_s": SIGMA,
    "backlash_rad": STEP,
}
"""Optional fields of an actuator that override the head's timing or sensor."""


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
        limits.append(_parse_joint_limits(table, name))
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


def _parse_joint_limits(table: Table, name: str) -> FloatArray | None:
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


def parse_eyes(root: Table) -> Cameras:
    """Cameras of a head file, each with its pose in the eye's last link."""
    image = _parse_size(root.table("image"), closing=True) if root.has("image") else None
    return Cameras(
        *(
            _parse_eye(table, name, image)
            for name, table in zip(EYE_NAMES, root.tables("eyes", 2), strict=True)
        )
    )


def _parse_eye(table: Table, name: str, image: tuple[int, int] | None) -> Camera:
    table.require_equal("name", name, "the left eye comes first, then the right one")
    width, height = _parse_eye_size(table, image)
    focal = table.numbers("focal_px", (2,), FOCAL)
    centre = table.numbers("principal_px", (2,), PIXELS)
    if not (0.0 < centre[0] < width and 0.0 < centre[1] < height):
        raise HeadFileError(
            table.key("principal_px"),
            centre.tolist(),
            f"a point inside the image of {width} x {height} px",
        )
    camera = Camera(
        size=(width, height),
        matrix=camera_matrix(focal, centre),
        lens=_parse_lens(table),
        response=_parse_response(table),
        pose=_parse_mount(table),
    )
    table.close()
    return camera


def _parse_size(table: Table, *, closing: bool = False) -> tuple[int, int]:
    size = table.integer("width_px", SIZE), table.integer("height_px", SIZE)
    if closing:
        table.close()
    return size


def _parse_eye_size(table: Table, image: tuple[int, int] | None) -> tuple[int, int]:
    if image is None:
        return _parse_size(table)
    for key in ("width_px", "height_px"):
        if table.has(key):
            raise HeadFileError(
                table.key(key),
                table.take(key, ""),
                "no size of the eye's own beside [image], which holds for both eyes",
            )
    return image


def _parse_lens(table: Table) -> Lens:
    """Lens model of a camera and its coefficients; a pinhole becomes Brown-Conrady with zeros."""
    said = table.has("lens")
    lens = table.choice("lens", [PINHOLE, *LENSES]) if said else BROWN_CONRADY
    if not said and table.has("distortion"):
        _refuse_unnamed(table)
    if lens != PINHOLE:
        return Lens(lens, table.numbers("distortion", (len(LENSES[lens]),), DISTORTION[lens]))
    if table.has("distortion"):
        given = table.take("distortion", "")
        if not isinstance(given, list) or any(value != 0 for value in given):
            raise HeadFileError(
                table.key("distortion"), given, f"zeros, or no such key, for lens = '{PINHOLE}'"
            )
    return Lens()


def _refuse_unnamed(table: Table) -> None:
    """Refuse coefficients without a lens name if their count fits a non-default model."""
    given = table.peek("distortion")
    for lens, coefficients in LENSES.items():
        if lens != BROWN_CONRADY and isinstance(given, list) and len(given) == len(coefficients):
            raise HeadFileError(
                table.key("distortion"),
                given,
                f"{len(LENSES[BROWN_CONRADY])} numbers, or lens = '{lens}' beside them",
            )


def _parse_response(table: Table) -> CameraResponse | None:
    if not table.has("response"):
        return None
    value = table.take("response", EXPECTED)
    try:
        return parse_response(value)
    except ConfigurationError as error:
        raise HeadFileError(table.key("response"), value, EXPECTED) from error


def _parse_mount(table: Table) -> FloatArray:
    """(4, 4) pose of a camera in its eye's last link."""
    if not table.has("head_eye_rotation"):
        return parse_pose(table, "position_m")
    mount = np.eye(4)
    mount[:3, :3] = parse_rotation(table, "head_eye_rotation")
    mount[:3, 3] = table.numbers("head_eye_translation_m", (3,), METRES)
    return mount


def eyes_to_toml(cameras: Cameras, mount_keys: tuple[str, str]) -> dict[str, Any]:
    """Write the tables `eyes` and, for images of one size, `image`."""
    rotation, position = mount_keys
    eyes = [
        {
            "name": name,
            **camera_fields(camera),
            **({} if camera.response is None else {"response": camera.response}),
            rotation: camera.pose[:3, :3].tolist(),
            position: camera.pose[:3, 3].tolist(),
        }
        for name, camera in zip(EYE_NAMES, cameras, strict=True)
    ]
    return size_fields(cameras, eyes)


def camera_fields(camera: Camera) -> dict[str, Any]:
    """Fields of a camera in `[[eyes]]`, but its image size, response and pose."""
    model, coefficients = camera.lens
    return {
        "focal_px": camera.focal.tolist(),
        "principal_px": camera.principal.tolist(),
        **({} if model == BROWN_CONRADY else {"lens": model}),
        "distortion": np.asarray(coefficients).tolist(),
    }


def size_fields(cameras: Sequence[Camera], eyes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Tables `image` and `eyes`, or `eyes` with the size of each where it differs."""
    left, right = ({"width_px": camera.width, "height_px": camera.height} for camera in cameras)
    if left == right:
        return {"image": left, "eyes": list(eyes)}
    return {
        "eyes": [
            {"name": eye["name"]} | size | eye
            for eye, size in zip(eyes, (left, right), strict=True)
        ]
    }


def parse_actuators(root: Table, links: JointAxes) -> Actuators | None:
    """Read the actuators of a head file; None if each joint has its own."""
    if not root.has("actuators"):
        return None
    tables = root.tables("actuators")
    if not 1 <= len(tables) <= 4:
        raise HeadFileError("actuators", f"{len(tables)} tables", "1 to 4 tables [[actuators]]")
    eyes = links.joints[EYES]
    names: list[str] = []
    matrix, offset = np.zeros((4, len(tables))), np.zeros(4)
    columns: dict[str, list[float]] = {field: [] for field in (*JOINT_LIMITS, *ACTUATOR_OWN)}
    for k, table in enumerate(tables):
        name = table.text("name", "an actuator's name")
        if name in names:
            raise HeadFileError(table.key("name"), name, "a name that no other actuator has")
        names.append(name)
        moves = table.table("joints")
        for joint in moves.names():
            places = [i for i, own in enumerate(eyes) if own == joint]
            if not places:
                known = ", ".join(dict.fromkeys(filter(None, eyes)))
                raise HeadFileError(moves.key(joint), joint, f"a joint of the eyes: {known}")
            matrix[places, k] = moves.number(joint, RATIO)
        for field, rule in JOINT_LIMITS.items():
            columns[field].append(table.number(field, rule))
        refuse_empty_range(name, np.array([columns["lower_rad"][-1], columns["upper_rad"][-1]]))
        for field, rule in ACTUATOR_OWN.items():
            given = table.number(field, rule) if table.has(field) else np.nan
            columns[field].append(0.0 if field == "backlash_rad" and np.isnan(given) else given)
        table.close()
    if root.has("joint_offsets_rad"):
        offsets = root.table("joint_offsets_rad")
        for joint in offsets.names():
            places = [i for i, own in enumerate(eyes) if own == joint]
            if not places:
                raise HeadFileError(offsets.key(joint), None, "a joint of the eyes")
            offset[places] = offsets.number(joint, RADIANS)
    still = sorted({own for own, row in zip(eyes, matrix, strict=True) if own and not row.any()})
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
    return Actuators(
        names=tuple(names),
        matrix=matrix,
        offset=offset,
        lower=np.array(columns["lower_rad"]),
        upper=np.array(columns["upper_rad"]),
        velocity=np.array(columns["velocity_rad_s"]),
        acceleration=np.array(columns["acceleration_rad_s2"]),
        **{field: np.array(columns[field]) for field in ACTUATOR_OWN},
    )


def joint_limits(
    links: JointAxes, limits_in_file: Sequence[FloatArray | None], actuators: Actuators | None
) -> JointLimits:
    """Limits of the seven joints: those in the file, or else the range that the actuators reach."""
    seven = np.zeros((4, len(JOINTS)))
    seven[3] = np.inf
    for name, places, own in zip(links.names, links.joint_indices, limits_in_file, strict=True):
        if own is not None:
            seven[:, places] = own[:, None]
            continue
        if actuators is None or places[0] < EYES.start:
            raise HeadFileError(
                f"joints {name}", None, f"{', '.join(JOINT_LIMITS)} (the keys are missing)"
            )
        row = actuators.matrix[places[0] - EYES.start]
        centre = actuators.offset[places[0] - EYES.start]
        ends = np.stack([row * actuators.lower, row * actuators.upper])
        seven[0, places] = centre + ends.min(axis=0).sum()
        seven[1, places] = centre + ends.max(axis=0).sum()
        seven[2, places] = np.abs(row) @ actuators.velocity
        used = row != 0.0
        seven[3, places] = np.abs(row[used]) @ actuators.acceleration[used]
    return JointLimits(lower=seven[0], upper=seven[1], velocity=seven[2], acceleration=seven[3])


def actuators_to_toml(links: JointAxes, actuators: Actuators) -> dict[str, Any]:
    """Write the tables of actuators; `parse_actuators` reads exactly the same values back."""
    eyes = links.joints[EYES]
    tables: dict[str, Any] = {
        "actuators": [
            {
                "name": name,
                "joints": {
                    joint: float(factor)
                    for joint, factor in zip(eyes, actuators.matrix[:, k], strict=True)
                    if factor != 0.0
                },
                **{key: float(getattr(actuators, own)[k]) for key, own in LIMIT_FIELDS.items()},
                **{
                    field: float(getattr(actuators, field)[k])
                    for field in ACTUATOR_OWN
                    if np.isfinite(getattr(actuators, field)[k])
                },
            }
            for k, name in enumerate(actuators.names)
        ]
    }
    if actuators.offset.any():
        tables["joint_offsets_rad"] = {
            joint: float(offset)
            for joint, offset in zip(eyes, actuators.offset, strict=True)
            if joint
        }
    return tables


_LEAST_BASELINE_M: Final = 1e-3
"""Smallest distance between the cameras (chosen: far below any real head)."""
_LEAST_CONDITION: Final = 0.05
"""Smallest determinant, or singular value, of an image Jacobian in focal lengths per radian.

Below it an actuator hardly moves the images (chosen: higher values would refuse usable heads).
"""
_TEST_POINT_DISTANCE_M: Final = 100.0
"""Distance of the point ahead; eye translation is negligible there (chosen)."""
_ANGLE_STEP_RAD: Final = 1e-5
"""Step of central differences; keeps derivatives exact to ten digits, rad (numerical)."""


def parse_head(text: str) -> HeadModel:
    """Parse a head from the text of a TOML file.

    Args:
        text: TOML, laid out as `head_to_toml` writes it.

    Returns:
        The head.

    Raises:
        HeadFileError: a key is unknown or missing, a value is out of range, or the head cannot
            triangulate or servo.
    """
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # nested too deep, or a number too long
        raise HeadFileError("TOML", str(error), "a well-formed TOML document") from error
    return head_of_document(document)


def head_of_document(document: Mapping[str, Any]) -> HeadModel:
    """Build the head that the tables of a head file describe; see `parse_head` for the errors."""
    root = Table(document, "")
    name = root.take("name", NAME[1])
    check_head_name(name)
    cameras = parse_eyes(root)
    parts: dict[str, Any] = {"cameras": cameras}
    if root.has("links") or root.has("limits"):  # the article's nine links
        parts |= {"links": _parse_links(root), "limits": _parse_limits(root.table("limits"))}
    else:
        parts = _parse_axes(root, cameras)
    head = HeadModel(
        name=name,
        timing=_parse_timing(root.table("timing")),
        sensor=_parse_sensor(root.table("sensor")),
        rendering=_parse_rendering(root.table("rendering")),
        assumptions=_parse_assumptions(root),
        calibration=_parse_calibration(root),
        **parts,
    )
    root.close()
    refuse_unusable_head(head)
    return head


def _parse_axes(root: Table, cameras: Cameras) -> dict[str, Any]:
    """Joints, frame N and actuators of a file, as arguments of `HeadModel`."""
    names, parts, pose, given, carried = parse_joints(root)
    if not names:  # perhaps the joints stand under a misspelt key: refuse unknown ones now
        root.close(
            ("frame", "actuators", "timing", "sensor", "rendering", "assumptions", "calibration")
        )
    head_eye = np.stack(
        [multiply_poses(carried[eye], cameras[i].pose) for i, eye in enumerate(EYE_NAMES)]
    )
    frame = parse_frame_n(root)
    # N is fixed to the neck's last link, whose frame is rotated from that of the neck's last joint
    unframed = JointAxes(names=tuple(names), parts=tuple(parts), pose=pose, frame=carried["neck"])
    if frame is None:
        eyes = [unframed.constant_poses()[4 + 3 * eye : 7 + 3 * eye] for eye in range(2)]
        chains = [
            multiply_poses(m0, m1, m2, head_eye[eye]) for eye, (m0, m1, m2) in enumerate(eyes)
        ]
        frame = frame_between_cameras(np.stack(chains))
    links = dataclasses.replace(unframed, frame=multiply_poses(carried["neck"], frame))
    actuators = parse_actuators(root, links)
    return {
        "links": links,
        "cameras": cameras.replaced(pose=head_eye),
        "limits": joint_limits(links, given, actuators),
        "actuators": actuators,
    }


def _parse_assumptions(root: Table) -> dict[str, str]:
    if not root.has("assumptions"):
        return {}
    table = root.table("assumptions")
    return {key: table.text(key, "why a value is assumed") for key in table.names()}


def _parse_calibration(root: Table) -> CalibrationRecord | None:
    if not root.has("calibration"):
        return None
    table = root.table("calibration")
    sigma = table.table("sigma")
    hexadecimal = "64 hexadecimal digits"
    digest = table.text("corners_sha256", hexadecimal)
    if not re.fullmatch(r"[0-9a-f]{64}", digest):
        raise HeadFileError(table.key("corners_sha256"), digest, hexadecimal)
    record = CalibrationRecord(
        target=table.text("target", "the board, such as 'checkerboard:9x6:24'"),
        views=table.integer("views", COUNT),
        rms_px=table.number("rms_px", NOT_NEGATIVE),
        rms_heldout_px=table.number("rms_heldout_px", NOT_NEGATIVE),
        corners_sha256=digest,
        versions=table.text("versions", "names and versions of programs"),
        sigma={name: sigma.number(name, NOT_NEGATIVE) for name in sigma.names()},
    )
    table.close()
    return record


def check_head_name(name: object) -> None:
    """Refuse a head name that cannot be part of a file name on every system."""
    accepted, expected = NAME
    if not isinstance(name, str) or not accepted(name):
        raise HeadFileError("name", name, expected)


def _parse_links(root: Table) -> DenavitHartenberg:
    columns: dict[str, list[float]] = {field: [] for field in LINK_FIELDS}
    for table, (frame, parent, joint) in zip(root.tables("links", 9), LINKS, strict=True):
        table.require_equal("frame", frame)
        table.require_equal("parent", parent)
        table.require_equal("joint", joint)
        for field, rule in LINK_FIELDS.items():
            columns[field].append(table.number(field, rule))
        table.close()
    return DenavitHartenberg(**{f.rsplit("_", 1)[0]: v for f, v in columns.items()})  # type: ignore[arg-type]


def _parse_limits(table: Table) -> JointLimits:
    values = {field: table.numbers(field, (7,), rule) for field, rule in LIMITS.items()}
    table.close()
    for joint, lower, upper in zip(JOINTS, values["lower_rad"], values["upper_rad"], strict=True):
        if not lower < upper:
            raise HeadFileError(
                f"limits of {joint}", [float(lower), float(upper)], "lower_rad below upper_rad"
            )
    return JointLimits(
        lower=values["lower_rad"],
        upper=values["upper_rad"],
        velocity=values["velocity_rad_s"],
        acceleration=values["acceleration_rad_s2"],
    )


def _parse_timing(table: Table) -> LoopTiming:
    rate = table.number("control_rate_hz", RATE)
    if table.has("latency_frames"):  # older files count control periods
        if table.has("latency_s"):
            raise HeadFileError(
                "timing", "both", "one of latency_s and latency_frames, an older form of it"
            )
        latency_s = table.integer("latency_frames", COUNT) / rate
    else:
        latency_s = table.number("latency_s", LATENCY)
    options = _parse_options(table, TIMING_OPTIONS)
    stamps = table.boolean("exposure_stamps")
    timing: LoopTiming = _parse_flat(
        table,
        TIMING,
        LoopTiming,
        control_rate_hz=rate,
        latency_s=latency_s,
        exposure_stamps=stamps,
        **options,
    )
    if timing.exposure_s > 1.0 / timing.frame_rate_hz:
        raise HeadFileError(
            "timing.exposure_s", timing.exposure_s, "no more than the time between two frames"
        )
    return timing


def _parse_sensor(table: Table) -> SensorModel:
    side = table.choice("encoder_side", ENCODER_SIDES) if table.has("encoder_side") else "motor"
    options = _parse_options(table, SENSOR_OPTIONS)
    sensor: SensorModel = _parse_flat(table, SENSOR, SensorModel, encoder_side=side, **options)
    return sensor


def _parse_options(table: Table, rules: Mapping[str, Rule]) -> dict[str, float]:
    """Values of the optional fields that a file has."""
    return {field: table.number(field, rule) for field, rule in rules.items() if table.has(field)}


def _parse_rendering(table: Table) -> Rendering:
    supersampling = table.integer("supersampling", SUPERSAMPLING)
    rendering: Rendering = _parse_flat(table, RENDERING, Rendering, supersampling=supersampling)
    return rendering


def _parse_flat(
    table: Table,
    rules: Mapping[str, Rule],
    part: Callable[..., Any],
    **others: float | str,
) -> Any:
    values = {field: table.number(field, rule) for field, rule in rules.items()}
    table.close()
    return part(**values, **others)


def _flat_to_toml(part: LoopTiming | SensorModel) -> dict[str, Any]:
    """Fields of a part, without those that have their default value."""
    return {
        field.name: value if isinstance(value, bool | str) else float(value)
        for field in dataclasses.fields(part)
        if (value := getattr(part, field.name)) != field.default
    }


def head_to_toml(head: HeadModel) -> str:
    """Write one head as TOML text; `parse_head` reads an equal head back."""
    if head.batch_shape:
        raise HeadFileError("head", f"a population of shape {head.batch_shape}", "one head")
    check_head_name(head.name)
    mount = ("head_eye_rotation", "head_eye_translation_m")
    if isinstance(head.links, DenavitHartenberg):
        axes: dict[str, Any] = {
            "limits": {
                key: getattr(head.limits, field).tolist() for key, field in LIMIT_FIELDS.items()
            },
            "links": [
                {
                    "frame": frame,
                    "parent": parent,
                    "joint": joint,
                    **{
                        field: float(getattr(head.links, field.rsplit("_", 1)[0])[i])
                        for field in LINK_FIELDS
                    },
                }
                for i, (frame, parent, joint) in enumerate(LINKS)
            ],
        }
    else:
        mount = ("rotation", "position_m")
        assert isinstance(head.links, JointAxes)
        axes = joints_to_toml(head.links, head.limits)
        if head.actuators is not None:
            axes |= actuators_to_toml(head.links, head.actuators)
    cameras = eyes_to_toml(head.cameras, mount)
    document: dict[str, Any] = {
        "name": head.name,
        "image": cameras.get("image", {}),
        "limits": axes.pop("limits", {}),
        "timing": _flat_to_toml(head.timing),
        "sensor": _flat_to_toml(head.sensor),
        "rendering": {field: float(getattr(head.rendering, field)) for field in RENDERING}
        | {"supersampling": head.rendering.supersampling},
        "links": axes.pop("links", []),
        "eyes": cameras["eyes"],
        **axes,
        "assumptions": dict(head.assumptions),
        "calibration": dataclasses.asdict(head.calibration) if head.calibration else {},
    }
    optional = ("image", "limits", "links", "assumptions", "calibration")
    return toml_text(
        {key: value for key, value in document.items() if value or key not in optional}
    )


def refuse_unusable_head(head: HeadModel) -> None:
    """Refuse a head that cannot triangulate or servo at rest."""
    _refuse_far_ranges(head)
    poses = head.camera_poses(head.rest())
    _refuse_places(poses)
    if not head.actuation.count:
        return
    own = _image_jacobians(head, poses)
    if head.actuation.direct:
        for eye, name in enumerate(EYE_NAMES):
            condition = float(np.abs(np.linalg.det(own[eye][:, 2 * eye : 2 * eye + 2])))
            if not condition > _LEAST_CONDITION:
                first, second = head.joints[3 + 2 * eye : 5 + 2 * eye]
                raise HeadFileError(
                    f"joints of the {name} eye",
                    f"an image Jacobian with determinant {condition:.3g} (by the focal lengths)",
                    f"{first} and {second} to move the image along two directions at rest, above "
                    f"{_LEAST_CONDITION} (does an axis point along the optical axis?)",
                )
        return
    count = head.actuation.count
    _left, values, ways = np.linalg.svd(own.reshape(4, count))
    if not values[-1] > _LEAST_CONDITION:
        weakest = head.actuation.names[int(np.argmax(np.abs(ways[-1])))]
        raise HeadFileError(
            f"joints moved by {weakest}",
            f"image Jacobians with a least singular value of {values[-1]:.3g} (by the focal "
            "lengths)",
            f"{', '.join(head.actuation.names)} each to move the images in a way of its own at "
            f"rest, above {_LEAST_CONDITION} (does an axis point along the optical axis?)",
        )


def _refuse_far_ranges(head: HeadModel) -> None:
    """Refuse eye joints whose range stays more than 90 degrees away from their zero."""
    for name, lower, upper in zip(
        head.joints[EYES], head.limits.lower[EYES], head.limits.upper[EYES], strict=True
    ):
        if name and not (lower <= 0.5 * np.pi and upper >= -0.5 * np.pi):
            raise HeadFileError(
                f"limits of {name}",
                [float(lower), float(upper)],
                "a range that comes within 1.57 rad of zero, where the eyes look ahead: angles are "
                "counted from there (turn the joint's frame by rpy_rad, and its limits with it)",
            )


def _refuse_places(poses: FloatArray) -> None:
    """Refuse eyes in one place, and a left eye on the right of the right one."""
    across = poses[1, :3, 3] - poses[0, :3, 3]
    baseline = float(np.linalg.norm(across))
    if not baseline > _LEAST_BASELINE_M:
        raise HeadFileError("eyes", f"a baseline of {baseline:.3g} m", "a baseline above 1 mm")
    # the x axes of the images define which way is right
    right, down = (poses[:, :3, axis].sum(axis=0) @ across for axis in (0, 1))
    if right < 0.0 and abs(right) > abs(down):
        raise HeadFileError(
            "eyes",
            f"a left camera {1e3 * baseline:.1f} mm on the right of the right one",
            "the left camera on the left, as the images have it (are left and right exchanged, or "
            "both cameras turned by 180 degrees, or do they look back with all joints at zero?)",
        )


def _image_jacobians(head: HeadModel, poses: FloatArray) -> FloatArray:
    """(2, 2, m) Jacobians of a far point ahead, by eye, image axis, actuator; focal lengths/rad."""
    count = head.actuation.count
    # central differences, since compiling `image_jacobian` would add a second to the first call
    turns = _ANGLE_STEP_RAD * np.array([[[1.0]], [[-1.0]]]) * np.eye(7)[3 : 3 + count]
    turned = head.actuation.joints_of(head.actuation.actuators_of(head.rest()) + turns)
    # far away, so that an eye that translates without turning hardly moves its image
    ahead = poses[:, :3, 3] + _TEST_POINT_DISTANCE_M * poses[:, :3, 2]
    own = np.empty((2, 2, count))
    for eye in range(2):
        plus, minus = head.project(turned, ahead[eye], distorted=False)[..., eye, :]
        own[eye] = ((plus - minus) / (2.0 * _ANGLE_STEP_RAD * head.cameras.focal[eye])).T
    return own


_PRESETS = resources.files("vergence.models") / "presets"

_STEREO = "vergence import stereo makes of a calibrated pair"
_CONVERTERS = {
    ".yml": _STEREO,
    ".yaml": _STEREO,
    ".json": _STEREO,
    ".xml": f"{_STEREO}, vergence import urdf of a robot",
    ".urdf": "vergence import urdf makes of a robot",
}
"""Command that converts a file often mistaken for a head file, by file suffix."""


def presets() -> list[str]:
    """Names of the heads that come with the package."""
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in _PRESETS.iterdir()
        if entry.name.endswith(".toml")
    )


def load_head(source: str | os.PathLike[str]) -> HeadModel:
    """Load a head from a preset or a TOML file.

    Args:
        source: a preset's name (`simulated`, `physical`) or the path of a TOML file, which
            ends in `.toml` or contains a separator.

    Returns:
        The head.

    Raises:
        UnknownNameError: there is no such preset.
        UnreadableFileError: the file is missing, or is no text.
        HeadFileError: the file is not a head; the message names the key, the value and what was
            expected.

    Examples:
        >>> import vergence
        >>> head = vergence.load_head("turrets")
        >>> head.joints[3:]
        ('left_pan', 'left_tilt', 'right_pan', 'right_tilt')
    """
    if not isinstance(source, str | os.PathLike):
        raise UnknownNameError("head", source, [*presets(), "a path of a .toml file"])
    text = os.fspath(source)
    if text in presets():
        return parse_head((_PRESETS / f"{text}.toml").read_text(encoding="utf-8"))
    maker = _CONVERTERS.get(Path(text).suffix.lower())
    if maker is not None:
        raise UnreadableFileError(text, "no head file", f"a TOML file, which {maker}")
    if not text.endswith(".toml") and os.sep not in text:
        raise UnknownNameError("head", text, [*presets(), "a path of a .toml file"])
    try:
        # editors on Windows begin a file with a byte order mark
        content = Path(text).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not text in UTF-8"
        raise UnreadableFileError(text, reason + _meant(text), "a TOML file") from error
    try:
        return parse_head(content)
    except HeadFileError as error:
        raise HeadFileError(error.key, error.value, error.expected, text) from error


def _meant(path: str) -> str:
    """Hint at the preset whose name resembles a path's."""
    near = get_close_matches(Path(path).stem, presets(), n=1)
    return f" (--head {near[0]} is the preset)" if near else ""


def absolute_source(source: str) -> str:
    """Head name that is valid in any working directory: a preset's name or an absolute path."""
    return source if source in presets() else str(Path(source).absolute())


def save_head(head: HeadModel, path: str | os.PathLike[str]) -> None:
    """Write one head to a TOML file atomically.

    Args:
        head: one head, not a population.
        path: file to write; an existing file is replaced.

    Raises:
        HeadFileError: the head is a population, or has a name that is no valid file name.
        OSError: the file cannot be written.
    """
    write_atomic(path, head_to_toml(head))


_UNITS: Final[tuple[tuple[str, float, str], ...]] = (
    ("_rad_s2", 1.0, "rad/s^2"),
    ("_rad_s", 180.0 / np.pi, "deg/s"),
    ("_rad", 180.0 / np.pi, "deg"),
    ("_hz", 1.0, "Hz"),
    ("_px", 1.0, "px"),
    ("_s", 1e3, "ms"),
    ("_m", 1e3, "mm"),
)
"""Suffix of a key, factor from its SI unit to the unit shown, and the name of the unit shown."""
_MAX_SHOWN_VALUES: Final = 3
"""Most different values of several tables that are written out (chosen: keeps the text short)."""


class AssumedValue(NamedTuple):
    """A value that a head file assumes rather than measures."""

    keys: tuple[str, ...]
    """Keys that share the value and the reason."""
    value: str
    """Value with its unit; empty if the file has no such key."""
    reason: str
    """Reason for the assumption."""


def assumed_values(head: HeadModel) -> list[AssumedValue]:
    """List the assumptions of a head with their values."""
    document = tomllib.loads(head_to_toml(head))
    found: dict[tuple[str, str], list[str]] = {}
    for key, why in head.assumptions.items():
        found.setdefault((_value(document, key), why), []).append(key)
    return [AssumedValue(tuple(keys), value, why) for (value, why), keys in found.items()]


def _value(document: dict[str, Any], key: str) -> str:
    """Text of the value at a dotted key; several values if several tables have the field."""
    values: list[Any] = [document]
    parts = key.split(".")
    if parts[-1] == "origin_m":  # its axes are the written form's, not the user's
        return ""
    for part in parts:
        values = [found for value in values for found in _step(value, part)]
    if not values and len(parts) == 1:  # a field of no table in particular
        tables = [
            table for value in document.values() if isinstance(value, list) for table in value
        ]
        values = list(_step(tables, key))
    texts = list(dict.fromkeys(_text(parts[-1], value) for value in values))
    if len(texts) > _MAX_SHOWN_VALUES:
        return f"{'; '.join(texts[:_MAX_SHOWN_VALUES])}; ..."
    return "; ".join(texts)


def _step(value: Any, part: str) -> Iterable[Any]:
    """Values at a part of a dotted key: a field, a table by its name, or a field of all tables."""
    if isinstance(value, dict):
        return [value[part]] if part in value else []
    if isinstance(value, list) and all(isinstance(table, dict) for table in value):
        named = [table for table in value if table.get("name") == part]
        return named or [table[part] for table in value if part in table]
    return []


def _text(key: str, value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(
            f"{label_without_unit(field)} {_text(field, own)}" for field, own in value.items()
        )
    factor, unit = next(((f, u) for end, f, u in _UNITS if key.endswith(end)), (1.0, ""))
    numbers = _flat_numbers(value)
    if not numbers:
        return str(value)
    return f"{', '.join(f'{factor * number:.4g}' for number in numbers)} {unit}".rstrip()


def label_without_unit(field: str) -> str:
    """A key without its unit suffix, underscores replaced by spaces."""
    end = next((end for end, _, _ in _UNITS if field.endswith(end)), "")
    return field.removesuffix(end).replace("_", " ")


def _flat_numbers(value: Any) -> Sequence[float]:
    if isinstance(value, list):
        return [number for part in value for number in _flat_numbers(part)]
    return [value] if isinstance(value, int | float) else []
