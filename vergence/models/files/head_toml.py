"""A head as TOML text and back, refusing what cannot be a head."""

import tomllib
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import tomli_w

from vergence.errors import HeadFileError
from vergence.models.files.head_rules import (
    COUNT,
    DISTORTION,
    FACTOR,
    FOCAL,
    LATENCY,
    LIMITS,
    LINK_FIELDS,
    METRES,
    NAME,
    PIXELS,
    RATE,
    RENDERING,
    SENSOR,
    SIZE,
    SUPERSAMPLING,
    TIMING,
)
from vergence.models.files.toml_table import Rule, Table
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, JOINTS, LINKS
from vergence.models.parts import (
    BROWN_CONRADY,
    LENSES,
    Cameras,
    DenavitHartenberg,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
)


def parse_head(text: str) -> HeadModel:
    """Make a head from the text of a TOML file.

    Args:
        text: TOML, laid out as `head_to_toml` writes it.

    Returns:
        The head.

    Raises:
        HeadFileError: a key is unknown, missing or has a value that cannot be right.
    """
    try:
        root = Table(tomllib.loads(text), "")
    except (ValueError, RecursionError) as error:  # nested too deep, or a number too long
        raise HeadFileError("TOML", str(error), "a well-formed TOML document") from error
    name = root.take("name", NAME[1])
    check_name(name)
    head = HeadModel(
        name=name,
        links=_parse_links(root),
        limits=_parse_limits(root.table("limits")),
        timing=_parse_timing(root.table("timing")),
        sensor=_parse_flat(root.table("sensor"), SENSOR, SensorModel),
        rendering=_parse_rendering(root.table("rendering")),
        **_parse_eyes(root),
    )
    root.close()
    _refuse_singular(head)
    return head


def check_name(name: object) -> None:
    """Refuse a name of a head that could not be part of a file's name on every system.

    Raises:
        HeadFileError: it could not.
    """
    accepted, expected = NAME
    if not isinstance(name, str) or not accepted(name):
        raise HeadFileError("name", name, expected)


def _parse_links(root: Table) -> DenavitHartenberg:
    columns: dict[str, list[float]] = {field: [] for field in LINK_FIELDS}
    for table, (frame, parent, joint) in zip(root.tables("links", 9), LINKS, strict=True):
        table.same("frame", frame)
        table.same("parent", parent)
        table.same("joint", joint)
        for field, rule in LINK_FIELDS.items():
            columns[field].append(table.number(field, rule))
        table.close()
    return DenavitHartenberg(**{f.rsplit("_", 1)[0]: v for f, v in columns.items()})  # type: ignore[arg-type]


def _parse_eyes(root: Table) -> dict[str, Any]:
    image = _parse_size(root.table("image"), closing=True) if root.has("image") else None
    size, lens, focal, principal, distortion = [], [], [], [], np.zeros((2, 8))
    head_eye = np.zeros((2, 4, 4))
    for eye, table in enumerate(root.tables("eyes", 2)):
        table.same("name", EYE_NAMES[eye])
        width, height = _parse_eye_size(table, image)
        size.append((width, height))
        focal.append(table.numbers("focal_px", (2,), FOCAL))
        centre = table.numbers("principal_px", (2,), PIXELS)
        if not (0.0 < centre[0] < width and 0.0 < centre[1] < height):
            raise HeadFileError(
                table.key("principal_px"),
                centre.tolist(),
                f"a point inside the image of {width} x {height} px",
            )
        principal.append(centre)
        lens.append(_parse_lens(table))
        count = len(LENSES[lens[eye]])
        distortion[eye, :count] = table.numbers("distortion", (count,), DISTORTION[lens[eye]])
        rotation = table.numbers("head_eye_rotation", (3, 3), FACTOR)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
            raise HeadFileError(
                table.key("head_eye_rotation"),
                rotation.tolist(),
                "a rotation matrix, orthonormal to 1e-9 with determinant 1",
            )
        head_eye[eye, :3, :3] = rotation
        head_eye[eye, :3, 3] = table.numbers("head_eye_translation_m", (3,), METRES)
        head_eye[eye, 3, 3] = 1.0
        table.close()
    cameras = Cameras(
        size=np.array(size),
        focal=np.array(focal),
        principal=np.array(principal),
        distortion=distortion,
        lens=(lens[0], lens[1]),
    )
    return {"cameras": cameras, "head_eye": head_eye}


def _parse_size(table: Table, *, closing: bool = False) -> tuple[int, int]:
    size = table.whole("width_px", SIZE), table.whole("height_px", SIZE)
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


