"""Recording of a robot while an eye turns: commands, joint angles, and detections."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from vergence.models.parts import FloatArray
from vergence.recording.events import RobotListener
from vergence.recording.schema import CommandOrigin, LoggedCommand, LoggedDetection


class LoopSamples(NamedTuple):
    """Commands and measurements of one eye, with times of one monotonic clock."""

    sent_s: FloatArray
    """(n,) times at which commands were sent, s."""
    sent_velocities: FloatArray
    """(n,) commands of the actuator that turned, rad/s."""
    joints_s: FloatArray
    """(m,) times of the joint measurements, s."""
    joint_angles: FloatArray
    """(m, 7) joint angles, rad."""
    joint_time_sigma_s: float
    """Standard deviation of a common error of `joints_s`, s."""
    received_s: FloatArray
    """(k,) times of receipt of the images, s."""
    pixels: FloatArray
    """(k, 2) raw pixels of the target; nan if it was not found."""
    detection_time_s: FloatArray
    """(k,) times from an image's receipt to the end of its detection, s."""


class SampleCollector(RobotListener):
    """RobotListener that keeps commands, joint angles and detections.

    Args:
        clock: the clock of all times, s.

    Attributes:
        clock: the clock of all times, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._newest = np.zeros(7)
        self._commands: list[LoggedCommand] = []
        self._joints: list[tuple[float, FloatArray]] = []
        self._answered_s: list[float] = []
        self._detections: list[LoggedDetection] = []

    def command(self, command: LoggedCommand) -> None:
        """See `RobotListener.command`."""
        self._commands.append(command)

    def joints(self, clock_s: float, positions: FloatArray, velocities: FloatArray) -> None:
        """See `RobotListener.joints`."""
        self._joints.append((clock_s, positions))
        self._answered_s.append(self.clock() - clock_s)
        self._newest = positions

    def detection(self, found: LoggedDetection) -> None:
        """See `RobotListener.detection`."""
        self._detections.append(found)

    @property
    def newest(self) -> FloatArray:
        """(7,) the newest joint angles, rad."""
        return self._newest

    def reply_times_s(self, read_s: Sequence[float]) -> FloatArray:
        """Times from a policy's readings to its commands, s.

        Args:
            read_s: times at which it received each reading of a trial, s of the clock.
        """
        sent_s = [one.clock_s for one in self._commands if one.by == CommandOrigin.POLICY.value]
        count = min(len(sent_s), len(read_s))
        return np.subtract(sent_s[:count], read_s[:count])

    def clear(self) -> None:
        """Discard everything recorded so far."""
        for kept in (self._commands, self._joints, self._answered_s, self._detections):
            kept.clear()

    def samples(self, eye: str, slot: int, latency_s: float) -> LoopSamples:
        """Samples of one eye recorded so far.

        Args:
            eye: `left` or `right`.
            slot: index in the 7-element command of the actuator that turned.
            latency_s: latency that was subtracted from the times of receipt to date exposures, s.
        """
        seen = [one for one in self._detections if one.eye == eye]
        received_s = np.array([one.exposed_s for one in seen]) + latency_s
        return LoopSamples(
            sent_s=np.array([one.clock_s for one in self._commands]),
            sent_velocities=np.array([one.sent[slot] for one in self._commands]),
            joints_s=np.array([one[0] for one in self._joints]),
            joint_angles=np.array([one[1] for one in self._joints]).reshape(-1, 7),
            # a reading is dated at the end of its request, but measured at any time until its
            # answer; the shortest exchange has the least of this machine's own delays
            joint_time_sigma_s=min(self._answered_s) / np.sqrt(3.0) if self._joints else 0.0,
            received_s=received_s,
            pixels=np.array([one.point_px for one in seen]).reshape(-1, 2),
            detection_time_s=np.array([one.ready_s for one in seen]) - received_s,
        )
