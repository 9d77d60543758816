"""Recordings on disk of frames that were drawn."""

import numpy as np

from vergence.models.parts import EYE_NAMES
from vergence.recording.schema import LoggedDetection
from vergence.recording.writer import LogWriter


def log_frames(path, head, frames, *, order=None, skew_s=0.0, **facts):
    """Write frames in an order as a robot's log; the right eye's images are `skew_s` late."""
    facts = {"target": str(frames.target), "at_rest": "True"} | facts
    with LogWriter(path, head=head, facts=facts) as log:
        for frame in range(len(frames.time_s)) if order is None else order:
            for eye in range(2):
                log_view(log, frames, eye, frame, float(frames.time_s[frame]) + eye * skew_s)
    return path


def log_view(log, frames, eye, frame, time_s):
    nothing, missing = np.empty((0, 2)), np.full(2, np.nan)
    seen = frames.seen[eye, frame].any()
    log.detection(
        LoggedDetection(
            eye=EYE_NAMES[eye], exposed_s=time_s, ready_s=time_s + 0.01,
            positions=frames.joint_positions[frame], point_px=missing, sigma_px=missing,
            corners_px=frames.pixels[eye, frame] if seen else nothing,
            corners_sigma_px=frames.sigma[eye, frame] if seen else nothing,
        )
    )  # fmt: skip
