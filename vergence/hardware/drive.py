"""Reading, driving and braking of a robot's servos; every command passes the supervisor.

If the caller's next command is late, a thread of the drive sends commands in its place: the last
one, as far as it is safe, for about two more periods, and then commands that brake to rest. If
Python runs no thread at all, the servos' own watchdog stops them.
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.count_log import CountLog
from vergence.hardware.history import JointHistory
from vergence.hardware.safety.motion import HOLD_PERIODS
from vergence.hardware.safety.supervisor import RobotState, Supervisor
from vergence.hardware.servos import HeadServos
from vergence.models.parts import FloatArray
from vergence.recording.events import RobotListener
from vergence.recording.schema import CommandOrigin, LoggedCommand

_LOG: Final = logging.getLogger(__name__)
_MAX_AGE_PERIODS: Final = 1.0
"""Joint angles older than this are read again before a command, control periods (chosen)."""
_REPEAT_PERIODS: Final = 3.0
"""Control periods for which a requested command is repeated; then the joints brake (chosen)."""
_REST_TIMEOUT_S: Final = 1.0
"""Longest time for braking by commands, s (chosen)."""
_LONG_PAUSE_PERIODS: Final = 4.0
"""Control periods without a packet that are told of as a pause (chosen)."""
_JOIN_S: Final = 1.0
"""Longest wait for the thread to end, s (chosen)."""


class RunningTrial(NamedTuple):
    """State of the running trial as the supervisor needs it; see `RobotState`."""

    images_received_s: FloatArray
    target_visible: bool
    target_eye_angles: FloatArray
    missed_periods: int


class DriveThread(threading.Thread):
    """Sends commands to open servos, and keeps sending if the caller is late.

    Args:
        servos: the servos.
        config: the hardware configuration.
        supervisor: turns requested velocities into safe commands.
        history: receives every reading of the joints.
        log: receives the readings and all commands; None for no log.
        clock: a monotonic clock, s.
        sleep: waits for some seconds.

    Attributes:
        last_sent: (7,) velocities that were sent last, rad/s.
    """

    def __init__(
        self,
        servos: HeadServos,
        config: HardwareConfig,
        supervisor: Supervisor,
        history: JointHistory,
        *,
        log: RobotListener | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(daemon=True, name="vergence servos")
        self._servos = servos
        self._supervisor, self._history = supervisor, history
        self._period_s = config.head.timing.period_s
        self._watchdog_s = config.bus.watchdog_s
        self._names = {servo.slot: servo.name for servo in config.servos}
        self._rests, self._in_trial = True, False
        self._log, self._clock, self._sleep = log, clock, sleep
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._pid = os.getpid()
        self._late = CountLog(_LOG, logging.INFO, "wishes late, the last command kept: %d", clock)
        self.last_sent = np.zeros(7)
        self._requested_s = self._sent_s = self._repeated_s = -np.inf

    @property
    def missed_answers(self) -> int:
        """Number of answers that did not arrive."""
        return self._servos.missed_answers

    @contextmanager
    def exclusive(self) -> Iterator[HeadServos]:
        """Give exclusive access to the servos: nobody else sends meanwhile.

        Raises:
            HardwareError: the drive is closed, or another process has opened it.
        """
        self._refuse_others()
        with self._lock:
            yield self._servos

    def sense(self) -> None:
        """Read the joints and add them to the history.

        Raises:
            HardwareError: see `HeadServos.sense` and `exclusive`.
        """
        with self.exclusive():
            sensed = self._servos.sense()
            self._history.add(*sensed)
        if self._log is not None:
            self._log.joints(*sensed)

    def send(self, requested: FloatArray, trial: RunningTrial | None = None) -> FloatArray:
        """Send the supervisor's command for some requested velocities.

        Args:
            requested: (7,) requested velocities, rad/s.
            trial: state of the running trial; None outside a trial.

        Returns:
            (7,) velocities that were sent, rad/s.

        Raises:
            HardwareError: the line is gone; see `exclusive`.
        """
        while True:
            with self.exclusive():
                # at least a period after a command of the thread
                ahead_s = self._repeated_s + self._period_s - self._clock()
                if ahead_s <= 0.0:
                    self._requested_s, self._in_trial = self._clock(), trial is not None
                    return self._send(requested, trial)
            self._sleep(ahead_s)

    def _send(self, requested: FloatArray, trial: RunningTrial | None = None) -> FloatArray:
        self._refuse_others()  # again, under the lock
        servos = self._servos
        self._refuse_pause()
        old_s = self._clock() - self._history.newest()[0]
        if old_s > _MAX_AGE_PERIODS * self._period_s and not self._supervisor.fault:
            self.sense()  # the caller was slow
        measured_s, joints, _ = self._history.newest()
        now = self._clock()
        state = RobotState(
            now_s=now,
            actuator_angles=servos.angles.angles + (now - measured_s) * servos.angles.speeds,
            actuator_speeds=servos.angles.speeds,
            joint_angles=joints,
            reading_age_s=servos.angles.reading_ages_s(now),
            images_received_s=None if trial is None else trial.images_received_s,
            target_visible=trial is not None and trial.target_visible,
            target_eye_angles=None if trial is None else trial.target_eye_angles,
            missed_periods=0 if trial is None else trial.missed_periods,
        )
        command = self._supervisor.command(state, requested)
        if self._supervisor.distrusted.any():
            servos.release_torque(self._supervisor.distrusted)
        sent = servos.send(command)
        if self._log is not None:
            asked = CommandOrigin.ROBOT if trial is None else CommandOrigin.POLICY
            verdict = self._supervisor.verdict.value
            self._log.command(LoggedCommand(self._clock(), requested, sent, verdict, asked.value))
        self.last_sent = sent  # repeated if the next command is late
        self._sent_s = self._clock()
        self._supervisor.on_sent(sent)
        self._rests = self._rests and not sent.any()
        return sent

    def note_pause(self) -> None:
        """Tell the supervisor of a long silence in a trial, from which other faults may follow."""
        pause_s = self._servos.pause_s
        if self._in_trial and pause_s > _LONG_PAUSE_PERIODS * self._period_s:
            self._supervisor.note_pause(self._clock(), pause_s)

    def _refuse_pause(self) -> None:
        """Raise an error if the servos' watchdog has stopped them."""
        self.note_pause()
        if not self._supervisor.fault and (tripped_s := self._servos.watchdog_trip_pause_s()):
            raise HardwareError(
                f"bus: expected the servos to hear something every {self._watchdog_s:g} s, got "
                f"{tripped_s:.2f} s of silence, in which their watchdog has stopped them: this "
                "process, its policy or the line had paused; cure: end other programs, and start "
                "again"
            )

    def _refuse_others(self) -> None:
        if self._closed.is_set() or os.getpid() != self._pid:
            raise HardwareError("the head is closed: expected a reset first")

    def move(self, requested: FloatArray) -> float:
        """Send requested velocities for one period outside a trial.

        Args:
            requested: (7,) requested velocities, rad/s.

        Returns:
            Time at the end of the period, s.

        Raises:
            HardwareError: something is wrong; the caller has to call `brake`.
        """
        self.send(requested)
        if self._supervisor.fault:
            raise HardwareError(self._supervisor.fault)
        self._sleep(self._period_s)
        self.sense()
        return self._clock()

    def brake(self) -> None:
        """Brake until the commands are zero, and read that the joints rest, as far as possible.

        A joint that does not come to rest loses its torque, and the head is stopped.
        """
        if os.getpid() != self._pid or self._rests:
            return
        begun_s = due_s = self._clock()
        until_s = due_s + _REST_TIMEOUT_S
        while due_s < until_s and not self._supervisor.at_rest:
            with suppress(HardwareError):
                self.sense()
            try:
                self.send(np.zeros(7))
            except HardwareError:
                break
            due_s = max(due_s + self._period_s, self._clock())
            self._sleep(max(due_s - self._clock(), 0.0))
        with suppress(HardwareError), self.exclusive() as servos:
            moving = servos.settle(self._sleep)
            if moving.any():
                self._supervisor.stop(
                    f"servos: {self._named(moving)}: expected rest at a velocity of zero, got a "
                    "joint that turns on; cure: hold it, and look at its motor and encoder"
                )
            self._rests = self._supervisor.at_rest
        if self._rests:
            _LOG.info("braked to rest in %.2f s", self._clock() - begun_s)
        else:
            _LOG.warning("expected to brake to rest within %g s", _REST_TIMEOUT_S)

    @property
    def released(self) -> str:
        """Names of the joints whose torque was switched off; empty for none."""
        return self._named(self._servos.released)

    def _named(self, joints: BoolArray) -> str:
        return ", ".join(name for slot, name in self._names.items() if joints[slot])

    def send_if_late(self) -> float:
        """Send a command if the caller's next one is late.

        Returns:
            Time until the next call of this method, s.
        """
        with self._lock:
            now = self._clock()
            left_s = self._sent_s + HOLD_PERIODS * self._period_s - now
            if self._supervisor.at_rest or self._closed.is_set():
                return self._period_s
            if left_s > 0.0:
                return left_s
            late = now - self._requested_s > _REPEAT_PERIODS * self._period_s
            try:
                self.sense()
                self._send(np.zeros(7) if late else self.last_sent)
            except Exception as error:  # a thread that ended could not brake
                self._supervisor.stop(str(error))
                with suppress(HardwareError):
                    self._send(np.zeros(7))
            first = self._repeated_s < self._requested_s
            self._sent_s = self._repeated_s = self._clock()
            if first:
                self._late.add(1)
            return self._period_s

    def run(self) -> None:
        """Call `send_if_late` until the drive is closed."""
        while not self._closed.wait(self.send_if_late()):
            pass

    def close(self) -> None:
        """Bring the servos to rest at once, and release the line.

        In a forked child process the servos are left alone, as they belong to its parent.
        """
        if os.getpid() != self._pid:
            self._servos.abandon()
            return
        self._closed.set()
        if self.is_alive() and threading.current_thread() is not self:
            self.join(_JOIN_S)
        with self._lock:
            self._servos.close(self._sleep)
