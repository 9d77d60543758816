"""Sights read from a recording, not yet sorted."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from vergence.calibration.head.frames import HeadFrames
from vergence.recording.looking import BoardView
from vergence.vision.targets import PlanarTarget

MOST_PLACES: Final = 1000
"""Bound on the numbers of the board's placements (chosen: larger ones are times or names)."""


class RawRecording(NamedTuple):
    """Content of a recording as read."""

    target: PlanarTarget
    """The board."""
    board_views: Sequence[BoardView]
    """(f) views in any order."""
    placement: Sequence[int]
    """(f) number of the board's placement for each view."""
    files: tuple[str, ...]
    """Names of the files that were read."""
    remarks: tuple[str, ...] = ()
    read_errors: tuple[str, ...] = ()
    head_identity: str = ""
    """Identity of the head that looked, if the logs distinguish heads with the same file."""

    def frames(self) -> HeadFrames:
        """Pack the views into arrays; corners without a pixel or a sigma count as not found."""
        count, corners = len(self.board_views), len(self.target.corners_m)
        pixels = np.full((2, count, corners, 2), np.nan)
        sigma = np.full((2, count, corners, 2), np.nan)
        for frame, board_view in enumerate(self.board_views):
            for eye in range(2):
                found, deviation = board_view.corners_px[eye], board_view.sigma_px[eye]
                if found is not None and deviation is not None:
                    pixels[eye, frame], sigma[eye, frame] = found, deviation
        known = (np.isfinite(pixels) & np.isfinite(sigma) & (sigma > 0.0)).all(axis=-1)
        pixels[~known] = sigma[~known] = np.nan
        return HeadFrames(
            target=self.target,
            time_s=np.array(
                [board_view.time_s for board_view in self.board_views], dtype=np.float64
            ),
            joint_positions=np.array(
                [board_view.positions for board_view in self.board_views]
            ).reshape(count, 7),
            pixels=pixels,
            sigma=sigma,
            placement=np.array(self.placement, dtype=np.intp),
        )
