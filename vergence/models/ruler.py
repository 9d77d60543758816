"""A head file from what a ruler and a data sheet tell, and the data of common servos."""

import re
from dataclasses import MISSING, dataclass, field, fields
from math import hypot, pi, radians, tan, tau
from typing import Any, Final, Literal, NamedTuple

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.head_file import RULER, RULER_REASONS
from vergence.models.parts import EYE_NAMES

_STEPS_4096_RAD: Final = tau / 4096
_DYNAMIXEL_SPEED_RAD_S: Final = 0.229 * tau / 60
_MANUAL: Final = "ROBOTIS e-Manual, emanual.robotis.com/docs/en/dxl/x/"
_SAME: Final = "assumed, as for the XL430 of the preset turrets"


class ServoModel(NamedTuple):
    """Contents of a servo's data sheet."""

    name: str
    rev_min: float  # without load
    volts: float  # at that speed
    acceleration_rad_s2: float
    source: str  # of speed and resolution
    acceleration_source: str
    backlash_deg: float = 0.0  # 0 where it is not stated
    angle_step_rad: float = _STEPS_4096_RAD
    speed_step_rad_s: float = _DYNAMIXEL_SPEED_RAD_S

    @property
    def speed_rad_s(self) -> float:
        """Speed without load, rad/s."""
        return self.rev_min * tau / 60


SERVO_MODELS: Final = {
    model.name: model
    for model in (
        ServoModel("XL330-M288", 103.0, 5.0, 144.0, f"{_MANUAL}xl330-m288",
                   "half of 0.52 N m over 0.0018 kg m^2, the rotor's in the MuJoCo model of Reachy "
                   "Mini"),
        ServoModel("XL330-M077", 383.0, 5.0, 144.0, f"{_MANUAL}xl330-m077", "as the XL330-M288"),
        ServoModel("XL430-W250", 57.0, 11.1, 80.0, f"{_MANUAL}xl430-w250", "assumed"),
        ServoModel("XC330-T288", 65.0, 11.1, 80.0, f"{_MANUAL}xc330-t288", _SAME),
        ServoModel("XC330-T181", 104.0, 11.1, 80.0, f"{_MANUAL}xc330-t181", _SAME),
        ServoModel("XC330-M288", 81.0, 5.0, 80.0, f"{_MANUAL}xc330-m288", _SAME),
        ServoModel("XM430-W350", 46.0, 12.0, 45.0, f"{_MANUAL}xm430-w350",
                   "half of 4.1 N m over 0.045 kg m^2, the rotor's in MuJoCo Menagerie's "
                   "robotis_op3", 0.25),
        ServoModel("XM430-W210", 77.0, 12.0, 45.0, f"{_MANUAL}xm430-w210", "as the XM430-W350",
                   0.25),
        ServoModel("STS3215", 45.0, 12.0, 52.0, "Feetech's data sheet of the STS3215-C018",
                   "half of 2.94 N m over 0.028 kg m^2, the rotor's in the MuJoCo model of the "
                   "SO-101 arm", 0.5, speed_step_rad_s=_STEPS_4096_RAD),
        ServoModel("hobby", 59.0, 4.8, 80.0,
                   "Tower Pro's data sheet of the MG996R: 0.17 s for 60 degrees, dead band 5 us; "
                   "it tells no angle, so it can be simulated, and not deployed on",
                   _SAME, 0.5, angle_step_rad=0.5 * pi / 180, speed_step_rad_s=0.0),
    )
}  # fmt: skip
"""Servo models by name, the usual one of a family first."""


def find_servo_model(text: str) -> ServoModel:
    """Model of a name, or of the beginning of one: XL330, XL430-W250-T, sts3215."""
    asked = re.sub(r"[^a-z0-9]", "", text.lower())
    for model in SERVO_MODELS.values():
        name = re.sub(r"[^a-z0-9]", "", model.name.lower())
        if asked and (name.startswith(asked) or asked in (name + "t", name + "r")):
            return model
    raise UnknownNameError("servo", text, list(SERVO_MODELS))


def _measure(least: float, most: float, unit: str, default: Any = MISSING) -> Any:
    return field(default=default, metadata={"range": (least, most, unit)})


VIEWS: Final = ("view", "diagonal", "focal")
"""Measures of a camera's view, of which one is needed."""


