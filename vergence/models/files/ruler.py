"""A head from what a ruler and data sheets say: two turrets, or two cameras on one neck."""

from dataclasses import dataclass
from math import hypot, radians, tan
from typing import Final, Literal

from vergence.errors import ConfigurationError
from vergence.models.joints import EYE_NAMES
from vergence.models.servo_models import ServoModel

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


def check_measure(name: str, value: float) -> float:
    """Return a measure, or raise a `ConfigurationError` if it suggests another unit."""
    least, most, unit = _RANGES[name]
    if not least <= value <= most:
        wrong = " (is it in metres?)" if unit == "mm" and 0.0 < value < 3.0 else ""
        raise ConfigurationError(
            f"{name.replace('_', '-')}: expected {least:g} to {most:g} {unit}{wrong}, got {value:g}"
        )
    return value


@dataclass(frozen=True, kw_only=True)
class Ruler:
    """A head as a person measures it, looking straight ahead.

    Attributes:
        name: name of the head.
        mount: `turrets` (each eye pans and tilts by itself) or `neck` (both eyes together).
        first: the joint nearer to the base.
        baseline: distance between the lenses, mm.
        axes_apart: distance between the two first axes of turrets, mm.
        height: height of the lenses above the plate on which all stands, mm.
        axes_ahead: distance of the second axis ahead of the first, mm.
        lens_ahead: distance of the lenses ahead of the second axis, mm.
        lens_above: height of the lenses above the tilt axis, mm.
        size: width and height of the images, px.
        focal: focal length, px.
        view_note: origin of the focal length.
        pan, tilt: range of each joint to either side, degrees.
        fps: images a second.
        speed, acceleration: greatest speed and acceleration of the joints, rad/s and rad/s^2.
        servo: model of all servos.
        assumed: measures that nobody took, by name.
    """

    name: str
    mount: Literal["turrets", "neck"]
    first: Literal["pan", "tilt"]
    baseline: float
    axes_apart: float
    height: float
    axes_ahead: float
    lens_ahead: float
    lens_above: float
    size: tuple[int, int]
    focal: float
    view_note: str
    pan: float
    tilt: float
    fps: float
    speed: float
    acceleration: float
    servo: ServoModel
    assumed: tuple[str, ...]


def focal_of_view(size: tuple[int, int], degrees: float, *, diagonal: bool = False) -> float:
    """Focal length of a pinhole with a horizontal or diagonal field of view, px."""
    across = hypot(*size) if diagonal else size[0]
    return float(across / (2.0 * tan(radians(degrees) / 2.0)))


def ruler_to_toml(ruler: Ruler) -> str:
    """Head file, with comments, of a head measured with a ruler.

    The base frame is on the plate, midway between the first axes: x right, y down, z forward. N is
    midway between the lenses. A positive pan turns right, a positive tilt looks up.
    """
    if ruler.height < ruler.lens_above:
        raise ConfigurationError(
            f"height: expected at least the lenses' height above the tilt axis, "
            f"{ruler.lens_above:g} mm, got {ruler.height:g}"
        )
    servo, (width, height) = ruler.servo, ruler.size
    parts = EYE_NAMES if ruler.mount == "turrets" else ("both",)
    sides = {"left": -0.5, "right": 0.5, "both": 0.0}
    joints = "".join(_joints(ruler, part, sides[part]) for part in parts)
    eyes = "".join(_eye(ruler, eye, sides[eye]) for eye in EYE_NAMES)
    reasons = {
        "joints.acceleration_rad_s2": servo.acceleration_source,
        "timing.latency_s": "common for webcams over USB: measure-delay measures it",
        "timing.lag_s": "common for such servos: measure-delay measures it",
        "timing.exposure_s": "10 ms, a lit room",
        "sensor.detection_noise_px": "0.1 px, of a board or tag in a sharp image",
        "eyes.principal_px": "the middle of the image, until the cameras are calibrated",
        "eyes.distortion": "none, until the cameras are calibrated",
        "rendering": "a webcam's blur, noise and contrast",
    }
    if ruler.assumed:
        lengths = {"height", "axes_ahead", "lens_ahead", "lens_above"} & set(ruler.assumed)
        if lengths:
            names = ", ".join(name.replace("_", "-") for name in ruler.assumed if name in lengths)
            reasons["joints.origin_m"] = f"not measured: {names}"
        if {"pan", "tilt"} & set(ruler.assumed):
            reasons["joints.upper_rad"] = reasons["joints.lower_rad"] = "not measured: the ranges"
        if "fps" in ruler.assumed:
            reasons["timing.frame_rate_hz"] = "30 images a second are common for webcams"
    assumptions = "\n".join(f'"{key}" = "{why}"' for key, why in reasons.items())
    backlash = (
        f"backlash_rad = {radians(servo.backlash_deg):.5f}        # play of its gears, at most\n"
        if servo.backlash_deg
        else ""
    )
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
control_rate_hz = {max(ruler.fps, 60.0):g}
frame_rate_hz = {ruler.fps:g}
latency_s = 0.1               # from exposure to image, until it is measured
exposure_s = 0.01
lag_s = 0.03                  # of the servos' response, until it is measured

