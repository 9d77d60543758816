"""What a robot's loop has otherwise than its model says: names, units and ranges.

One table for what a simulated plant takes as options, what a variation draws for each trial, and
what margins are measured in.
"""

from collections.abc import Callable
from math import inf
from typing import Final, NamedTuple

from vergence.models.head import HeadModel

_LATE_S: Final = 1.0
"""What every delay and lag is shorter than, s."""
_ONSET_S: Final = 10.0


class Imperfection(NamedTuple):
    """One quantity of the loop."""

    unit: str
    least: float
    most: float
    """The greatest value; times end before it."""
    of_head: Callable[[HeadModel], float] | None = None
    """What it is where nothing is said, by the head's model; None for `otherwise`."""
    otherwise: float = 0.0
    by_actuator: bool = False
    """Whether each actuator has its own."""


IMPERFECTIONS: Final[dict[str, Imperfection]] = {
    "latency_s": Imperfection("s", 0.0, _LATE_S, lambda head: head.timing.latency_s),
    "lag_s": Imperfection("s", 0.0, _LATE_S, lambda head: head.timing.lag_s),
    "detection_noise_px": Imperfection("px", 0.0, inf, lambda head: head.sensor.detection_noise_px),
    "dropped_frame_probability": Imperfection(
        "1", 0.0, 1.0, lambda head: head.sensor.dropped_frame_probability
    ),
    "jitter_s": Imperfection("s", 0.0, _LATE_S),
    "missed_detection_probability": Imperfection("1", 0.0, 1.0),
    "outlier_probability": Imperfection("1", 0.0, 1.0),
    "outlier_px": Imperfection("px", 0.0, inf, otherwise=100.0),
    "frame_rate_hz": Imperfection("Hz", 1.0, 1000.0, lambda head: head.timing.frame_rate_hz),
    "frame_phase": Imperfection("1", 0.0, 1.0),
    "clock_drift": Imperfection("1", -0.1, 0.1),
    "command_latency_s": Imperfection(
        "s", 0.0, _LATE_S, lambda head: head.timing.command_latency_s
    ),
    "feedback_latency_s": Imperfection(
        "s", 0.0, _LATE_S, lambda head: head.timing.feedback_latency_s
    ),
    "angle_noise_rad": Imperfection("rad", 0.0, inf),
    "speed_noise_rad_s": Imperfection("rad/s", 0.0, inf),
    "acceleration_ratio": Imperfection("1", 0.01, 100.0, otherwise=1.0),
    "torque_falloff": Imperfection("1", 0.0, 0.8),
    "onset_s": Imperfection("s", 0.0, _ONSET_S),
    "speed_gain": Imperfection("1", 0.01, 2.0, otherwise=1.0, by_actuator=True),
    "backlash_rad": Imperfection("rad", 0.0, 0.2, by_actuator=True),
}
"""By name, in the order in which a trial draws them: what comes later is appended.

Backlash is that of the head's actuators where nothing is said."""

SCALARS: Final = tuple(name for name, one in IMPERFECTIONS.items() if not one.by_actuator)
"""Those of which a trial has one number."""
OWN: Final = tuple(name for name, one in IMPERFECTIONS.items() if one.by_actuator)
"""Those of which each actuator has its own."""


def expected(name: str) -> str:
    """What a message says of the values that an imperfection may have."""
    one = IMPERFECTIONS[name]
    if one.unit == "s":
        return f"seconds from {one.least:g} to below {one.most:g} (is it in milliseconds?)"
    if one.most == inf:
        return f"at least {one.least:g}"
    return f"{one.least:g} to {one.most:g}"


def is_within(name: str, low: float, high: float) -> bool:
    """Whether an imperfection may have all values of a range."""
    one = IMPERFECTIONS[name]
    return one.least <= low and (high < one.most if one.unit == "s" else high <= one.most)
