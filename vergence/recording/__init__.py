"""Records of trials: readings of the sensors, and the truth behind them."""

from vergence.recording.recorder import Recorder

__all__ = ["Recorder"]