@dataclass(frozen=True, kw_only=True)
class Ruler:
    """A head as a person measures it, looking straight ahead; defaults are usual values."""

    name: str
    servo: ServoModel
    baseline: float = _measure(10.0, 2000.0, "mm")  # between the lenses
    # the view, one of:
    view: float | None = _measure(5.0, 150.0, "degrees", None)  # horizontally
    diagonal: float | None = _measure(5.0, 160.0, "degrees", None)
    focal: float | None = _measure(50.0, 20_000.0, "px", None)
    mount: Literal["turrets", "neck"] = "turrets"  # each eye has a pan and a tilt, or both together
    first: Literal["pan", "tilt"] = "pan"  # joint nearer to the base
    axes_apart: float | None = _measure(0.0, 2000.0, "mm", None)  # first axes; None: as the lenses
    height: float = _measure(0.0, 2900.0, "mm", 100.0)  # of the lenses above the plate below all
    axes_ahead: float = _measure(-300.0, 300.0, "mm", 0.0)  # from the first axis to the second
    lens_ahead: float = _measure(-300.0, 300.0, "mm", 20.0)  # from the second axis to the lenses
    lens_above: float = _measure(-300.0, 300.0, "mm", 40.0)  # from the tilt axis to the lenses
    size: tuple[int, int] = (640, 480)  # width and height of the images, px
    pan: float = _measure(5.0, 180.0, "degrees", 80.0)  # to either side
    tilt: float = _measure(5.0, 90.0, "degrees", 45.0)  # to either side
    fps: float = _measure(1.0, 1000.0, "images a second", RULER["timing"]["frame_rate_hz"])
    speed: float | None = _measure(0.1, 40.0, "rad/s", None)  # of the joints; None: the servo's
    acceleration: float | None = _measure(1.0, 5000.0, "rad/s^2", None)  # of the joints, as speed
    measured: frozenset[str] = frozenset()  # names of the values that are no defaults

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_measure(name, value)
        views = [name for name in VIEWS if getattr(self, name) is not None]
        if len(views) != 1:
            raise ConfigurationError(
                "view: expected one of --view, --diagonal and --focal, got "
                f"{' and '.join(views) or 'none'}"
            )
        if self.axes_apart is not None and self.mount == "neck":
            raise ConfigurationError(
                f"axes-apart: expected none with --mount neck, got {self.axes_apart:g}"
            )
        if self.height < self.lens_above:
            raise ConfigurationError(
                f"height: expected at least the lenses' height above the tilt axis, "
                f"{self.lens_above:g} mm, got {self.height:g}"
            )

    @property
    def focal_px(self) -> float:
        """Focal length of a pinhole with the stated view."""
        if self.focal is not None:
            return self.focal
        across = float(self.size[0]) if self.diagonal is None else hypot(*self.size)
        return across / (2.0 * tan(radians(self.diagonal or self.view or 0.0) / 2.0))


_RANGES: Final = {one.name: one.metadata["range"] for one in fields(Ruler) if one.metadata}
"""Least and greatest value of each measure, and its unit."""


def check_measure(name: str, value: object) -> None:
    """Raise a `ConfigurationError` if a measure suggests another unit; None passes."""
    if name not in _RANGES or not isinstance(value, int | float):
        return
    least, most, unit = _RANGES[name]
    in_metres = unit == "mm" and 0.0 < abs(value) < 1.0
    if not least <= value <= most or in_metres:
        wrong = " (is it in metres?)" if in_metres else ""
        raise ConfigurationError(
            f"{name.replace('_', '-')}: expected {least:g} to {most:g} {unit}{wrong}, got {value:g}"
        )


