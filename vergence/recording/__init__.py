"""Records of heads: the recorder of readings and ground truth, logs of robots, and their replay."""

from vergence.recording.events import Recorder

__all__ = ["Recorder"]
