"""Between which values margins are looked for, from which one on, and what people call them.

A range goes beyond what robots that people own do, and ends where nothing more is to be learned.
Onset and phase are no faults; a controller that minds them reads what it cannot know.
"""

from typing import Final, NamedTuple

from vergence.envs.plants.imperfections import IMPERFECTIONS
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head import HeadModel


class Searched(NamedTuple):
    """Where the margins of one imperfection are looked for, and how they are shown."""

    label: str
    least: float
    most: float
    """In the unit of `IMPERFECTIONS`, as `least`."""
    unit: str
    """The unit in which people see it; empty for a ratio."""
    scale: float = 1.0
    """What it is multiplied by for that."""


SEARCHED: Final[dict[str, Searched]] = {
    "latency_s": Searched("image latency", 0.0, 0.3, "ms", 1e3),
    "frame_rate_hz": Searched("frame rate", 10.0, 240.0, "Hz"),
    "frame_phase": Searched("camera phase", 0.0, 1.0, "of a frame"),
    "clock_drift": Searched("camera clock slow by", -0.05, 0.05, "%", 100.0),
    "jitter_s": Searched("frame jitter", 0.0, 0.1, "ms", 1e3),
    "dropped_frame_probability": Searched("dropped frames", 0.0, 0.9, "%", 100.0),
    "missed_detection_probability": Searched("missed detections", 0.0, 0.9, "%", 100.0),
    "outlier_probability": Searched("outliers", 0.0, 0.3, "%", 100.0),
    "outlier_px": Searched("outlier size", 0.0, 300.0, "px"),
    "detection_noise_px": Searched("detection noise", 0.0, 3.0, "px"),
    "command_latency_s": Searched("command latency", 0.0, 0.1, "ms", 1e3),
    "feedback_latency_s": Searched("feedback latency", 0.0, 0.1, "ms", 1e3),
    "angle_noise_rad": Searched("encoder noise, angle", 0.0, 0.01, "mrad", 1e3),
    "speed_noise_rad_s": Searched("encoder noise, speed", 0.0, 0.5, "rad/s"),
    # a joint without lag is no dynamics
    "lag_s": Searched("joint lag", 0.001, 0.2, "ms", 1e3),
    "acceleration_ratio": Searched("acceleration by model", 0.1, 3.0, ""),
    "torque_falloff": Searched("torque falloff", 0.0, 0.8, ""),
    "speed_gain": Searched("speed gain", 0.4, 1.6, ""),
    "backlash_rad": Searched("backlash", 0.0, 0.02, "mrad", 1e3),
    "onset_s": Searched("onset", 0.0, 0.5, "s"),
}
"""By name, in the order of tables and figures: the camera, the sensors, the motors, the target.

An imperfection of each actuator's own has the same value for all of them."""


class Range(NamedTuple):
    """Where the margins of one imperfection are looked for in one scenario."""

    low: float
    expected: float
    """What a scenario has that does not move it; where that is drawn anew for each trial, what the
    model says, or the end of the drawn range that is nearest to it."""
    high: float


def range_of(name: str, scenario: Scenario, head: HeadModel) -> Range:
    """Where the margins of an imperfection are looked for; the expected value is always within.

    Args:
        name: the imperfection.
        scenario: what draws, or does not.
        head: the model that the controller knows.
    """
    one = IMPERFECTIONS[name]
    expected = one.otherwise if one.of_head is None else one.of_head(head)
    if name == "backlash_rad":
        expected = float(head.actuation.backlash.max())
    drawn = None if scenario.variation is None else getattr(scenario.variation, name)
    if drawn is not None:
        expected = min(max(expected, drawn[0]), drawn[1])
    searched = SEARCHED[name]
    return Range(min(searched.least, expected), expected, max(searched.most, expected))


def matters(name: str, scenario: Scenario) -> bool:
    """Whether anything follows from an imperfection: the size of outliers where there are any."""
    if name != "outlier_px":
        return True
    variation = scenario.variation
    return variation is not None and variation.greatest("outlier_probability", 0.0) > 0.0
