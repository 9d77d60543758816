"""Calibration from one recording as a job: in this process, in another one, or on a cluster."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from vergence.calibration.head.calibrate import HeadCalibration, calibrate_head
from vergence.calibration.head.judge import UnobservableDirection, unobservable_directions
from vergence.calibration.head.recording import HeadRecording
from vergence.calibration.head.report import result_document, write_run
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.head_file import check_head_name, head_to_toml
from vergence.models.parts import CalibrationRecord
from vergence.reporting.runs import package_versions

_RECORDED_PACKAGES: Final = ("vergence", "numpy", "scipy", "opencv-python-headless")
_REPLACED_ASSUMPTIONS: Final = (
    "links", "eyes", "joints.origin_m", "joints.rpy_rad", "joints.axis", "joints.alpha_rad",
    "joints.a_m", "joints.d_m", "joints.offset_rad", "frame",
)  # fmt: skip
"""Prefixes of the keys of assumptions that a calibration replaces by estimates."""


@dataclass(frozen=True, kw_only=True)
class HeadOutcome:
    """Result of a calibration job."""

    head_file: str = ""
    """Text of the head file; empty if the recording was refused."""
    document: Mapping[str, Any] = field(default_factory=dict)
    unobservable: tuple[UnobservableDirection, ...] = ()
    files: Mapping[str, bytes] = field(default_factory=dict)
    """The run folder's files by name."""
    refusal: str = ""
    """Reason of a refusal; empty if there is a head."""


@dataclass(frozen=True, kw_only=True)
class HeadJob:
    """The calibration of a head from one recording, see `calibrate_head`."""

    head: HeadModel
    recording: HeadRecording
    estimate_cameras: bool
    terms: tuple[str, ...]
    name: str
    """Name of the calibrated head."""
    head_file_name: str
    recording_path: str

    def __call__(self, progress: Callable[[float], None] | None = None) -> HeadOutcome:
        """Calibrate the head and make its files."""
        recorded = self.recording
        try:
            found = calibrate_head(
                self.head, recorded.frames, estimate_cameras=self.estimate_cameras,
                terms=self.terms, progress=progress,
            )  # fmt: skip
        except ConfigurationError as error:
            return HeadOutcome(refusal=str(error))
        text = head_file_text(found, recorded.sha256, self.name)
        dark = unobservable_directions(found.solution)
        provenance = {
            "recording": self.recording_path,
            "files": ", ".join(recorded.files),
            "target": str(recorded.frames.target),
            "sha256": recorded.sha256,
        }
        with tempfile.TemporaryDirectory(prefix="vergence-") as folder:
            write_run(Path(folder), found, dark, text, self.head_file_name, provenance)
            files = {each.name: each.read_bytes() for each in Path(folder).iterdir()}
        told = {
            **result_document(found, dark),
            "recording": self.recording_path,
            "remarks": [*recorded.remarks, *found.remarks],
            "not_read": list(recorded.read_errors),
        }
        return HeadOutcome(head_file=text, document=told, unobservable=dark, files=files)


def head_file_text(calibration: HeadCalibration, sha256: str, name: str) -> str:
    """TOML text of a calibrated head, with origin (`sha256` of measurements) and uncertainty."""
    check_head_name(name)
    names = calibration.nominal_head.parameters().names
    free = calibration.solution.problem.prior_sigma > 0.0
    numbers = zip(names, calibration.sigma.tolist(), free, strict=True)
    sigma = {each: deviation for each, deviation, is_free in numbers if is_free}
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
    return head_to_toml(
        replace(calibration.head, name=name, assumptions=assumptions, calibration=record)
    )
