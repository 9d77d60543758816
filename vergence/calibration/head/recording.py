"""Recordings of a head in front of a board: logs of a robot, or photographs with joint angles."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vergence.calibration.head.calibrate_head import sort_and_clean_frames
from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.logged import list_logs, read_logs
from vergence.calibration.head.photographed import holds_photographs, read_photographs
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.vision.targets import PlanarTarget


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadRecording:
    """A recording, with frames in the order of time."""

    frames: HeadFrames
    """At least one frame. Placements of the board are numbered without gaps."""
    files: tuple[str, ...]
    """Names of the files that it was read from."""
    remarks: tuple[str, ...]
    """Remarks on data that was left out or does not quite fit, a line each."""
    read_errors: tuple[str, ...]
    """Files that could not be read, a line each."""

    @property
    def sha256(self) -> str:
        """Digest of board, corners, joint angles and placements; rounded to 1e-6 px, 1e-9 rad."""
        frames = self.frames
        sha = hashlib.sha256(str(frames.target).encode())
        for values, digits in ((frames.pixels, 6), (frames.sigma, 6), (frames.joint_positions, 9)):
            # adding 0 makes -0 positive
            rounded = np.round(np.nan_to_num(values, nan=-1.0), digits) + 0.0
            sha.update(rounded.astype("<f8").tobytes())
        sha.update(frames.placement.astype("<i8").tobytes())
        return sha.hexdigest()


def read_recording(
    path: Path,
    head: HeadModel,
    target: PlanarTarget | None = None,
    progress: Callable[[float], None] | None = None,
) -> HeadRecording:
    """Read a recording of a head in front of a board.

    Args:
        path: a robot's log, a folder of such logs, which follow each other in the order of their
            names, or a folder with the photographs of both eyes in `left` and `right` and their
            joint angles in `joints.csv`, `.json` or `.toml`.
        head: the nominal head, from its file.
        target: the board; None for the board named in the logs.
        progress: called with the fraction done.

    Raises:
        VergenceError: it is no recording of that head and that board; the message says why.
    """
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file or folder; expected a recording")
    if holds_photographs(path):
        found = read_photographs(path, head, target, progress)
    else:
        found = read_logs(list_logs(path), head, target, progress)
    if not found.target.size_known:
        raise ConfigurationError(
            f"target: expected a size in mm, which all lengths come from, got {found.target}"
        )
    every = found.frames()
    frames = clean_and_renumber_frames(every)
    if not len(frames.time_s):
        raise ConfigurationError(
            f"{path}: expected frames that show {found.target}, got none in {len(every.time_s)}"
        )
    remarks = list(found.remarks)
    if len(frames.time_s) < len(every.time_s):
        remarks.append(
            f"{len(every.time_s) - len(frames.time_s)} of {len(every.time_s)} frames left out: "
            "they do not show the board, or repeat an earlier frame"
        )
    return HeadRecording(
        frames=frames,
        files=found.files,
        remarks=tuple(remarks),
        read_errors=found.read_errors,
    )


def clean_and_renumber_frames(frames: HeadFrames) -> HeadFrames:
    """Tidy frames, see `sort_and_clean_frames`, and number the board's placements without gaps."""
    frames = sort_and_clean_frames(frames)
    places = np.unique(frames.placement, return_inverse=True)[1]
    return replace(frames, placement=places.astype(np.intp))
