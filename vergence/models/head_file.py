"""Heads as TOML files: one schema that is read, checked and written; the presets."""

import dataclasses
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from vergence.errors import ConfigurationError, HeadFileError, UnknownNameError, UnreadableFileError
from vergence.files import write_atomic
from vergence.models.camera import (
    EXPECTED,
    UNDISTORTED,
    Camera,
    CameraResponse,
    Cameras,
    Lens,
    camera_matrix,
    parse_response,
)
from vergence.models.head import HeadModel
from vergence.models.head_joints import (
    METRES,
    SECONDS,
    SIGMA,
    STEP,
    read_dh_row,
    read_joints,
    read_numbered_links,
    read_pose,
    read_rotation,
    written_joints,
)
from vergence.models.lens import BROWN_CONRADY, LENSES
from vergence.models.parts import (
    ENCODER_SIDES,
    EYE_NAMES,
    EYES,
    CalibrationRecord,
    FloatArray,
    LoopTiming,
    Rendering,
    SensorModel,
)
from vergence.models.toml_table import Rule, Table, toml_text

_LEAST_BASELINE_M: Final = 1e-3
"""Smallest distance between the cameras (chosen: far below any real head)."""
_LEAST_CONDITION: Final = 0.05
"""Smallest determinant, or singular value, of an image Jacobian in focal lengths per radian, below
which an actuator hardly moves the images (chosen: more would refuse usable heads)."""
_TEST_POINT_DISTANCE_M: Final = 100.0
"""Distance of the point ahead; eye translation is negligible there (chosen)."""
_ANGLE_STEP_RAD: Final = 1e-5
"""Step of central differences; keeps derivatives exact to ten digits, rad (numerical)."""


def refuse_unusable_head(head: HeadModel) -> None:
    """Refuse a head that cannot triangulate or servo at rest."""
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
    poses = head.camera_poses(head.rest())
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
    if head.actuation.count:
        _refuse_still_images(head, poses)


def _refuse_still_images(head: HeadModel, poses: FloatArray) -> None:
    """Refuse actuators that at rest do not each move the images in a way of its own."""
    names, count = head.actuation.names, head.actuation.count
    # central differences, since compiling `image_jacobian` would add a second to the first call
    turns = _ANGLE_STEP_RAD * np.array([[[1.0]], [[-1.0]]]) * np.eye(7)[3 : 3 + count]
    turned = head.actuation.joints_of(head.actuation.actuators_of(head.rest()) + turns)
    # far away, so that an eye that translates without turning hardly moves its image
    ahead = poses[:, :3, 3] + _TEST_POINT_DISTANCE_M * poses[:, :3, 2]
    seen = head.project(turned[..., None, :], ahead, distorted=False)  # by sign, actuator, point
    plus, minus = seen[:, :, (0, 1), (0, 1)]
    # by eye, image axis and actuator, in focal lengths per rad
    jacobians = np.moveaxis((plus - minus) / (2.0 * _ANGLE_STEP_RAD * head.cameras.focal), 0, -1)
    along = f"above {_LEAST_CONDITION} (does an axis point along the optical axis?)"
    if not head.actuation.direct:
        _left, values, ways = np.linalg.svd(jacobians.reshape(4, count))
        if not values[-1] > _LEAST_CONDITION:
            raise HeadFileError(
                f"joints moved by {names[int(np.argmax(np.abs(ways[-1])))]}",
                f"image Jacobians with a least singular value of {values[-1]:.3g} (by the focal "
                "lengths)",
                f"{', '.join(names)} each to move the images in a way of its own at rest, {along}",
            )
        return
    for eye, moved in enumerate((slice(2), slice(2, 4))):
        condition = float(np.abs(np.linalg.det(jacobians[eye][:, moved])))
        if not condition > _LEAST_CONDITION:
            raise HeadFileError(
                f"joints of the {EYE_NAMES[eye]} eye",
                f"an image Jacobian with determinant {condition:.3g} (by the focal lengths)",
                f"{' and '.join(names[moved])} to move the image along two directions at rest, "
                f"{along}",
            )


