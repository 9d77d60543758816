"""Control loops of the scenarios: timing, motor and image faults of typical hobby robots."""

from dataclasses import replace
from typing import Any, Final

from vergence.envs.plants.conditions import Variation
from vergence.eval.trials.twin_errors import TWIN_ERRORS

LATEST_ONSET_S: Final = 0.6
"""Latest drawn onset of a target, s (chosen)."""
_COMMON_RANGES: Final[dict[str, Any]] = {
    "frame_phase": (0.0, 1.0),
    "clock_drift": (-0.001, 0.001),
    "jitter_s": (0.0, 2.0 / 120.0),
    "command_latency_s": (0.0, 0.017),
    "feedback_latency_s": (0.0, 0.017),
    "lag_s": (0.015, 0.06),
    "speed_gain": (0.85, 1.15),
    "backlash_rad": (0.0, 0.003),
    "detection_noise_px": (0.0, 0.5),
    "dropped_frame_probability": (0.1, 0.1),
    "missed_detection_probability": (0.05, 0.05),
    "outlier_probability": (0.01, 0.01),
    "outlier_px": (100.0, 100.0),
    "onset_s": (0.1, LATEST_ONSET_S),
    "model_errors": TWIN_ERRORS,
}
"""Ranges for two small servos per eye and two cameras, on a bus of their own."""
HARDWARE_LOOP: Final = Variation(
    latency_s=(0.04, 0.13), acceleration_ratio=(0.4, 1.2), **_COMMON_RANGES
)
WEBCAM_LOOP: Final = Variation(
    latency_s=(0.06, 0.13),
    # 30 to 120 rad/s^2
    acceleration_ratio=(30.0 / 80.0, 120.0 / 80.0),
    **_COMMON_RANGES,
)
DESK_LOOP: Final = replace(
    WEBCAM_LOOP,
    # a hobby servo differentiates its own angles over several of its own periods
    speed_filter_s=(0.0, 0.08),
    speed_latency_s=(0.0, 0.02),
    # a third of the trials have no reported speed and take the difference of angles over one
    # period: this happens from half a period on, and at 60 Hz that is two thirds of the range
    speed_span_s=(0.0, 0.75 / 60.0),
    # factory gains, with an integral term, on loads for which they were not tuned
    overshoot=(0.0, 0.3),
    # half-duplex lines at 1 Mbit/s with long cables: up to one packet in twenty
    lost_command_probability=(0.0, 0.05),
    # a desktop's scheduler, a garbage collection, a USB hub: on average at most one in 8 s, of up
    # to 0.1 s
    stall_probability=(0.0, 0.002),
    stall_s=(0.1, 0.1),
    # lamps and reflections: on average at most one in 17 s, for up to 6 frames
    false_detection_probability=(0.0, 0.002),
    false_detection_s=(0.2, 0.2),
    false_detection_px=(100.0, 100.0),
    # no common trigger: the right eye lags by up to one frame interval
    skew_s=(0.0, 1.0 / 30.0),
)
"""Two hobby turrets and two unsynchronised webcams: `WEBCAM_LOOP` with further faults.

The sizes are typical of such parts, not taken from a real head."""
TICK_RAD_S: Final = 0.023980823922105444
"""Unit of velocity of Dynamixel's X series, 0.229 rev/min, rad/s (physical)."""
DYNAMIXEL_RESOLUTIONS: Final = {
    "sensor": {
        # encoders with 12 bits per turn, and the velocity unit of Dynamixel's X series
        "encoder_resolution_rad": 0.0015339807878856412,
        "velocity_resolution_rad_s": TICK_RAD_S,
        "command_resolution_rad_s": TICK_RAD_S,
    }
}
