"""The servos of a robot behind its supervisor: asked, driven, and braked.

While whoever drives them takes their time, a thread of the drive's own speaks in their place: it
keeps the last command, as far as it is safe, for two periods more, and then brakes to rest. Where
Python lets no thread run, the servos' own watchdog stops them.
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, NamedTuple

import numpy as np

from vergence.errors import HardwareError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.count_log import CountLog
from vergence.hardware.history import JointHistory
from vergence.hardware.safety.motion import HELD
from vergence.hardware.safety.supervisor import State, Supervisor
from vergence.hardware.servos import HeadServos
from vergence.models.parts import FloatArray
from vergence.recording.listener import RobotListener
from vergence.recording.schema import CommandOrigin, LoggedCommand

_LOG: Final = logging.getLogger(__name__)
_OLD: Final = 1.0
"""Age of the joints' angles by the control period from which on they are read again."""
_KEPT: Final = 3.0
"""Control periods for which a wish counts; after them the joints are braked."""
_REST_TIMEOUT_S: Final = 1.0
"""Longest time for which the joints are braked by commands, s."""
_JOIN_S: Final = 1.0


class InTrial(NamedTuple):
    """What the supervisor is told of a running trial, see `State`."""

    images_s: FloatArray
    seen: bool
    goals: FloatArray
    missed: int


class Drive(threading.Thread):
    """Sends commands to open servos, and speaks for whoever is late.

    Args:
        line: the servos.
        config: what the hardware is.
        supervisor: makes commands of wishes.
        history: takes every reading of the joints.
        log: takes these and all commands; None for no log.
        clock: a steady clock, s.
        sleep: waits for some seconds.
    """

    def __init__(
        self,
        line: HeadServos,
        config: HardwareConfig,
        supervisor: Supervisor,
        history: JointHistory,
        *,
        log: RobotListener | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(daemon=True, name="vergence servos")
        self._line = line
        self._supervisor, self._history = supervisor, history
        self._period_s = config.head.timing.period_s
        self._log, self._clock, self._sleep = log, clock, sleep
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._pid = os.getpid()
        self._late = CountLog(_LOG, logging.INFO, "wishes late, the last command kept: %d", clock)
        self._wish = np.zeros(7)
        self._wished_s = self._sent_s = self._kept_s = -np.inf

    @property
    def misses(self) -> int:
        """Answers that did not come."""
        return self._line.misses

    @contextmanager
    def alone(self) -> Iterator[HeadServos]:
        """The servos, and nobody speaks meanwhile.

        Raises:
            HardwareError: the drive is closed, or another process has opened it.
        """
        self._refuse_others()
        with self._lock:
            yield self._line

    def sense(self) -> None:
        """Read the joints into the history.

        Raises:
            HardwareError: see `HeadServos.sense` and `alone`.
        """
        with self.alone():
            sensed = self._line.sense()
            self._history.add(*sensed)
        if self._log is not None:
            self._log.joints(*sensed)

    def send(self, wish: FloatArray, trial: InTrial | None = None) -> FloatArray:
        """Send what the supervisor makes of a wish.

        Args:
            wish: (7,) rad/s.
            trial: while one runs.

        Returns:
            (7,) what was sent, rad/s.

        Raises:
            HardwareError: the line is gone; see `alone`.
        """
        while True:
            with self.alone():
                # commands are a period apart, the thread's too
                ahead_s = self._kept_s + self._period_s - self._clock()
                if ahead_s <= 0.0:
                    self._wished_s = self._clock()
                    return self._send(wish, trial)
            self._sleep(ahead_s)

    def _send(self, wish: FloatArray, trial: InTrial | None = None) -> FloatArray:
        self._refuse_others()  # again, under the lock
        line = self._line
        old_s = self._clock() - self._history.newest()[0]
        if old_s > _OLD * self._period_s and not self._supervisor.fault:
            self.sense()  # whoever wishes has taken their time
        measured_s, joints, _ = self._history.newest()
        now = self._clock()
        state = State(
            now_s=now,
            angles=line.angles.angles + (now - measured_s) * line.angles.speeds,
            speeds=line.angles.speeds,
            joints=joints,
            age_s=line.angles.ages(now),
            images_s=None if trial is None else trial.images_s,
            seen=trial is not None and trial.seen,
            goals=None if trial is None else trial.goals,
            missed=0 if trial is None else trial.missed,
        )
        sent = line.send(self._supervisor.command(state, wish))
        if self._log is not None:
            asked = CommandOrigin.ROBOT if trial is None else CommandOrigin.POLICY
            verdict = self._supervisor.verdict.value
            self._log.command(LoggedCommand(self._clock(), wish, sent, verdict, asked.value))
        self._wish = sent  # what is kept where the next wish is late
        self._sent_s = self._clock()
        self._supervisor.took(sent)
        return sent

    def _refuse_others(self) -> None:
        if self._closed.is_set() or os.getpid() != self._pid:
            raise HardwareError("the head is closed: expected a reset first")

    def move(self, wish: FloatArray) -> float:
        """Send a wish for one period outside a trial.

        Args:
            wish: (7,) rad/s.

        Returns:
            The time then, s.

        Raises:
            HardwareError: something is wrong; `brake` then.
        """
        self.send(wish)
        if self._supervisor.fault:
            raise HardwareError(self._supervisor.fault)
        self._sleep(self._period_s)
        self.sense()
        return self._clock()

    def brake(self) -> None:
        """Brake until the commands are to rest, as far as the line allows."""
        if os.getpid() != self._pid:
            return
        moved = not self._supervisor.at_rest
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
        if moved and self._supervisor.at_rest:
            _LOG.info("braked to rest in %.2f s", self._clock() - begun_s)
        elif moved:
            _LOG.warning("expected to brake to rest within %g s", _REST_TIMEOUT_S)

    def keep(self) -> float:
        """Command the joints where the next wish is late.

        Returns:
            Time after which to look again, s.
        """
        with self._lock:
            now = self._clock()
            left_s = self._sent_s + HELD * self._period_s - now
            if self._supervisor.at_rest or self._closed.is_set():
                return self._period_s
            if left_s > 0.0:
                return left_s
            late = now - self._wished_s > _KEPT * self._period_s
            try:
                self.sense()
                self._send(np.zeros(7) if late else self._wish)
            except Exception as error:  # a thread that ends would say nothing any more
                self._supervisor.stop(str(error))
                with suppress(HardwareError):
                    self._send(np.zeros(7))
            first = self._kept_s < self._wished_s
            self._sent_s = self._kept_s = self._clock()
            if first:
                self._late.add(1)
            return self._period_s

    def run(self) -> None:
        """Keep commanding where wishes are late, until the drive is closed."""
        while not self._closed.wait(self.keep()):
            pass

    def close(self) -> None:
        """Bring the servos to rest at once, and give the line back.

        A child of the process that has opened them leaves them to it.
        """
        if os.getpid() != self._pid:
            self._line.abandon()
            return
        self._closed.set()
        if self.is_alive() and threading.current_thread() is not self:
            self.join(_JOIN_S)
        with self._lock:
            self._line.close()
