"""How a head's cameras were calibrated: what a head file keeps of it."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CalibrationRecord:
    """Origin and uncertainty of calibrated cameras."""

    target: str
    """The board, see `vergence.vision.parse_target`."""
    views: int
    """Pairs of photographs that went in."""
    rms_px: float
    """Root mean square of what they leave, as lengths in pixels."""
    rms_heldout_px: float
    """The same of pairs that the cameras did not know (cross-validation)."""
    corners_sha256: str
    """Hash of the corners that were measured."""
    versions: str
    """Of the programs that measured and solved."""
    sigma: Mapping[str, float]
    """Standard deviations by the names of `HeadModel.parameters`, in their units; those of
    `right.head_eye` are of the right camera's pose in the left camera's frame."""