# {servo.name}: {servo.source}
[sensor]
encoder_resolution_rad = {servo.angle_step_rad:.6f}
encoder_side = "output"
velocity_resolution_rad_s = {servo.speed_step_rad_s:.6f}
{backlash}detection_noise_px = 0.1
dropped_frame_probability = 0.0
max_smear_px = 6.0

[rendering]
blur_px = 0.7
noise_grey = 4.0
supersampling = 1
black_grey = 50.0
white_grey = 190.0
background_grey = 110.0

[assumptions]
{assumptions}
"""


def _joints(ruler: Ruler, part: str, side: float) -> str:
    """Both joints of an eye, or of the neck, from the plate outwards."""
    up = (ruler.height - ruler.lens_above) / 1000.0
    first_up, second_up = (0.0, up) if ruler.first == "pan" else (up, 0.0)
    ahead = ruler.axes_ahead / 1000.0
    origins = {
        ruler.first: (side * ruler.axes_apart / 1000.0, 0.0 - first_up, 0.0),
        "tilt" if ruler.first == "pan" else "pan": (0.0, 0.0 - second_up, ahead),
    }
    text = ""
    for joint, (x, y, z) in origins.items():
        reach, axis = (ruler.pan, [0, 1, 0]) if joint == "pan" else (ruler.tilt, [1, 0, 0])
        text += f"""
[[joints]]
name = "{joint if part == "both" else f"{part}_{joint}"}"
part = "{part}"
origin_m = [{x:.4f}, {y:.4f}, {z:.4f}]
axis = {axis}
lower_rad = {-radians(reach):.4f}               # {reach:g} degrees to either side
upper_rad = {radians(reach):.4f}
velocity_rad_s = {ruler.speed:.3f}            # {_speed_note(ruler)}
acceleration_rad_s2 = {ruler.acceleration:g}
"""
    return text


def _speed_note(ruler: Ruler) -> str:
    servo = ruler.servo
    if ruler.speed != servo.speed_rad_s:
        return "as stated"
    return f"{servo.name}: {servo.rev_min:g} rev/min without load at {servo.volts:g} V"


def _eye(ruler: Ruler, eye: str, side: float) -> str:
    """The camera of an eye, in its last joint's frame."""
    aside = ruler.baseline - (ruler.axes_apart if ruler.mount == "turrets" else 0.0)
    x = round(side * aside / 1000.0, 4) + 0.0
    y, z = 0.0 - ruler.lens_above / 1000.0, ruler.lens_ahead / 1000.0
    width, height = ruler.size
    return f"""
[[eyes]]
name = "{eye}"
focal_px = [{ruler.focal:.1f}, {ruler.focal:.1f}]       # {ruler.view_note}
principal_px = [{(width - 1) / 2:g}, {(height - 1) / 2:g}]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
position_m = [{x:.4f}, {y:.4f}, {z:.4f}]
"""
