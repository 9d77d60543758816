"""Heads of all shapes as TOML, for tests: what no preset has.

`tied`: a neck of three, a common tilt, version and vergence. `mis`: two tilts, not quite parallel,
on one actuator. `panfirst`: four motors, pan before tilt. `common`: both eyes on one pan and tilt,
never both on a target. `vergeonly`: eyes that only pan, on a neck that pans. `pair`: eyes that do
not move.
"""

from collections.abc import Sequence
from typing import Final

from vergence.models import HeadModel, parse_head

LIMITS: Final = (
    "lower_rad = -0.9\nupper_rad = 0.9\nvelocity_rad_s = 5.0\nacceleration_rad_s2 = 80.0\n"
)
IMAGE: Final = "[image]\nwidth_px = 320\nheight_px = 240\n"
LOOP: Final = """
[timing]
control_rate_hz = 120.0
frame_rate_hz = 60.0
latency_s = 0.06666666666666667
exposure_s = 0.004
lag_s = 0.03

[sensor]
detection_noise_px = 0.05
encoder_resolution_rad = 0.0005
velocity_resolution_rad_s = 0.01
dropped_frame_probability = 0.0
max_smear_px = 6.0

[rendering]
blur_px = 0.7
noise_grey = 4.0
supersampling = 1
black_grey = 50.0
white_grey = 190.0
background_grey = 110.0
"""
CENTRE: Final = (0.0, 0.0, 0.0)
Vector = Sequence[float]


def joint(name: str, part: str, origin: Vector, axis: Vector, limits: str = LIMITS) -> str:
    place = f"origin_m = {list(map(float, origin))}\naxis = {list(map(float, axis))}\n"
    return f'[[joints]]\nname = "{name}"\npart = "{part}"\n{place}{limits}'


def eyes(left: Vector = CENTRE, right: Vector = CENTRE) -> str:
    """Both cameras, at places in their eyes' last links."""
    return "".join(
        f'[[eyes]]\nname = "{name}"\nfocal_px = [343.0, 343.0]\nprincipal_px = [159.5, 119.5]\n'
        f"distortion = [0.0, 0.0, 0.0, 0.0, 0.0]\nposition_m = {list(map(float, at))}\n"
        for name, at in (("left", left), ("right", right))
    )


def actuator(name: str, joints: str, limits: str = LIMITS) -> str:
    return f'[[actuators]]\nname = "{name}"\njoints = {{ {joints} }}\n{limits}'


TEXTS: Final = {
    "tied": "".join((
        joint("neck_pitch", "neck", CENTRE, (1, 0, 0)),
        joint("neck_roll", "neck", CENTRE, (0, 0, 1)),
        joint("neck_yaw", "neck", (0, -0.1, 0), (0, 1, 0)),
        joint("eyes_tilt", "both", (0, -0.05, 0.05), (1, 0, 0)),
        joint("left_pan", "left", (-0.034, 0, 0), (0, 1, 0), ""),
        joint("right_pan", "right", (0.034, 0, 0), (0, 1, 0), ""),
        IMAGE, eyes(),
        actuator("tilt", "eyes_tilt = 1.0"),
        actuator("version", "left_pan = 1.0, right_pan = 1.0"),
        actuator("vergence", "left_pan = 0.5, right_pan = -0.5",
                 LIMITS.replace("-0.9", "0.0").replace("0.9", "1.2")),
    )),
    "mis": "".join((
        joint("left_tilt", "left", (-0.034, 0, 0), (1, 0.01, 0)),
        joint("left_pan", "left", (0, 0, 0.01), (0, 1, 0)),
        joint("right_tilt", "right", (0.034, 0.001, 0), (1, 0, 0.01)),
        joint("right_pan", "right", (0, 0, 0.01), (0, 1, 0)),
        IMAGE, eyes(),
        actuator("tilt", "left_tilt = 1.0, right_tilt = 1.0"),
        actuator("left_pan", "left_pan = 1.0"),
        actuator("right_pan", "right_pan = 1.0"),
    )),
    "panfirst": "".join((
        joint("left_pan", "left", (-0.1, 0, 0), (0, 1, 0)),
        joint("left_tilt", "left", (0, -0.05, 0.02), (1, 0, 0)),
        joint("right_pan", "right", (0.1, 0, 0), (0, 1, 0)),
        joint("right_tilt", "right", (0, -0.05, 0.02), (1, 0, 0)),
        IMAGE, eyes((0, -0.02, 0.03), (0, -0.02, 0.03)),
    )),
    "common": "".join((
        joint("pan", "both", CENTRE, (0, 1, 0)),
        joint("tilt", "both", (0, -0.05, 0.02), (1, 0, 0)),
        IMAGE, eyes((-0.05, 0, 0), (0.05, 0, 0)),
    )),
    "vergeonly": "".join((
        joint("pan", "neck", CENTRE, (0, 1, 0)),
        joint("left_pan", "left", (-0.03, 0, 0), (0, 1, 0)),
        joint("right_pan", "right", (0.03, 0, 0), (0, 1, 0)),
        IMAGE, eyes(),
    )),
    "pair": IMAGE + eyes((-0.05, 0, 0), (0.05, 0, 0)),
}  # fmt: skip
MOVING: Final = ("tied", "mis", "panfirst", "common", "vergeonly")
"""Those whose eyes move."""


def text_of(name: str) -> str:
    return f'name = "{name}"\n{TEXTS[name]}{LOOP}'


def head_of(name: str) -> HeadModel:
    return parse_head(text_of(name))
