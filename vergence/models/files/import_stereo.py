"""Import of a calibrated stereo pair as a head whose eyes do not move."""

from dataclasses import asdict
from typing import Final

import numpy as np

from vergence.models.calibrated import CalibrationRecord
from vergence.models.files.head_toml import check_head_name
from vergence.models.files.stereo import StereoPair
from vergence.models.files.toml_text import toml_text
from vergence.models.joints import EYE_NAMES
from vergence.models.response import CameraResponse

_ASSUMED: Final[dict[str, dict[str, float | int]]] = {
    "timing": {
        "control_rate_hz": 30.0,
        "frame_rate_hz": 30.0,
        "latency_s": 0.0,
        "exposure_s": 0.0,
        "lag_s": 0.0,
    },
    "sensor": {
        "detection_noise_px": 0.1,
        "encoder_resolution_rad": 0.0,
        "velocity_resolution_rad_s": 0.0,
        "dropped_frame_probability": 0.0,
        "max_smear_px": 6.0,
    },
    "rendering": {
        "blur_px": 0.7,
        "noise_grey": 2.0,
        "supersampling": 2,
        "black_grey": 40.0,
        "white_grey": 210.0,
        "background_grey": 120.0,
    },
}
"""Assumed values for the parts of a head that a stereo calibration does not contain."""
_REASONS: Final = {
    "timing": "not in a calibration: 30 frames a second without delay",
    "sensor.detection_noise_px": (
        "not in a calibration: 0.1 px is what detectors of printed boards scatter by"
    ),
    "rendering": "not in a calibration: a webcam's blur, noise and contrast",
}


def stereo_pair_to_head_toml(
    pair: StereoPair,
    name: str,
    *,
    noise_px: float | None = None,
    calibration: CalibrationRecord | None = None,
    response: CameraResponse | None = None,
) -> str:
    """TOML text of a pair's head; N is midway between the cameras, z along the mean axis."""
    check_head_name(name)
    cameras = (pair.left, pair.right)
    positions = (np.zeros(3), pair.baseline_m)
    rotations = (np.eye(3), pair.rotation.T)
    sizes = [camera.size_fields() for camera in cameras]
    one_size = sizes[0] == sizes[1]
    eyes = [
        {"name": EYE_NAMES[eye]}
        | ({} if one_size else sizes[eye])
        | ({} if response is None else {"response": response})
        | cameras[eye].fields()
        | {"position_m": positions[eye].tolist(), "rotation": rotations[eye].tolist()}
        for eye in range(2)
    ]
    guesses = {
        f"eyes.{eye}.distortion": camera.lens_assumption
        for eye, camera in zip(EYE_NAMES, cameras, strict=True)
        if camera.lens_assumption
    }
    sensor, reasons = dict(_ASSUMED["sensor"]), dict(_REASONS)
    if noise_px is not None:
        sensor["detection_noise_px"] = noise_px
        del reasons["sensor.detection_noise_px"]
    return toml_text(
        {"name": name}
        | ({"image": sizes[0]} if one_size else {})
        | _ASSUMED
        | {"sensor": sensor, "eyes": eyes, "assumptions": {**reasons, **guesses}}
        | ({"calibration": asdict(calibration)} if calibration else {})
    )