def _parse_lens(table: Table) -> str:
    if not table.has("lens"):
        return BROWN_CONRADY
    expected = f"one of {', '.join(LENSES)}"
    lens = table.take("lens", expected)
    if not isinstance(lens, str) or lens not in LENSES:
        raise HeadFileError(table.key("lens"), lens, expected)
    return lens


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
        latency_s = table.whole("latency_frames", COUNT) / rate
    else:
        latency_s = table.number("latency_s", LATENCY)
    timing: LoopTiming = _parse_flat(
        table, TIMING, LoopTiming, control_rate_hz=rate, latency_s=latency_s
    )
    ratio = timing.control_rate_hz / timing.frame_rate_hz
    if ratio < 1.0 or abs(ratio - round(ratio)) > 1e-9:
        raise HeadFileError(
            "timing.frame_rate_hz",
            timing.frame_rate_hz,
            f"the control rate of {timing.control_rate_hz} Hz divided by a whole number",
        )
    if timing.exposure_s > 1.0 / timing.frame_rate_hz:
        raise HeadFileError(
            "timing.exposure_s", timing.exposure_s, "no more than the time between two frames"
        )
    return timing


def _parse_rendering(table: Table) -> Rendering:
    supersampling = table.whole("supersampling", SUPERSAMPLING)
    rendering: Rendering = _parse_flat(table, RENDERING, Rendering, supersampling=supersampling)
    return rendering


def _parse_flat(
    table: Table,
    rules: Mapping[str, Rule],
    part: Callable[..., Any],
    **others: float,
) -> Any:
    values = {field: table.number(field, rule) for field, rule in rules.items()}
    table.close()
    return part(**values, **others)


_TURN_RAD: Final = 1e-5
"""Leaves a derivative of the projection exact to ten digits."""


def _refuse_singular(head: HeadModel) -> None:
    """Refuse a head that cannot servo or triangulate at rest."""
    rest = head.rest()
    poses = head.camera_poses(rest)
    origins = poses[:, :3, 3]
    baseline = float(np.linalg.norm(origins[1] - origins[0]))
    if not baseline > 1e-3:
        raise HeadFileError("links", f"a baseline of {baseline} m", "a baseline above 1 mm")
    for eye, name in enumerate(EYE_NAMES):
        # by central differences: compiling `image_jacobian` would cost every first call a second
        turned = rest + _TURN_RAD * np.array([[[1.0]], [[-1.0]]]) * np.eye(7)[3 + 2 * eye :][:2]
        ahead = origins[eye] + poses[eye, :3, 2]
        plus, minus = head.project(turned, ahead, distorted=False)[..., eye, :]
        own = (plus - minus) / (2.0 * _TURN_RAD * head.cameras.focal[eye])
        condition = float(np.abs(np.linalg.det(own)))
        if not condition > 0.05:
            raise HeadFileError(
                f"links of the {name} eye",
                f"an image Jacobian with determinant {condition:.3g} (by the focal lengths)",
                "tilt and pan that move the image along two directions at rest (above 0.05)",
            )


def head_to_toml(head: HeadModel) -> str:
    """Write one head as TOML text that `parse_head` turns back into an equal head.

    Args:
        head: one head, not a population.

    Returns:
        The text.

    Raises:
        HeadFileError: the head is a population, or has a name that could not be read again.
    """
    if head.batch_shape:
        raise HeadFileError("head", f"a population of shape {head.batch_shape}", "one head")
    check_name(head.name)
    links = [
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
    ]
    cameras = head.cameras
    sizes = [{"width_px": width, "height_px": height} for width, height in cameras.size.tolist()]
    one_size = sizes[0] == sizes[1]
    eyes = [
        {
            "name": name,
            **({} if one_size else sizes[eye]),
            "focal_px": cameras.focal[eye].tolist(),
            "principal_px": cameras.principal[eye].tolist(),
            **({} if lens == BROWN_CONRADY else {"lens": lens}),
            "distortion": cameras.distortion[eye, : len(LENSES[lens])].tolist(),
            "head_eye_rotation": head.head_eye[eye, :3, :3].tolist(),
            "head_eye_translation_m": head.head_eye[eye, :3, 3].tolist(),
        }
        for eye, (name, lens) in enumerate(zip(EYE_NAMES, cameras.lens, strict=True))
    ]
    return tomli_w.dumps(
        {
            "name": head.name,
            **({"image": sizes[0]} if one_size else {}),
            "limits": {
                "lower_rad": head.limits.lower.tolist(),
                "upper_rad": head.limits.upper.tolist(),
                "velocity_rad_s": head.limits.velocity.tolist(),
                "acceleration_rad_s2": head.limits.acceleration.tolist(),
            },
            "timing": {field: float(value) for field, value in vars(head.timing).items()},
            "sensor": {field: float(value) for field, value in vars(head.sensor).items()},
            "rendering": {field: float(getattr(head.rendering, field)) for field in RENDERING}
            | {"supersampling": head.rendering.supersampling},
            "links": links,
            "eyes": eyes,
        }
    )
