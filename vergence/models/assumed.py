"""Assumed timing, sensor and looks of heads whose source does not tell them."""

from typing import Any, Final

_TABLES: Final[dict[str, dict[str, Any]]] = {
    "timing": {
        "control_rate_hz": (30.0, 120.0, 60.0),
        "frame_rate_hz": (30.0, 60.0, 30.0),
        "latency_s": (0.0, 8 / 120, 0.1),
        "exposure_s": (0.0, 0.0, 0.01),
        "lag_s": (0.0, 0.03, 0.03),
    },
    "sensor": {
        "detection_noise_px": (0.1, 0.05, 0.1),
        "encoder_resolution_rad": 0.0,
        "velocity_resolution_rad_s": 0.0,
        "dropped_frame_probability": 0.0,
        "max_smear_px": 6.0,
    },
    "rendering": {
        "blur_px": (0.7, 0.5, 0.7),
        "noise_grey": (2.0, 2.0, 4.0),
        "supersampling": (2, 1, 1),
        "black_grey": (40.0, 40.0, 50.0),
        "white_grey": (210.0, 210.0, 190.0),
        "background_grey": (120.0, 120.0, 110.0),
    },
}
"""Values by key: one, or those of a calibrated pair, of a robot's description, and by a ruler."""

PAIR, ROBOT, RULER = (
    {
        table: {key: one[kind] if isinstance(one, tuple) else one for key, one in values.items()}
        for table, values in _TABLES.items()
    }
    for kind in range(3)
)

# Reasons for the values by key of the head file.
PAIR_REASONS: Final = {
    "timing": "not in a calibration: 30 frames a second without delay",
    "sensor.detection_noise_px": (
        "not in a calibration: 0.1 px is what detectors of printed boards scatter by"
    ),
    "rendering": "not in a calibration: a webcam's blur, noise and contrast",
}
ROBOT_REASONS: Final = {
    "timing.control_rate_hz": "not in such a file: what a servo bus of few joints reaches",
    "timing.frame_rate_hz": "not in such a file: that of common USB cameras",
    "timing.latency_s": "not in such a file: that of a USB camera with detection, 67 ms",
    "timing.exposure_s": "not in such a file: a short one in good light",
    "timing.lag_s": "not in such a file: that of common servos, 30 ms",
    "sensor": "not in such a file: detection as in docs/vision.md, ideal encoders, no lost images",
    "rendering": "not in such a file: how simulated images look, that of the simulated preset",
}
RULER_REASONS: Final = {
    "timing.latency_s": "common for webcams over USB: measure-delay measures it",
    "timing.lag_s": "common for such servos: measure-delay measures it",
    "timing.exposure_s": "10 ms, a lit room",
    "sensor.detection_noise_px": "0.1 px, of a board or tag in a sharp image",
    "eyes.principal_px": "the middle of the image, until the cameras are calibrated",
    "eyes.distortion": "none, until the cameras are calibrated",
    "rendering": "a webcam's blur, noise and contrast",
}
