"""Coverage of a recording, and advice on further recording."""

from typing import Final

import numpy as np

from vergence.calibration.head.collect import CollectedRecording
from vergence.calibration.head.frames import HeadFrames
from vergence.models.head import HeadModel
from vergence.models.parts import EYE_NAMES, NECK, FloatArray

_CELLS: Final = 4
"""Cells along each side of an image in which coverage is counted (chosen)."""
_ENOUGH_COVERAGE_PERCENT: Final = 80.0
"""Percentage of cells that is enough coverage (chosen)."""
_UNMOVED_RANGE_RAD: Final = 0.1
"""Range of angles up to which a joint counts as unmoved, rad (chosen: 6 degrees)."""
_FAR_M: Final = 1.5
"""Distance of a board that is far enough to calibrate depth far away, m (chosen)."""


def image_coverage_percent(head: HeadModel, frames: HeadFrames) -> FloatArray:
    """(2,) by eye, percentage of the cells of the image that have had a corner."""
    found = []
    for eye in range(2):
        seen = frames.pixels[eye][frames.seen[eye]]
        cell = np.clip(_CELLS * (seen + 0.5) / head.cameras.size[eye], 0, _CELLS - 1).astype(int)
        found.append(100.0 * len(np.unique(cell, axis=0)) / _CELLS**2)
    return np.array(found)


def advise_recording(
    head: HeadModel, recording: CollectedRecording, frames: HeadFrames
) -> list[str]:
    """Advise how to make the recording more informative, a line each."""
    lines = []
    there = np.array([bool(name) for name in head.joints[NECK]])
    ranges = np.ptp(frames.joint_positions[:, NECK], axis=0)
    if there.any() and not (ranges[there] > _UNMOVED_RANGE_RAD).any():
        lines.append(
            "the neck has not moved: where the eyes sit in the neck stays as it was believed"
        )
    if not frames.placement.any():
        lines.append(
            "the board stood in one place: put it at another distance, and run this again with "
            "--moved"
        )
    if recording.preview is not None:
        eyes = (head.base_pose(head.rest()) @ head.camera_poses(head.rest()))[:, :3, 3].mean(axis=0)
        away = np.linalg.norm(recording.preview.boards.translation - eyes, axis=-1)
        if away.max() < _FAR_M:
            lines.append(
                f"the board was never farther than {away.max():.2g} m: one beyond {_FAR_M:g} m "
                "determines depth far away better"
            )
    for eye, percent in zip(EYE_NAMES, image_coverage_percent(head, frames), strict=True):
        if percent < _ENOUGH_COVERAGE_PERCENT:
            lines.append(f"the board was seen in {percent:.0f} % of the {eye} image alone")
    return lines