_Part = TypeVar("_Part", LoopTiming, SensorModel, Rendering)

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

# The values of numbers, by their unit.
_PIXELS: Final[Rule] = (lambda x: abs(x) < 1e5, "pixels below 100000 in size")
_FOCAL: Final[Rule] = (lambda x: 10.0 < x < 1e5, "a focal length in pixels, 10 to 100000")
_RATE: Final[Rule] = (lambda x: 1.0 <= x <= 10_000.0, "a rate in Hz, 1 to 10000")
_LATENCY: Final[Rule] = (lambda x: 0.0 <= x < 10.0, "seconds, 0 to 10 (is it in milliseconds?)")
_NOT_NEGATIVE: Final[Rule] = (lambda x: x >= 0.0, "a number of at least 0")
_ABOVE_ZERO: Final[Rule] = (lambda x: x > 0.0, "a number above 0")
_PROBABILITY: Final[Rule] = (lambda x: 0.0 <= x < 1.0, "a probability from 0 to below 1")
_GREY: Final[Rule] = (lambda x: 0.0 <= x <= 255.0, "a grey level, 0 to 255")
_COUNT: Final[Rule] = (lambda x: 0 <= x <= 10_000, "a whole number, 0 to 10000")
_SIZE: Final[Rule] = (lambda x: 16 <= x <= 20_000, "an image size in whole pixels, 16 to 20000")

_FIELDS: Final[dict[str, dict[str, tuple[Any, ...]]]] = {
    "timing": {
        "control_rate_hz": (_RATE, 30.0, 120.0, 60.0),
        "frame_rate_hz": (_RATE, 30.0, 60.0, 30.0),
        "latency_s": (_LATENCY, 0.0, 8 / 120, 0.1),
        "exposure_s": (SECONDS, 0.0, 0.0, 0.01),
        "lag_s": (SECONDS, 0.0, 0.03, 0.03),
        "command_latency_s": (SECONDS,),
        "feedback_latency_s": (SECONDS,),
    },
    "sensor": {
        "detection_noise_px": (SIGMA, 0.1, 0.05, 0.1),
        "encoder_resolution_rad": (STEP, 0.0, 0.0, 0.0),
        "velocity_resolution_rad_s": (SIGMA, 0.0, 0.0, 0.0),
        "dropped_frame_probability": (_PROBABILITY, 0.0, 0.0, 0.0),
        "max_smear_px": (_ABOVE_ZERO, 6.0, 6.0, 6.0),
        "command_resolution_rad_s": (SIGMA,),
        "backlash_rad": (STEP,),
    },
    "rendering": {
        "blur_px": (SIGMA, 0.7, 0.5, 0.7),
        "noise_grey": (SIGMA, 2.0, 2.0, 4.0),
        "supersampling": ((lambda x: 1 <= x <= 16, "a whole number, 1 to 16"), 2, 1, 1),
        "black_grey": (_GREY, 40.0, 40.0, 50.0),
        "white_grey": (_GREY, 210.0, 210.0, 190.0),
        "background_grey": (_GREY, 120.0, 120.0, 110.0),
    },
}
"""Numbers of `LoopTiming`, `SensorModel` and `Rendering`, by table and key: the rule, and the
values assumed of a calibrated pair, of a robot's description, and of a head measured by a ruler."""

PAIR, ROBOT, RULER = (
    {
        table: {key: assumed[kind] for key, (_, *assumed) in fields.items() if assumed}
        for table, fields in _FIELDS.items()
    }
    for kind in range(3)
)

