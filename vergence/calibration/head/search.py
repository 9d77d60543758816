"""Search for a board that the head does not see at rest."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Final

import numpy as np

from vergence.calibration.head.frames import HeadFrames
from vergence.calibration.head.gathered import RawRecording
from vergence.calibration.head.plan import estimate_board_by_last_views
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.looking import BoardView, Looker

_AZIMUTHS: Final = np.deg2rad((-50.0, -25.0, 0.0, 25.0, 50.0))
"""Azimuths to look at, rad (chosen: common cameras have 50 to 60 degrees field of view)."""
_ELEVATIONS: Final = np.deg2rad((-25.0, 0.0, 25.0))
"""Elevations to look at, rad (chosen, see `_AZIMUTHS`)."""
_NECK_SHARES: Final = (0.0, -0.6, 0.6)
"""Fractions of the way from rest to a limit for the neck's first and last joint (chosen)."""
_SAME_POSTURE_RAD: Final = 0.02
"""Largest joint difference of two postures that count as equal, rad (chosen)."""
_AHEAD_M: Final = 1.0
"""Forward distance of the fixated points, m (chosen)."""


def single_frame(looker: Looker, board_view: BoardView) -> HeadFrames:
    """Convert a view to a recording of one frame."""
    return RawRecording(looker.target, [board_view], [0], ()).frames()


def count_eyes_seeing_board(looker: Looker, board_view: BoardView) -> int:
    """Count the eyes that see at least four corners of the board."""
    return int((single_frame(looker, board_view).seen.sum(axis=-1) >= 4).sum())


def find_board(looker: Looker, first_guesses: Sequence[FloatArray] = ()) -> HeadFrames:
    """Look around, at guesses (7,) first, until an eye sees the board; one frame of both eyes."""
    looks = 0
    for q in (*first_guesses, *_directions(looker.head)):
        looks += 1
        board_view = looker.look(q)
        eyes = count_eyes_seeing_board(looker, board_view)
        if eyes == 2:
            return single_frame(looker, board_view)
        if eyes == 1:
            frame = single_frame(looker, board_view)
            again = looker.look(_towards(looker.head, frame))
            return single_frame(looker, again) if count_eyes_seeing_board(looker, again) else frame
    raise ConfigurationError(
        f"expected {looker.target} where the eyes can look, found it in no direction of {looks}: "
        "is it that target, whole, flat, upright, well lit, and neither too near nor too far?"
    )


def _towards(head: HeadModel, frame: HeadFrames) -> FloatArray:
    """(7,) joint angles that turn both eyes to a board that one of them has seen."""
    T_0_N = head.base_pose(frame.joint_positions[0])
    middle = estimate_board_by_last_views(head, frame).corners_by_eye.mean(axis=(0, 1))
    inside = T_0_N[:3, :3].T @ (middle - T_0_N[:3, 3])
    return _within(head, head.fixate(inside, frame.joint_positions[0, :3], warn=False))


def _within(head: HeadModel, q: FloatArray) -> FloatArray:
    own = head.actuation
    return own.joints_of(np.clip(np.nan_to_num(own.actuators_of(q)), own.lower, own.upper))


def _directions(head: HeadModel) -> Iterator[FloatArray]:
    """Generate (7,) joint angles for all directions, nearest to rest first."""
    own, rest = head.actuation, head.rest()
    found = [rest]
    for yaw, pitch in product(_NECK_SHARES, _NECK_SHARES):
        neck = rest[:3].copy()
        for joint, share in ((0, yaw), (2, pitch)):
            neck[joint] += abs(share) * (
                (own.upper if share > 0.0 else own.lower)[joint] - neck[joint]
            )
        for azimuth, elevation in product(_AZIMUTHS, _ELEVATIONS):
            point = _AHEAD_M * np.array([np.tan(azimuth), np.tan(elevation), 1.0])
            found.append(_within(head, head.fixate(point, neck, warn=False)))
    found.sort(key=lambda q: float(np.abs(q - rest).sum()))
    taken: list[FloatArray] = []
    for q in found:
        if all(np.abs(q - one).max() > _SAME_POSTURE_RAD for one in taken):
            taken.append(q)
            yield q