def ruler_to_toml(ruler: Ruler) -> str:
    """Head file, with comments, of a head measured with a ruler.

    The base frame is on the plate, midway between the first axes: x right, y down, z forward. N is
    midway between the lenses. A positive pan turns right, a positive tilt looks up.
    """
    servo, (width, height) = ruler.servo, ruler.size
    parts = EYE_NAMES if ruler.mount == "turrets" else ("both",)
    joints = "".join(_joints(ruler, part) for part in parts)
    eyes = "".join(_eye(ruler, eye) for eye in EYE_NAMES)
    reasons = {"joints.acceleration_rad_s2": servo.acceleration_source, **RULER_REASONS}
    lengths = [
        name.replace("_", "-")
        for name in ("height", "axes_ahead", "lens_ahead", "lens_above")
        if name not in ruler.measured
    ]
    if lengths:
        reasons["joints.origin_m"] = f"not measured: {', '.join(lengths)}"
    if not {"pan", "tilt"} <= ruler.measured:
        reasons["joints.upper_rad"] = reasons["joints.lower_rad"] = "not measured"
    if "fps" not in ruler.measured:
        reasons["timing.frame_rate_hz"] = "common for webcams"
    assumptions = "\n".join(f'"{key}" = "{why}"' for key, why in reasons.items())
    play = f"backlash_rad = {radians(servo.backlash_deg):.5f}        # play of its gears, at most\n"
    timing, sensor = RULER["timing"], RULER["sensor"]
    looks = "\n".join(f"{key} = {value}" for key, value in RULER["rendering"].items())
    return f"""# Measured with a ruler, looking straight ahead. Metres, radians, seconds, pixels.
# Base frame: on the plate, midway between the first axes; x right, y down, z forward.
# N, in which targets are given, is midway between the lenses. Each origin_m is relative to the
# joint before. Positive angles: pan to the right, tilt up.
name = "{ruler.name}"

[image]
width_px = {width}
height_px = {height}
{joints}{eyes}
[timing]
control_rate_hz = {max(ruler.fps, timing["control_rate_hz"]):g}
frame_rate_hz = {ruler.fps:g}
latency_s = {timing["latency_s"]}               # from exposure to image, until it is measured
exposure_s = {min(timing["exposure_s"], int(1e4 / ruler.fps) / 1e4)}
lag_s = {timing["lag_s"]}                  # of the servos' response, until it is measured

# {servo.name}: {servo.source}
[sensor]
encoder_resolution_rad = {servo.angle_step_rad:.6f}
encoder_side = "output"
velocity_resolution_rad_s = {servo.speed_step_rad_s:.6f}
{play if servo.backlash_deg else ""}detection_noise_px = {sensor["detection_noise_px"]}
dropped_frame_probability = {sensor["dropped_frame_probability"]}
max_smear_px = {sensor["max_smear_px"]}

[rendering]
{looks}

[assumptions]
{assumptions}
"""


_SIDES: Final = {"left": -0.5, "right": 0.5, "both": 0.0}
"""Place of what carries one eye or both, as a share of the distance between the eyes."""


def _joints(ruler: Ruler, part: str) -> str:
    servo = ruler.servo
    apart = ruler.baseline if ruler.axes_apart is None else ruler.axes_apart
    note = f"{servo.name}: {servo.rev_min:g} rev/min without load at {servo.volts:g} V"
    speed, note = (ruler.speed, "stated") if ruler.speed else (servo.speed_rad_s, note)
    text = ""  # the format z leaves no -0
    for joint in ("pan", "tilt") if ruler.first == "pan" else ("tilt", "pan"):
        x, z = (_SIDES[part] * apart, 0.0) if joint == ruler.first else (0.0, ruler.axes_ahead)
        y, reach, axis = 0.0, ruler.pan, [0, 1, 0]
        if joint == "tilt":
            y, reach, axis = ruler.lens_above - ruler.height, ruler.tilt, [1, 0, 0]
        text += f"""
[[joints]]
name = "{joint if part == "both" else f"{part}_{joint}"}"
part = "{part}"
origin_m = [{x / 1000.0:z.4f}, {y / 1000.0:z.4f}, {z / 1000.0:z.4f}]
axis = {axis}
lower_rad = {-radians(reach):.4f}               # {reach:g} degrees to either side
upper_rad = {radians(reach):.4f}
velocity_rad_s = {speed:.3f}            # {note}
acceleration_rad_s2 = {ruler.acceleration or servo.acceleration_rad_s2:g}
"""
    return text


def _eye(ruler: Ruler, eye: str) -> str:
    """The camera of an eye, in its last joint's frame."""
    at_axes = 0.0 if ruler.mount == "neck" else ruler.axes_apart
    aside = 0.0 if at_axes is None else ruler.baseline - at_axes
    view = next(f"{name} {value:g}" for name in VIEWS if (value := getattr(ruler, name)))
    width, height = ruler.size
    x, y, z = _SIDES[eye] * aside, -ruler.lens_above, ruler.lens_ahead
    return f"""
[[eyes]]
name = "{eye}"
focal_px = [{ruler.focal_px:.1f}, {ruler.focal_px:.1f}]       # {view}
principal_px = [{(width - 1) / 2:g}, {(height - 1) / 2:g}]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
position_m = [{x / 1000.0:z.4f}, {y / 1000.0:z.4f}, {z / 1000.0:z.4f}]
"""
