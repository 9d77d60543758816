"""Head file of a calibrated head."""

from dataclasses import replace
from typing import Final

from vergence.calibration.head.calibrate_head import HeadCalibration
from vergence.eval.reporting.runs import package_versions
from vergence.models.calibrated import CalibrationRecord
from vergence.models.files.head_toml import check_head_name, head_to_toml
from vergence.models.head import HeadModel

_RECORDED_PACKAGES: Final = ("vergence", "numpy", "scipy", "opencv-python-headless")
_REPLACED_ASSUMPTIONS: Final = (
    "links",
    "eyes",
    "joints.origin_m",
    "joints.rpy_rad",
    "joints.axis",
    "frame",
)
"""Prefixes of the keys of assumptions that a calibration replaces by estimates."""


def calibrated_head(calibration: HeadCalibration, sha256: str, name: str) -> HeadModel:
    """Make a calibrated head with origin (`sha256` of measurements) and uncertainty."""
    check_head_name(name)
    names, prior_sigma = (
        calibration.nominal_head.parameters().names,
        calibration.solution.problem.prior_sigma,
    )
    sigma = {
        each: deviation
        for each, deviation, spread in zip(
            names, calibration.sigma.tolist(), prior_sigma.tolist(), strict=True
        )
        if spread > 0.0
    }
    assumptions = {
        key: why
        for key, why in calibration.nominal_head.assumptions.items()
        if not key.startswith(_REPLACED_ASSUMPTIONS)
    }
    record = CalibrationRecord(
        target=str(calibration.frames.target),
        views=int(calibration.kept_views.sum()),
        rms_px=calibration.rms_px,
        rms_heldout_px=calibration.rms_heldout_px,
        corners_sha256=sha256,
        versions=", ".join(
            f"{name} {each}" for name, each in package_versions(_RECORDED_PACKAGES).items()
        ),
        sigma=sigma,
    )
    return replace(calibration.head, name=name, assumptions=assumptions, calibration=record)


def head_file_text(calibration: HeadCalibration, sha256: str, name: str) -> str:
    """Write the head file of `calibrated_head` as TOML text."""
    return head_to_toml(calibrated_head(calibration, sha256, name))
