"""Read and write a head as TOML text; invalid heads are refused."""

import dataclasses
import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.calibrated import CalibrationRecord
from vergence.models.files.actuators_toml import (
    actuators_to_toml,
    joint_limits,
    parse_actuators,
)
from vergence.models.files.cameras_toml import eyes_to_toml, parse_eyes
from vergence.models.files.head_rules import (
    COUNT,
    LATENCY,
    LIMIT_FIELDS,
    LIMITS,
    LINK_FIELDS,
    NAME,
    NOT_NEGATIVE,
    RATE,
    RENDERING,
    SENSOR,
    SENSOR_OPTIONS,
    SUPERSAMPLING,
    TIMING,
    TIMING_OPTIONS,
)
from vergence.models.files.joints_toml import (
    frame_between_cameras,
    joints_to_toml,
    parse_frame_n,
    parse_joints,
)
from vergence.models.files.toml_table import Rule, Table
from vergence.models.files.toml_text import toml_text
from vergence.models.head import HeadModel
from vergence.models.joint_axes import JointAxes
from vergence.models.joints import EYE_NAMES, EYES, JOINTS, LINKS
from vergence.models.links import DenavitHartenberg, multiply_poses
from vergence.models.parts import (
    ENCODER_SIDES,
    FloatArray,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
)

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
        root = Table(tomllib.loads(text), "")
    except (ValueError, RecursionError) as error:  # nested too deep, or a number too long
        raise HeadFileError("TOML", str(error), "a well-formed TOML document") from error
    name = root.take("name", NAME[1])
    check_head_name(name)
    cameras, mounts = parse_eyes(root)
    parts: dict[str, Any] = {"head_eye": mounts}
    if root.has("links") or root.has("limits"):  # the article's nine links
        parts |= {"links": _parse_links(root), "limits": _parse_limits(root.table("limits"))}
    else:
        parts = _parse_axes(root, mounts)
    head = HeadModel(
        name=name,
        cameras=cameras,
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


def _parse_axes(root: Table, mounts: FloatArray) -> dict[str, Any]:
    """Joints, frame N and actuators in the form of `joints_toml`, as arguments of `HeadModel`."""
    names, parts, pose, given, carried = parse_joints(root)
    if not names:  # perhaps the joints stand under a misspelt key: refuse unknown ones now
        root.close(
            ("frame", "actuators", "timing", "sensor", "rendering", "assumptions", "calibration")
        )
    head_eye = np.stack(
        [multiply_poses(carried[eye], mounts[i]) for i, eye in enumerate(EYE_NAMES)]
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
        "head_eye": head_eye,
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
    cameras = eyes_to_toml(head.cameras, head.head_eye, mount)
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
