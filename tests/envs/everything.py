"""All that a trial can draw, in ranges in which each of it shows."""

from typing import Final

MODEL_ERRORS: Final = {
    "joint_offset_rad": 0.01, "principal_px": 1.0, "distortion": 0.01, "common_tilt_rad": 0.01,
}  # fmt: skip
LOOP: Final = {
    "latency_s": (0.03, 0.13), "lag_s": (0.015, 0.06), "detection_noise_px": (0.0, 0.15),
    "dropped_frame_probability": (0.0, 0.3), "jitter_s": (0.0, 0.02),
    "missed_detection_probability": (0.0, 0.2), "outlier_probability": (0.0, 0.1),
    "outlier_px": (50.0, 100.0), "frame_rate_hz": (25.0, 150.0), "frame_phase": (0.0, 1.0),
    "clock_drift": (-0.01, 0.01), "command_latency_s": (0.0, 0.02),
    "feedback_latency_s": (0.0, 0.02), "angle_noise_rad": (0.0, 0.001),
    "speed_noise_rad_s": (0.0, 0.05), "acceleration_ratio": (0.4, 1.2),
    "torque_falloff": (0.0, 0.5), "onset_s": (0.0, 0.2), "speed_gain": (0.85, 1.15),
    "backlash_rad": (0.0, 0.003), "speed_filter_s": (0.0, 0.04), "speed_latency_s": (0.0, 0.02),
    "speed_span_s": (0.0, 0.04), "lost_command_probability": (0.0, 0.1),
    "stall_probability": (0.0, 0.02), "stall_s": (0.0, 0.1),
    "false_detection_probability": (0.0, 0.02), "false_detection_s": (0.0, 0.2),
    "false_detection_px": (50.0, 100.0), "overshoot": (0.0, 0.4), "skew_s": (0.0, 0.03),
}  # fmt: skip
EVERYTHING: Final = {**LOOP, "model_errors": MODEL_ERRORS}
