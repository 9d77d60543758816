"""A head file from what a ruler and a data sheet tell, and the data of common servos."""

import re
from dataclasses import dataclass, fields
from math import hypot, pi, radians, tan, tau
from typing import Final, Literal, NamedTuple

from vergence.errors import ConfigurationError, UnknownNameError
from vergence.models.assumed import RULER, RULER_REASONS
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


_RANGES: Final = {
    "baseline": (10.0, 2000.0, "mm"),
    "axes_apart": (0.0, 2000.0, "mm"),
    "height": (0.0, 2900.0, "mm"),
    "axes_ahead": (-300.0, 300.0, "mm"),
    "lens_ahead": (-300.0, 300.0, "mm"),
    "lens_above": (-300.0, 300.0, "mm"),
    "view": (5.0, 150.0, "degrees"),
    "diagonal": (5.0, 160.0, "degrees"),
    "focal": (50.0, 20_000.0, "px"),
    "pan": (5.0, 180.0, "degrees"),
    "tilt": (5.0, 90.0, "degrees"),
    "fps": (1.0, 1000.0, "images a second"),
    "speed": (0.1, 40.0, "rad/s"),
    "acceleration": (1.0, 5000.0, "rad/s^2"),
}
"""Least and greatest value of each measure, and its unit."""
VIEWS: Final = ("view", "diagonal", "focal")
"""Measures of a camera's view, of which one is needed."""


@dataclass(frozen=True, kw_only=True)
class Ruler:
    """A head as a person measures it, looking straight ahead; defaults are usual values."""

    name: str
    servo: ServoModel
    baseline: float  # between the lenses, mm
    # the view, one of:
    view: float | None = None  # horizontally, degrees
    diagonal: float | None = None  # degrees
    focal: float | None = None  # px
    mount: Literal["turrets", "neck"] = "turrets"  # each eye has a pan and a tilt, or both together
    first: Literal["pan", "tilt"] = "pan"  # joint nearer to the base
    axes_apart: float | None = None  # between the first axes of turrets, mm; None: as the lenses
    height: float = 100.0  # of the lenses above the plate on which all stands, mm
    axes_ahead: float = 0.0  # from the first axis to the second, mm
    lens_ahead: float = 20.0  # from the second axis to the lenses, mm
    lens_above: float = 40.0  # from the tilt axis to the lenses, mm
    size: tuple[int, int] = (640, 480)  # width and height of the images, px
    pan: float = 80.0  # to either side, degrees
    tilt: float = 45.0  # to either side, degrees
    fps: float = RULER["timing"]["frame_rate_hz"]  # images a second
    speed: float | None = None  # of the joints, rad/s; None for the servo's
    acceleration: float | None = None  # of the joints, rad/s^2; None for the servo's
    measured: frozenset[str] = frozenset()  # names of the values that are no defaults

    def __post_init__(self) -> None:
        for field in fields(self):
            check_measure(field.name, getattr(self, field.name))
        views = [name for name in VIEWS if getattr(self, name) is not None]
        if len(views) != 1:
            raise ConfigurationError(
                "view: expected one of --view, --diagonal and --focal, got "
                f"{' and '.join(views) or 'none'}"
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
    sides = {"left": -0.5, "right": 0.5, "both": 0.0}
    joints = "".join(_joints(ruler, part, sides[part]) for part in parts)
    eyes = "".join(_eye(ruler, eye, sides[eye]) for eye in EYE_NAMES)
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
exposure_s = {timing["exposure_s"]}
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


def _joints(ruler: Ruler, part: str, side: float) -> str:
    servo, up = ruler.servo, (ruler.height - ruler.lens_above) / 1000.0
    first_up, second_up = (0.0, up) if ruler.first == "pan" else (up, 0.0)
    apart = ruler.baseline if ruler.axes_apart is None else ruler.axes_apart
    origins = {
        ruler.first: (side * apart / 1000.0, -first_up, 0.0),
        "tilt" if ruler.first == "pan" else "pan": (0.0, -second_up, ruler.axes_ahead / 1000.0),
    }
    note = f"{servo.name}: {servo.rev_min:g} rev/min without load at {servo.volts:g} V"
    speed, note = (ruler.speed, "stated") if ruler.speed else (servo.speed_rad_s, note)
    text = ""
    for joint, origin in origins.items():
        reach, axis = (ruler.pan, [0, 1, 0]) if joint == "pan" else (ruler.tilt, [1, 0, 0])
        text += f"""
[[joints]]
name = "{joint if part == "both" else f"{part}_{joint}"}"
part = "{part}"
origin_m = {_listed(*origin)}
axis = {axis}
lower_rad = {-radians(reach):.4f}               # {reach:g} degrees to either side
upper_rad = {radians(reach):.4f}
velocity_rad_s = {speed:.3f}            # {note}
acceleration_rad_s2 = {ruler.acceleration or servo.acceleration_rad_s2:g}
"""
    return text


def _eye(ruler: Ruler, eye: str, side: float) -> str:
    """The camera of an eye, in its last joint's frame."""
    at_axes = 0.0 if ruler.mount == "neck" else ruler.axes_apart
    aside = 0.0 if at_axes is None else ruler.baseline - at_axes
    view = next(f"{name} {value:g}" for name in VIEWS if (value := getattr(ruler, name)))
    width, height = ruler.size
    focal = _listed(ruler.focal_px, ruler.focal_px, digits=1)
    return f"""
[[eyes]]
name = "{eye}"
focal_px = {focal}       # {view}
principal_px = [{(width - 1) / 2:g}, {(height - 1) / 2:g}]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
position_m = {_listed(side * aside / 1000.0, -ruler.lens_above / 1000.0, ruler.lens_ahead / 1000.0)}
"""


def _listed(*values: float, digits: int = 4) -> str:
    """Numbers as TOML, none of them -0."""
    return f"[{', '.join(f'{round(value, digits) + 0.0:.{digits}f}' for value in values)}]"
