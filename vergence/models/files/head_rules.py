"""Rules for the values of a head file: a name valid as a file name, and numbers in their ranges.

Fields with one unit share one range.
"""

import re
from collections.abc import Callable
from typing import Final

from vergence.models.cameras import BROWN_CONRADY
from vergence.models.files.toml_table import Rule

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
