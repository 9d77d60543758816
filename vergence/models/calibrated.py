"""Record of a camera calibration, as a head file stores it."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrationRecord:
    """Origin and uncertainty of calibrated cameras."""

    target: str
    """The board, see `vergence.vision.parse_target`."""
    views: int
    """Number of pairs of photographs used."""
    rms_px: float
    """Root mean square of the reprojection errors of these pairs, as lengths in pixels."""
    rms_heldout_px: float
    """Root mean square of the reprojection errors of held-out pairs (cross-validation), px."""
    corners_sha256: str
    """SHA-256 of the measured corners."""
    versions: str
    """Versions of the programs that measured and solved."""
    sigma: Mapping[str, float]
    """Standard deviations by the names of `HeadModel.parameters`, in their units; those of
    `right.head_eye` are of the right camera's pose in the left camera's frame."""
