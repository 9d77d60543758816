"""The loops of scenarios: what robots that people own make of times, motors and images."""

from dataclasses import replace
from typing import Any, Final

from vergence.envs.plants.variation import Variation
from vergence.eval.trials.twin_errors import TWIN_ERRORS

LATEST_ONSET_S: Final = 0.6
_FAULTS: Final[dict[str, Any]] = {
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
"""What two small servos and two cameras on a bus of one's own make of a loop."""
HARDWARE: Final = Variation(latency_s=(0.04, 0.13), acceleration_ratio=(0.4, 1.2), **_FAULTS)
WEBCAM: Final = Variation(
    latency_s=(0.06, 0.13),
    # 30 to 120 rad/s^2
    acceleration_ratio=(30.0 / 80.0, 120.0 / 80.0),
    **_FAULTS,
)
DESK: Final = replace(
    WEBCAM,
    # a hobby servo makes its speed of its own angles, over several of its own periods
    speed_filter_s=(0.0, 0.08),
    speed_latency_s=(0.0, 0.02),
    # a third have no speed to report, and their angles are subtracted from period to period: at
    # 60 Hz, half a period is two thirds of this
    speed_span_s=(0.0, 0.75 / 60.0),
    # gains as delivered, with an integral term, on loads that they were not made for
    overshoot=(0.0, 0.3),
    # half-duplex lines at a megabit with long cables: from none to one packet in twenty
    lost_command_probability=(0.0, 0.05),
    # a desktop's scheduler, a garbage collection, a USB hub: at most one in 8 s, of up to 0.1 s
    stall_probability=(0.0, 0.002),
    stall_s=(0.1, 0.1),
    # lamps and reflections: at most one in 17 s, for up to 6 frames
    false_detection_probability=(0.0, 0.002),
    false_detection_s=(0.2, 0.2),
    false_detection_px=(100.0, 100.0),
    # no trigger: anything up to the time between two frames
    skew_s=(0.0, 1.0 / 30.0),
)
"""Two hobby turrets and two webcams that nothing keeps in step: `WEBCAM`, and all the rest.

The sizes are what such parts are known for, not measured on a head."""
TICK_RAD_S: Final = 0.023980823922105444
TICKS: Final = {
    "sensor": {
        # 12 bits a turn, and the speeds of Dynamixel's X series
        "encoder_resolution_rad": 0.0015339807878856412,
        "velocity_resolution_rad_s": TICK_RAD_S,
        "command_resolution_rad_s": TICK_RAD_S,
    }
}
