"""Reading and writing heads as TOML, refusing what cannot be a head."""

import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from vergence.errors import HeadFileError, UnknownNameError
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, JOINTS, LINKS
from vergence.models.parts import (
    Cameras,
    DenavitHartenberg,
    FloatArray,
    JointLimits,
    LoopTiming,
    SensorModel,
)
from vergence.models.rendering import Rendering

_PRESETS = resources.files("vergence.models") / "presets"

Check = Callable[[float], bool]

_METRES = (lambda x: abs(x) < 1.0, "metres below 1 in size (is it in millimetres?)")
_RADIANS = (lambda x: abs(x) < 6.3, "radians below 6.3 in size (is it in degrees?)")
_PIXELS = (lambda x: abs(x) < 1e5, "pixels below 100000 in size")
_FOCAL = (lambda x: 10.0 < x < 1e5, "a focal length in pixels, 10 to 100000")
_COEFFICIENT = (lambda x: abs(x) < 10.0, "a distortion coefficient below 10 in size")
_FACTOR = (lambda x: abs(x) <= 1.0 + 1e-9, "an element of a rotation matrix, -1 to 1")
_SPEED = (lambda x: 0.0 < x < 100.0, "rad/s, 0 to 100 (is it in degrees?)")
_ACCELERATION = (lambda x: x > 0.0, "rad/s^2 above 0, or inf for no limit")
_RATE = (lambda x: 1.0 <= x <= 10_000.0, "a rate in Hz, 1 to 10000")
_SECONDS = (lambda x: 0.0 <= x < 1.0, "seconds, 0 to 1 (is it in milliseconds?)")
_SIGMA = (lambda x: 0.0 <= x < 100.0, "a number from 0 to 100")
_STEP = (lambda x: 0.0 <= x < 0.1, "radians, 0 to 0.1 (is it in degrees?)")
_PROBABILITY = (lambda x: 0.0 <= x < 1.0, "a probability from 0 to below 1")
_POSITIVE = (lambda x: x > 0.0, "a number above 0")
_GREY = (lambda x: 0.0 <= x <= 255.0, "a grey level, 0 to 255")
_COUNT = (lambda x: 0 <= x <= 10_000, "a whole number, 0 to 10000")
_SIZE = (lambda x: 16 <= x <= 20_000, "an image size in pixels, 16 to 20000")

_LINK_FIELDS = {"alpha_rad": _RADIANS, "a_m": _METRES, "d_m": _METRES, "offset_rad": _RADIANS}
_TIMING = {
    "control_rate_hz": _RATE,
    "frame_rate_hz": _RATE,
    "exposure_s": _SECONDS,
    "lag_s": _SECONDS,
}
_SENSOR = {
    "detection_noise_px": _SIGMA,
    "encoder_resolution_rad": _STEP,
    "velocity_resolution_rad_s": _SIGMA,
    "dropped_frame_probability": _PROBABILITY,
    "max_smear_px": _POSITIVE,
}
_RENDERING = {
    "blur_px": _SIGMA,
    "noise_grey": _SIGMA,
    "black_grey": _GREY,
    "white_grey": _GREY,
    "background_grey": _GREY,
}
_LIMITS = {
    "lower_rad": _RADIANS,
    "upper_rad": _RADIANS,
    "velocity_rad_s": _SPEED,
    "acceleration_rad_s2": _ACCELERATION,
}


class _Table:
    """A TOML table that is taken apart key by key and must be empty in the end."""

    def __init__(self, values: object, path: str, expected: str = "a table") -> None:
        if not isinstance(values, Mapping):
            raise HeadFileError(path, values, expected)
        self._values = dict(values)
        self._path = path

    def key(self, name: str) -> str:
        return f"{self._path}.{name}" if self._path else name

    def take(self, name: str, expected: str) -> Any:
        if name not in self._values:
            raise HeadFileError(self.key(name), None, f"{expected} (the key is missing)")
        return self._values.pop(name)

    def number(self, name: str, rule: tuple[Check, str]) -> float:
        return _number(self.take(name, rule[1]), self.key(name), rule)

    def whole(self, name: str, rule: tuple[Check, str]) -> int:
        value = self.take(name, rule[1])
        if not isinstance(value, int) or isinstance(value, bool) or not rule[0](value):
            raise HeadFileError(self.key(name), value, rule[1])
        return value

    def numbers(self, name: str, shape: tuple[int, ...], rule: tuple[Check, str]) -> FloatArray:
        value = self.take(name, rule[1])
        return _numbers(value, self.key(name), shape, rule)

    def table(self, name: str) -> "_Table":
        return _Table(self.take(name, "a table"), self.key(name))

    def tables(self, name: str, count: int) -> list["_Table"]:
        expected = f"{count} tables [[{name}]]"
        values = self.take(name, expected)
        if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != count:
            raise HeadFileError(self.key(name), values, expected)
        return [_Table(v, f"{self.key(name)}[{i}]") for i, v in enumerate(values)]

    def same(self, name: str, expected: object) -> None:
        value = self.take(name, repr(expected))
        if value != expected or isinstance(value, bool):
            raise HeadFileError(self.key(name), value, repr(expected))

    def close(self) -> None:
        for name, value in self._values.items():
            raise HeadFileError(self.key(name), value, "no such key")


