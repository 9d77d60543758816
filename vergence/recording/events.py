"""Events of a robot that a follower of its log returns."""

from typing import NamedTuple

from vergence.envs.reading import Reading, Truth
from vergence.recording.schema import LoggedCommand, LoggedDetection, LoggedJoints


class FollowedReading(NamedTuple):
    """A reading of the head."""

    trial: int
    """Number of the trial; 0 if its start was not found."""
    begun_s: float
    """Time of the trial's start, s of the robot's clock."""
    reading: Reading
    """The reading; its arrays lack the axis over heads."""


class FollowedImage(NamedTuple):
    """An image of an eye."""

    exposed_s: float
    """Time of the exposure, s of the robot's clock."""
    jpeg: bytes
    """The JPEG; see `vergence.recording.jpeg.read_jpeg`."""


class FollowedNote(NamedTuple):
    """A warning or an error of the package's loggers."""

    level: int
    """3 for a warning, 4 for an error, 5 for a fatal one, as in foxglove.Log."""
    message: str


class NewEvents(NamedTuple):
    """Events appended to a log between two calls, in order; at most 10 000 of a kind."""

    readings: tuple[FollowedReading, ...]
    truths: tuple[Truth, ...]
    """Ground truth, if it is logged: each follows the reading of its time, maybe one call later."""
    commands: tuple[LoggedCommand, ...]
    """All commands, also those of the robot's own code."""
    detections: tuple[LoggedDetection, ...]
    joints: LoggedJoints | None
    """The newest measurement of the joints, also between trials; None if there is no new one."""
    images: tuple[FollowedImage | None, FollowedImage | None]
    """The newest image of the left and the right eye; None if there is no new one."""
    stop_reasons: tuple[str, ...]
    """Reasons for stops of the head."""
    notes: tuple[FollowedNote, ...]