# Reasons for the values by key of the head file.
PAIR_REASONS: Final = {
    "timing": "not in a calibration: 30 frames a second without delay",
    "sensor.detection_noise_px": (
        "not in a calibration: 0.1 px is what detectors of printed boards scatter by"
    ),
    "rendering": "not in a calibration: a webcam's blur, noise and contrast",
}
ROBOT_REASONS: Final = {
    "timing.control_rate_hz": "not in such a file: what a servo bus of few joints reaches",
    "timing.frame_rate_hz": "not in such a file: that of common USB cameras",
    "timing.latency_s": "not in such a file: that of a USB camera with detection, 67 ms",
    "timing.exposure_s": "not in such a file: a short one in good light",
    "timing.lag_s": "not in such a file: that of common servos, 30 ms",
    "sensor": "not in such a file: detection as in docs/vision.md, ideal encoders, no lost images",
    "rendering": "not in such a file: how simulated images look, that of the simulated preset",
}
RULER_REASONS: Final = {
    "timing.latency_s": "common for webcams over USB: measure-delay measures it",
    "timing.lag_s": "common for such servos: measure-delay measures it",
    "timing.exposure_s": "10 ms, a lit room, or the time between two images",
    "sensor.detection_noise_px": "0.1 px, of a board or tag in a sharp image",
    "eyes.principal_px": "the middle of the image, until the cameras are calibrated",
    "eyes.distortion": "none, until the cameras are calibrated",
    "rendering": "a webcam's blur, noise and contrast",
}

_PRESETS: Final = resources.files("vergence.models") / "presets"
_STEREO: Final = "vergence import stereo makes of a calibrated pair"
_CONVERTERS: Final = {
    **dict.fromkeys((".yml", ".yaml", ".json"), _STEREO),
    ".xml": f"{_STEREO}, vergence import urdf of a robot",
    ".urdf": "vergence import urdf makes of a robot",
}
"""Command that converts a file often mistaken for a head file, by file suffix."""