def _number(value: object, key: str, rule: tuple[Check, str]) -> float:
    accepted, expected = rule
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise HeadFileError(key, value, expected)
    if np.isnan(value) or not accepted(value):
        raise HeadFileError(key, value, expected)
    return float(value)


def _numbers(
    value: object, key: str, shape: tuple[int, ...], rule: tuple[Check, str]
) -> FloatArray:
    if not shape:
        return np.float64(_number(value, key, rule))  # type: ignore[return-value]
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != shape[0]:
        raise HeadFileError(key, value, f"{shape[0]} values of {rule[1]}")
    return np.array([_numbers(v, f"{key}[{i}]", shape[1:], rule) for i, v in enumerate(value)])


def presets() -> list[str]:
    """The names of the heads that come with the package."""
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
        HeadFileError: the file is missing or is not a head; the message names the key, the
            value and what was expected.
    """
    text = os.fspath(source)
    if text in presets():
        return parse_head((_PRESETS / f"{text}.toml").read_text(encoding="utf-8"))
    if not text.endswith(".toml") and os.sep not in text:
        raise UnknownNameError("head", text, [*presets(), "a path of a .toml file"])
    try:
        content = Path(text).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise HeadFileError(text, reason, "a readable TOML file") from error
    return parse_head(content)


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
        root = _Table(tomllib.loads(text), "")
    except tomllib.TOMLDecodeError as error:
        raise HeadFileError("TOML", str(error), "a well-formed TOML document") from error
    name = root.take("name", "a name")
    if not isinstance(name, str) or not name:
        raise HeadFileError("name", name, "a name")
    head = HeadModel(
        name=name,
        links=_parse_links(root),
        limits=_parse_limits(root.table("limits")),
        timing=_parse_timing(root.table("timing")),
        sensor=_parse_flat(root.table("sensor"), _SENSOR, SensorModel),
        rendering=_parse_rendering(root.table("rendering")),
        **_parse_eyes(root),
    )
    root.close()
    _refuse_singular(head)
    return head


def _parse_links(root: _Table) -> DenavitHartenberg:
    columns: dict[str, list[float]] = {field: [] for field in _LINK_FIELDS}
    for table, (frame, parent, joint) in zip(root.tables("links", 9), LINKS, strict=True):
        table.same("frame", frame)
        table.same("parent", parent)
        table.same("joint", joint)
        for field, rule in _LINK_FIELDS.items():
            columns[field].append(table.number(field, rule))
        table.close()
    return DenavitHartenberg(**{f.rsplit("_", 1)[0]: v for f, v in columns.items()})  # type: ignore[arg-type]


def _parse_eyes(root: _Table) -> dict[str, Any]:
    image = root.table("image")
    width, height = image.whole("width_px", _SIZE), image.whole("height_px", _SIZE)
    image.close()
    focal, principal, distortion, head_eye = [], [], [], np.zeros((2, 4, 4))
    for eye, table in enumerate(root.tables("eyes", 2)):
        table.same("name", EYE_NAMES[eye])
        focal.append(table.numbers("focal_px", (2,), _FOCAL))
        centre = table.numbers("principal_px", (2,), _PIXELS)
        if not (0.0 < centre[0] < width and 0.0 < centre[1] < height):
            raise HeadFileError(
                table.key("principal_px"),
                centre.tolist(),
                f"a point inside the image of {width} x {height} px",
            )
        principal.append(centre)
        distortion.append(table.numbers("distortion", (5,), _COEFFICIENT))
        rotation = table.numbers("head_eye_rotation", (3, 3), _FACTOR)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
            raise HeadFileError(
                table.key("head_eye_rotation"),
                rotation.tolist(),
                "a rotation matrix, orthonormal to 1e-9 with determinant 1",
            )
        head_eye[eye, :3, :3] = rotation
        head_eye[eye, :3, 3] = table.numbers("head_eye_translation_m", (3,), _METRES)
        head_eye[eye, 3, 3] = 1.0
        table.close()
    cameras = Cameras(
        width=width,
        height=height,
        focal=np.array(focal),
        principal=np.array(principal),
        distortion=np.array(distortion),
    )
    return {"cameras": cameras, "head_eye": head_eye}


def _parse_limits(table: _Table) -> JointLimits:
    values = {field: table.numbers(field, (7,), rule) for field, rule in _LIMITS.items()}
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


def _parse_timing(table: _Table) -> LoopTiming:
    latency = table.whole("latency_frames", _COUNT)
    timing: LoopTiming = _parse_flat(table, _TIMING, LoopTiming, latency_frames=latency)
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


def _parse_rendering(table: _Table) -> Rendering:
    supersampling = table.whole("supersampling", (lambda x: 1 <= x <= 16, "1 to 16"))
    rendering: Rendering = _parse_flat(table, _RENDERING, Rendering, supersampling=supersampling)
    return rendering


def _parse_flat(
    table: _Table,
    rules: Mapping[str, tuple[Check, str]],
    part: Callable[..., Any],
    **others: int,
) -> Any:
    values = {field: table.number(field, rule) for field, rule in rules.items()}
    table.close()
    return part(**values, **others)


def _refuse_singular(head: HeadModel) -> None:
    """Refuse a head that cannot servo or triangulate at rest."""
    rest = head.rest()
    origins = head.camera_poses(rest)[:, :3, 3]
    baseline = float(np.linalg.norm(origins[1] - origins[0]))
    if not baseline > 1e-3:
        raise HeadFileError("links", f"a baseline of {baseline} m", "a baseline above 1 mm")
    jacobian = head.image_jacobian(rest, head.cameras.principal, np.ones(2))
    for eye, name in enumerate(EYE_NAMES):
        own = jacobian[eye, :, 3 + 2 * eye : 5 + 2 * eye] / head.cameras.focal[eye][:, None]
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
        HeadFileError: the head is a population.
    """
    if head.batch_shape:
        raise HeadFileError("head", f"a population of shape {head.batch_shape}", "one head")
    links = [
        {
            "frame": frame,
            "parent": parent,
            "joint": joint,
            **{
                field: float(getattr(head.links, field.rsplit("_", 1)[0])[i])
                for field in _LINK_FIELDS
            },
        }
        for i, (frame, parent, joint) in enumerate(LINKS)
    ]
    eyes = [
        {
            "name": name,
            "focal_px": head.cameras.focal[eye].tolist(),
            "principal_px": head.cameras.principal[eye].tolist(),
            "distortion": head.cameras.distortion[eye].tolist(),
            "head_eye_rotation": head.head_eye[eye, :3, :3].tolist(),
            "head_eye_translation_m": head.head_eye[eye, :3, 3].tolist(),
        }
        for eye, name in enumerate(EYE_NAMES)
    ]
    return tomli_w.dumps(
        {
            "name": head.name,
            "image": {"width_px": head.cameras.width, "height_px": head.cameras.height},
            "limits": {
                "lower_rad": head.limits.lower.tolist(),
                "upper_rad": head.limits.upper.tolist(),
                "velocity_rad_s": head.limits.velocity.tolist(),
                "acceleration_rad_s2": head.limits.acceleration.tolist(),
            },
            "timing": {f: _plain(getattr(head.timing, f)) for f in [*_TIMING, "latency_frames"]},
            "sensor": {f: float(getattr(head.sensor, f)) for f in _SENSOR},
            "rendering": {
                f: _plain(getattr(head.rendering, f)) for f in [*_RENDERING, "supersampling"]
            },
            "links": links,
            "eyes": eyes,
        }
    )


def _plain(value: float) -> float:
    return value if isinstance(value, int) else float(value)


def save_head(head: HeadModel, path: str | os.PathLike[str]) -> None:
    """Write one head to a TOML file, whole or not at all.

    Args:
        head: one head, not a population.
        path: where to write; an existing file is replaced.

    Raises:
        HeadFileError: the head is a population.
        OSError: the file cannot be written.
    """
    text = head_to_toml(head)
    target = Path(path)
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
