"""Records of heads: the recorder of readings and ground truth, logs of robots, and their replay."""

from vergence.recording.recorder import Recorder

__all__ = ["Recorder"]