def presets() -> list[str]:
    """Names of the heads that come with the package."""
    names = (entry.name for entry in _PRESETS.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


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
        near = get_close_matches(Path(text).stem, presets(), n=1)
        meant = f" (--head {near[0]} is the preset)" if near else ""
        raise UnreadableFileError(text, reason + meant, "a TOML file") from error
    try:
        return parse_head(content)
    except HeadFileError as error:
        raise HeadFileError(error.key, error.value, error.expected, text) from error


def absolute_source(source: str) -> str:
    """Head name that is valid in any working directory: a preset's name or an absolute path."""
    return source if source in presets() else str(Path(source).absolute())


def save_head(head: HeadModel, path: str | os.PathLike[str]) -> None:
    """Write one head to a TOML file atomically.

    Args:
        head: one head, not a population.
        path: file to write; an existing file is replaced.

    Raises:
        HeadFileError: the head is a population, or has a name or a number that `load_head` refuses.
        OSError: the file cannot be written.
    """
    text = head_to_toml(head)
    parse_head(text)
    write_atomic(path, text)


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


def head_to_toml(head: HeadModel) -> str:
    """Write one head as TOML text; `parse_head` reads an equal head back."""
    return toml_text(document_of_head(head))


def head_of_document(document: Mapping[str, Any]) -> HeadModel:
    """Build the head that the tables of a head file describe; see `parse_head` for the errors."""
    root = Table(document, "")
    name = root.take("name", NAME[1])
    check_head_name(name)
    cameras, last_rows = _read_eyes(root)
    if root.has("links") or root.has("limits"):
        parts = {"cameras": cameras, **read_numbered_links(root)}
    else:
        parts = read_joints(root, cameras, last_rows)
    head = HeadModel(
        name=name,
        timing=_read_timing(root.table("timing")),
        sensor=_read_part(root.table("sensor"), SensorModel, "sensor"),
        rendering=_read_part(root.table("rendering"), Rendering, "rendering"),
        assumptions=_read_assumptions(root),
        calibration=_read_calibration(root),
        **parts,
    )
    root.close()
    refuse_unusable_head(head)
    return head


def document_of_head(head: HeadModel) -> dict[str, Any]:
    """The tables of one head's file."""
    if head.batch_shape:
        raise HeadFileError("head", f"a population of shape {head.batch_shape}", "one head")
    check_head_name(head.name)
    joints, last_rows = written_joints(head)
    eyes = [
        camera_fields(camera)
        | ({} if camera.response is None else {"response": camera.response})
        | {"rotation": camera.pose[:3, :3].tolist(), "position_m": camera.pose[:3, 3].tolist()}
        | row
        for camera, row in zip(head.cameras, last_rows, strict=True)
    ]
    written = {
        "name": head.name,
        "image": None,  # if both eyes have the same size
        **{part: _written_part(getattr(head, part)) for part in ("timing", "sensor", "rendering")},
        **eye_tables(head.cameras, eyes),
        **joints,
        "assumptions": dict(head.assumptions),
        "calibration": dataclasses.asdict(head.calibration) if head.calibration else {},
    }
    return {key: value for key, value in written.items() if value}


def check_head_name(name: object) -> None:
    """Refuse a head name that cannot be part of a file name on every system."""
    if not isinstance(name, str) or not _is_name(name):
        raise HeadFileError("name", name, NAME[1])


# Parts: timing, sensor, rendering, assumptions, the record of a calibration.


def _read_part(table: Table, part: type[_Part], key: str, **read: Any) -> _Part:
    """Read the fields that have not been read before; those with a default are optional."""
    for field in dataclasses.fields(part):
        name = field.name
        if name in read or (field.default is not dataclasses.MISSING and not table.has(name)):
            continue
        if field.type is bool:
            read[name] = table.boolean(name)
        elif field.type in (int, float):
            read_number = table.integer if field.type is int else table.number
            read[name] = read_number(name, _FIELDS[key][name][0])
        else:
            read[name] = table.choice(name, ENCODER_SIDES)
    table.close()
    return part(**read)


def _written_part(part: Any) -> dict[str, Any]:
    """Fields of a part, whole numbers last, without those that have their default value."""
    return {
        field.name: float(value) if field.type is float else value
        for field in sorted(dataclasses.fields(part), key=lambda field: field.type is int)
        if (value := getattr(part, field.name)) != field.default
    }


def _read_timing(table: Table) -> LoopTiming:
    read: dict[str, Any] = {}
    if table.has("latency_frames"):  # older files count control periods
        if table.has("latency_s"):
            expected = "one of latency_s and latency_frames, an older form of it"
            raise HeadFileError("timing", "both", expected)
        read["control_rate_hz"] = table.number("control_rate_hz", _RATE)
        read["latency_s"] = table.integer("latency_frames", _COUNT) / read["control_rate_hz"]
    timing = _read_part(table, LoopTiming, "timing", **read)
    expected = "no more than the time between two frames"
    fits = timing.exposure_s <= 1.0 / timing.frame_rate_hz
    table.expect(fits, "exposure_s", timing.exposure_s, expected)
    return timing


def _read_assumptions(root: Table) -> dict[str, str]:
    if not root.has("assumptions"):
        return {}
    table = root.table("assumptions")
    return {key: table.text(key, "why a value is assumed") for key in table.names()}


def _read_calibration(root: Table) -> CalibrationRecord | None:
    if not root.has("calibration"):
        return None
    table = root.table("calibration")
    sigma = table.table("sigma")
    hexadecimal = "64 hexadecimal digits"
    digest = table.text("corners_sha256", hexadecimal)
    fits = re.fullmatch(r"[0-9a-f]{64}", digest)
    table.expect(fits, "corners_sha256", digest, hexadecimal)
    record = CalibrationRecord(
        target=table.text("target", "the board, such as 'checkerboard:9x6:24'"),
        views=table.integer("views", _COUNT),
        rms_px=table.number("rms_px", _NOT_NEGATIVE),
        rms_heldout_px=table.number("rms_heldout_px", _NOT_NEGATIVE),
        corners_sha256=digest,
        versions=table.text("versions", "names and versions of programs"),
        sigma={name: sigma.number(name, _NOT_NEGATIVE) for name in sigma.names()},
    )
    table.close()
    return record


# Eyes: image size, pinhole, lens, response, pose.


def _read_eyes(root: Table) -> tuple[Cameras, list[dict[str, float] | None]]:
    """Cameras with their poses in the eyes' last links, and the D-H rows of these links."""
    image = None
    if root.has("image"):
        table = root.table("image")
        image = _read_size(table)
        table.close()
    cameras, rows = [], []
    for name, table in zip(EYE_NAMES, root.tables("eyes", 2), strict=True):
        table.require_equal("name", name, "the left eye comes first, then the right one")
        for key in ("width_px", "height_px"):
            expected = "no size of the eye's own beside [image], which holds for both eyes"
            table.expect(image is None or not table.has(key), key, table.peek(key), expected)
        width, height = image or _read_size(table)
        focal = table.numbers("focal_px", (2,), _FOCAL)
        centre = table.numbers("principal_px", (2,), _PIXELS)
        inside = 0.0 < centre[0] < width and 0.0 < centre[1] < height
        expected = f"a point inside the image of {width} x {height} px"
        table.expect(inside, "principal_px", centre.tolist(), expected)
        camera = Camera(
            size=(width, height),
            matrix=camera_matrix(focal, centre),
            lens=_read_lens(table),
            response=_read_response(table),
            pose=_read_mount(table),
        )
        cameras.append(camera)
        rows.append(read_dh_row(table))
        table.close()
    return Cameras(*cameras), rows


def _read_size(table: Table) -> tuple[int, int]:
    return table.integer("width_px", _SIZE), table.integer("height_px", _SIZE)


def _read_lens(table: Table) -> Lens:
    """Lens of a camera; a pinhole becomes Brown-Conrady with zeros."""
    said = table.has("lens")
    model = table.choice("lens", [UNDISTORTED, *LENSES]) if said else BROWN_CONRADY
    given = table.peek("distortion")
    if model == UNDISTORTED:
        if table.has("distortion"):
            expected = f"zeros, or no such key, for lens = '{UNDISTORTED}'"
            table.take("distortion", expected)
            none = isinstance(given, list) and not any(n != 0 for n in given)
            table.expect(none, "distortion", given, expected)
        return Lens()
    count = len(LENSES[model])
    for other, names in LENSES.items():  # as many as another model has
        fits = said or other == model or not isinstance(given, list) or len(given) != len(names)
        expected = f"{count} numbers, or lens = '{other}' beside them"
        table.expect(fits, "distortion", given, expected)
    # one coefficient of a quotient, or of a narrow fisheye image, may be large and distort little
    most = 10 if model == BROWN_CONRADY else 10_000
    rule = (lambda x: abs(x) < most), f"a distortion coefficient below {most} in size"
    return Lens(model, table.numbers("distortion", (count,), rule))


def _read_response(table: Table) -> CameraResponse | None:
    if not table.has("response"):
        return None
    value = table.take("response", EXPECTED)
    try:
        return parse_response(value)
    except ConfigurationError as error:
        raise HeadFileError(table.key("response"), value, EXPECTED) from error


def _read_mount(table: Table) -> FloatArray:
    """(4, 4) pose of a camera in its eye's last link."""
    if not table.has("head_eye_rotation"):
        return read_pose(table, "position_m")
    mount = np.eye(4)  # the keys of older files
    mount[:3, :3] = read_rotation(table, "head_eye_rotation")
    mount[:3, 3] = table.numbers("head_eye_translation_m", (3,), METRES)
    return mount


def camera_fields(camera: Camera) -> dict[str, Any]:
    """Fields of a camera in `[[eyes]]`: pinhole and lens."""
    model, coefficients = camera.lens
    return {
        "focal_px": camera.focal.tolist(),
        "principal_px": camera.principal.tolist(),
        **({} if model == BROWN_CONRADY else {"lens": model}),
        "distortion": np.asarray(coefficients).tolist(),
    }


def eye_tables(cameras: Iterable[Camera], fields: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Tables `eyes` and, for images of one size, `image`, from the other fields of both eyes."""
    left, right = ({"width_px": camera.width, "height_px": camera.height} for camera in cameras)
    named = [{"name": name} for name in EYE_NAMES]
    if left == right:
        return {"image": left, "eyes": [named[eye] | fields[eye] for eye in range(2)]}
    return {"eyes": [named[eye] | size | fields[eye] for eye, size in enumerate((left, right))]}
