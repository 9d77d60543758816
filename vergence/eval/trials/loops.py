"""The loops of scenarios: what robots that people own make of times, motors and images."""

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
TICK_RAD_S: Final = 0.023980823922105444
TICKS: Final = {
    "sensor": {
        # 12 bits a turn, and the speeds of Dynamixel's X series
        "encoder_resolution_rad": 0.0015339807878856412,
        "velocity_resolution_rad_s": TICK_RAD_S,
        "command_resolution_rad_s": TICK_RAD_S,
    }
}
