"""Reading, driving and braking of a robot's servos; every command passes the supervisor.

If the caller's next command is late, a thread of the drive sends commands in its place: the last
one, as far as it is safe, for about two more periods, and then commands that brake to rest. If
Python runs no thread at all, the servos' own watchdog stops them, where they have one.

A goal of zero is no rest: a servo whose encoder is blind, or whose motor is inverted, turns on
until it has no torque. So rest is read, and a joint that does not come to rest loses its torque.
"""

import logging
import os
import threading
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np

from vergence.envs.reading import BoolArray
from vergence.errors import Finding, HardwareError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.safety.following import runaway
from vergence.hardware.safety.limits import HOLD_PERIODS
from vergence.hardware.safety.supervisor import RobotState, Supervisor
from vergence.hardware.servos import SILENT_S, JointAngles, ServoReading, Servos
from vergence.models.parts import FloatArray
from vergence.recording.events import RobotListener
from vergence.recording.schema import CommandOrigin, LoggedCommand

_LOG: Final = logging.getLogger(__name__)
_MAX_AGE_PERIODS: Final = 1.0
"""Joint angles older than this are read again before a command, control periods (chosen)."""
REPEAT_PERIODS: Final = 3.0
"""Control periods for which a requested command is repeated; then the joints brake (chosen)."""
_REST_TIMEOUT_S: Final = 1.0
"""Longest time for braking by commands, s (chosen)."""
_LONG_PAUSE_PERIODS: Final = 4.0
"""Control periods without a packet that are told of as a pause (chosen)."""
_PAUSE_FRACTION: Final = 0.5
"""Pause without packets after which the servos are asked whether they have stopped, as a fraction
of the time after which they do (chosen: any packet counts for them)."""
_LEAD_S: Final = 2e-3
"""Time before a tick at which images are taken, s (chosen: merging a pair takes half of it)."""
_JOIN_S: Final = 1.0
"""Longest wait for the thread to end, s (chosen)."""
_HEALTH_INTERVAL_S: Final = 1.0
"""Time between two checks of running servos, s (chosen)."""
_STOPPING_MISSES: Final = 3
"""Consecutive readings without an answer that stop the head, once `SILENT_S` has passed
(chosen)."""
_SETTLE_S: Final = 0.3
"""Time at a goal of zero in which a joint has to come to rest, s (chosen: half a second with the
braking before it)."""
_REST_WINDOW_S: Final = 0.06
"""Time over which a joint at rest keeps its angle, s (chosen)."""
_REST_RAD: Final = 0.004
"""Range of the angle of a joint at rest, rad: two steps of an encoder of 4,096 (chosen)."""
_READ_INTERVAL_S: Final = 0.008
"""Time between two readings, s (chosen)."""
_MOST_READS: Final = 100
"""Most readings, in a process whose clock or line is slow (numerical)."""
_KEPT_READINGS: Final = 512
"""Readings that are kept: 4 s at 120 Hz, more than the age of any image (numerical)."""
_MAX_EXTRAPOLATION_S: Final = 0.05
"""Longest extrapolation beyond the newest reading at constant velocity, s (chosen)."""
_MIN_INTERVAL_S: Final = 1.0
"""Least time between two lines of a `CountLog`, s (chosen)."""


class CountLog:
    """Log lines for events of any control period: at most one line a second, with their count."""

    def __init__(self, level: int, text: str, clock: Callable[[], float]) -> None:
        self._level, self._text, self._clock = level, text, clock
        self._count, self._told_s = 0, -np.inf

    def add(self, count: int, *values: object) -> None:
        """Count events, and log them if the last line is a second old."""
        self._count += count
        now = self._clock()
        if now - self._told_s >= _MIN_INTERVAL_S:
            _LOG.log(self._level, self._text, self._count, *values)
            self._count, self._told_s = 0, now


class Joints(NamedTuple):
    """The joints at one time."""

    time_s: float
    """Time of the measurement, s of a monotonic clock."""
    positions: FloatArray
    """(7,) joint angles, rad."""
    velocities: FloatArray
    """(7,) joint velocities, rad/s."""


class JointHistory:
    """Readings of the joints by time; one thread writes, others may read."""

    def __init__(self) -> None:
        self._rows: deque[Joints] = deque(maxlen=_KEPT_READINGS)
        self._lock = threading.RLock()  # re-entrant: a signal handler may close all in between

    def add(self, time_s: float, positions: FloatArray, velocities: FloatArray) -> Joints:
        """Keep a reading that is newer than all others."""
        with self._lock:
            self._rows.append(Joints(time_s, positions.copy(), velocities.copy()))
            return self._rows[-1]

    def newest(self) -> Joints:
        """The newest reading; raises a `LookupError` if there is none."""
        with self._lock:
            if not self._rows:
                raise LookupError("no reading of the joints yet")
            return self._rows[-1]

    def at(self, time_s: float) -> FloatArray:
        """(7,) joint angles at a time, rad; raises a `LookupError` before the first reading.

        They are interpolated linearly between two readings, constant before the first one, and
        extrapolated with the velocities of the newest one for up to 50 ms.
        """
        self.newest()
        with self._lock:
            rows = list(self._rows)
        i = bisect_left(rows, time_s, key=itemgetter(0))
        if i == 0:
            return rows[0].positions.copy()
        before = rows[i - 1]
        if i == len(rows):
            ahead_s = min(time_s - before.time_s, _MAX_EXTRAPOLATION_S)
            return np.asarray(before.positions + ahead_s * before.velocities)
        after = rows[i]
        share = (time_s - before.time_s) / (after.time_s - before.time_s)
        return np.asarray(before.positions + share * (after.positions - before.positions))


class RunningTrial(NamedTuple):
    """State of the running trial as the supervisor needs it; see `RobotState`."""

    images_received_s: FloatArray
    target_visible: bool
    target_eye_angles: FloatArray
    missed_periods: int


def settle(
    servos: Servos,
    scales: FloatArray,
    watched: BoolArray,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> tuple[BoolArray, BoolArray]:
    """Read that joints come to rest at a goal of zero; those that do not lose their torque.

    A joint whose speed grows loses it at once, others after `_SETTLE_S`. All arrays are (n,):
    `scales` are turns of joints per turn of servos, `watched` the servos that have torque; the
    results are True for those that did not come to rest, and those of them without torque now.
    """
    begun_s = clock()
    rows: deque[tuple[float, FloatArray]] = deque(maxlen=64)
    bad, done = np.zeros_like(watched), np.zeros_like(watched)
    for _ in range(_MOST_READS):
        reading, now_s = servos.read(), clock()
        seen = watched & ~bad & np.isfinite(reading.ages_s)
        rows.append((now_s, np.where(seen, reading.angles * scales, np.nan)))
        times, turned = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
        recent = turned[times >= now_s - _REST_WINDOW_S]
        moves = ~bad & (np.ptp(recent, axis=0) > _REST_RAD)  # not those that are nan
        new = ~bad & (runaway(now_s, times, turned, np.zeros_like(turned)) > 0.0)
        if now_s - begun_s > _SETTLE_S:
            new |= moves
        if new.any():
            bad |= new
            done |= release(servos, new)
        elif not moves.any() and now_s - begun_s >= _REST_WINDOW_S:
            break
        sleep(_READ_INTERVAL_S)
    return bad, done


def release(servos: Servos, which: BoolArray) -> BoolArray:
    """Take the torque of servos, (n,) True, as far as possible; return which have lost it."""
    done = np.zeros_like(which)
    for place in np.flatnonzero(which):
        one = np.arange(len(which)) == place
        with suppress(HardwareError):
            servos.release(one)
            done |= one
            _LOG.warning("%s: torque off", servos.servos[place].name)
    return done


class DriveThread(threading.Thread):
    """Sends commands to open servos, and keeps sending if the caller is late.

    `last_sent` are the (7,) velocities that were sent last, `sent` those of the last `period`.
    """

    def __init__(
        self,
        servos: Servos,
        config: HardwareConfig,
        supervisor: Supervisor,
        history: JointHistory,
        *,
        log: RobotListener | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(daemon=True, name="vergence servos")
        self._servos, self._config = servos, config
        self._supervisor, self._history = supervisor, history
        self._period_s = config.head.timing.period_s
        self._scales = np.array([servo.sign / servo.gear_ratio for servo in config.servos])
        self.angles = JointAngles(config.servos, config.head, reports_speed=servos.reports_speed)
        self._rests, self._in_trial, self._on = True, False, False
        self._log, self._clock, self._sleep = log, clock, sleep
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._pid = os.getpid()
        self._late = CountLog(logging.INFO, "wishes late, the last command kept: %d", clock)
        self._missed = CountLog(logging.WARNING, "periods missed: %d", clock)
        said = "answers missed: %d, the last one of %s"
        self._unanswered = CountLog(logging.WARNING, said, clock)
        self._misses = np.zeros(len(config.servos), dtype=np.int64)
        self._silent_since_s = np.zeros(len(config.servos))
        self._released = np.zeros(len(config.servos), dtype=np.bool_)
        self._warned: set[str] = set()
        self._heard_s = self._health_s = clock()
        self._pause_s = 0.0
        self.last_sent = self.sent = np.zeros(7)
        self._requested_s = self._sent_s = self._repeated_s = -np.inf
        self.begun_s, self.tick, self.overruns, self._reported_overruns = clock(), 0, 0, 0

    # ---- the control period ----

    def period(
        self,
        requested: FloatArray,
        trial: RunningTrial | None = None,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> tuple[Joints, list[Finding]]:
        """Send requested velocities as far as safe, wait for the end of the period, and read.

        Args:
            requested: (7,) requested velocities, rad/s.
            trial: state of the running trial, whose schedule is kept; None outside a trial.
            meanwhile: called shortly before the trial's next tick, for what would delay a command.

        Returns:
            The joints, and new warnings of running servos.

        Raises:
            HardwareError: something is wrong; the caller has to call `brake`.
        """
        before = self._supervisor.fault
        self.sent = self.send(requested, trial)
        # a joint that does not follow is known only after the command
        new = not before and self._supervisor.distrusted.any()
        if self._supervisor.fault and (trial is None or new):
            raise HardwareError(self._supervisor.fault)
        if trial is None:
            self._sleep(self._period_s)
        else:
            self._wait_for_tick(meanwhile)
        with self._exclusive():
            return self.sense(), self._check_health()

    def start_ticks(self) -> float:
        """Start the schedule of a trial; return the time of its beginning, s."""
        self.begun_s, self.tick, self._reported_overruns = self._clock(), 0, self.overruns
        return self.begun_s

    def take_missed(self) -> int:
        """Number of periods missed since the last call."""
        missed = self.overruns - self._reported_overruns
        self._reported_overruns = self.overruns
        return missed

    def _wait_for_tick(self, meanwhile: Callable[[], None]) -> None:
        """Wait for the schedule's next tick; ticks that are a period late are skipped."""
        self.tick += 1
        due_s = self.begun_s + self.tick * self._period_s
        for until_s, then in ((due_s - _LEAD_S, meanwhile), (due_s, lambda: None)):
            left_s = until_s - self._clock()
            if left_s > 0.0:
                self._sleep(left_s)
            then()
        missed = int((self._clock() - due_s) // self._period_s)
        if missed > 0:
            self.tick += missed
            self.overruns += missed
            self._missed.add(missed)

    @contextmanager
    def _exclusive(self) -> Iterator[None]:
        """Nobody else speaks to the servos meanwhile, nor to those of a closed drive."""
        self._refuse_others()
        with self._lock:
            self._refuse_others()
            yield

    def _refuse_others(self) -> None:
        if self._closed.is_set() or os.getpid() != self._pid:
            raise HardwareError("the head is closed: expected a reset first")

    def sense(self) -> Joints:
        """Read the joints; one that does not answer is extrapolated at its last speed."""
        with self._exclusive():
            reading = self._servos.read()
            self._heard()
            accepted = self.angles.update(reading)
            if not accepted.all():
                self._count_misses(reading, accepted)
            self._misses[accepted] = 0
            if self._servos.fault:
                self._release(self._servos.must_let_go)
                raise HardwareError(self._servos.fault)
            joints = self._history.add(reading.time_s, *self.angles.joint_angles_and_speeds())
        if self._log is not None:
            self._log.joints(*joints)
        return joints

    def _release(self, which: BoolArray) -> None:
        """Take the torque of servos, unless they are only read."""
        if self._on:
            self._released |= release(self._servos, which & ~self._released)

    def _count_misses(self, reading: ServoReading, accepted: BoolArray) -> None:
        """Raise an error for a servo that is silent."""
        now = self._clock()
        for place in np.flatnonzero(~accepted):
            servo = self._config.servos[place]
            if not self._misses[place]:
                self._silent_since_s[place] = reading.time_s
            self._misses[place] += 1
            self._unanswered.add(1, servo.name)
            # a pause without requests does not count as silence
            silent_s = now - self._silent_since_s[place]
            told = self._servos.fault or self._supervisor.fault
            if silent_s > SILENT_S and self._misses[place] >= _STOPPING_MISSES and not told:
                answered = np.isfinite(reading.ages_s[place])
                on = f" on {self._servos.port}" if self._servos.port else ""
                raise HardwareError(
                    f"servos: {servo.name}: expected an answer of the id {servo.id}{on}, got "
                    f"{'angles that no joint can have' if answered else 'none'} for "
                    f"{SILENT_S:g} s; cure: check its cable and its power"
                )

    def _check_health(self) -> list[Finding]:
        """New warnings of running servos, once a second; an error is raised."""
        now = self._clock()
        if now - self._health_s < _HEALTH_INTERVAL_S:
            return []
        self._health_s = now
        findings = self._servos.check()
        self._heard()
        for finding in findings:
            if not finding.warning:
                raise HardwareError(str(finding))
        before, self._warned = self._warned, {finding.part for finding in findings}
        return [finding for finding in findings if finding.part not in before]

    def send(self, requested: FloatArray, trial: RunningTrial | None = None) -> FloatArray:
        """Send the supervisor's command for some requested velocities; both (7,) rad/s."""
        while True:
            with self._exclusive():
                # at least a period after a command of the thread
                ahead_s = self._repeated_s + self._period_s - self._clock()
                if ahead_s <= 0.0:
                    self._requested_s, self._in_trial = self._clock(), trial is not None
                    return self._send(requested, trial)
            self._sleep(ahead_s)

    def _send(self, requested: FloatArray, trial: RunningTrial | None = None) -> FloatArray:
        self._refuse_pause()
        old_s = self._clock() - self._history.newest().time_s
        if old_s > _MAX_AGE_PERIODS * self._period_s and not self._supervisor.fault:
            self.sense()  # the caller was slow
        measured = self._history.newest()
        now = self._clock()
        speeds = self.angles.speeds
        state = RobotState(
            now_s=now,
            actuator_angles=self.angles.angles + (now - measured.time_s) * speeds,
            actuator_speeds=speeds,
            joint_angles=measured.positions,
            reading_age_s=self.angles.ages_s(now),
            images_received_s=None if trial is None else trial.images_received_s,
            target_visible=trial is not None and trial.target_visible,
            target_eye_angles=None if trial is None else trial.target_eye_angles,
            missed_periods=0 if trial is None else trial.missed_periods,
        )
        command = self._supervisor.command(state, requested)
        sent = np.zeros(7)
        if self._on:
            sent = self.angles.velocities(self._servos.send(self.angles.shaft_speeds(command)))
            self._heard()
        if self._log is not None:
            asked = CommandOrigin.ROBOT if trial is None else CommandOrigin.POLICY
            verdict = self._supervisor.verdict.value
            self._log.command(LoggedCommand(self._clock(), requested, sent, verdict, asked.value))
        self.last_sent = sent  # repeated if the next command is late
        self._sent_s = self._clock()
        self._supervisor.on_sent(sent)
        self._release(self._supervisor.distrusted[self.angles.slots])
        self._rests = self._rests and not sent.any()
        return sent

    # ---- torque, and pauses ----

    def switch_on(self) -> list[Finding]:
        """Switch torque on at rest; return warnings of what had to be changed for it."""
        with self._exclusive():
            self._on = True  # from the first servo on, whatever ends it
            findings = self._servos.switch_on(~self._released)
            self._heard_s, self._pause_s = self._clock(), 0.0
            self._health_s = self._clock()
            for _ in range(_STOPPING_MISSES):  # setting servos up took its time
                if (self.angles.ages_s(self._clock()) > SILENT_S).any():
                    self.sense()
        return findings

    def wake(self) -> None:
        """Switch on again what has stopped by itself in a pause."""
        with self._exclusive():
            if self._on and self._stopped_alone_s():
                self.switch_on()

    def _heard(self) -> None:
        """Note that the servos heard something, and update the longest time without."""
        now = self._clock()
        self._pause_s = max(self._pause_s, now - self._heard_s)
        self._heard_s = now

    def _stopped_alone_s(self) -> float:
        """Longest pause since the last call if the servos have stopped in it, else 0, s."""
        pause_s, self._pause_s = max(self._pause_s, self._clock() - self._heard_s), 0.0
        if pause_s < _PAUSE_FRACTION * (self._servos.stops_alone_after_s or np.inf):
            return 0.0
        stopped = self._servos.stopped_alone(pause_s)
        self._heard_s = self._clock()
        return pause_s if stopped else 0.0

    def note_pause(self) -> None:
        """Tell the supervisor of a long silence in a trial, from which other faults may follow."""
        pause_s = max(self._pause_s, self._clock() - self._heard_s)
        if self._in_trial and pause_s > _LONG_PAUSE_PERIODS * self._period_s:
            self._supervisor.note_pause(self._clock(), pause_s)

    def _refuse_pause(self) -> None:
        """Raise an error if the servos have stopped by themselves."""
        self.note_pause()
        if self._on and not self._supervisor.fault and (paused_s := self._stopped_alone_s()):
            raise HardwareError(
                "bus: expected the servos to hear something every "
                f"{self._servos.stops_alone_after_s:.2g} s, got {paused_s:.2f} s of silence, in "
                "which their watchdog has stopped them: this process, its policy or the line had "
                "paused; cure: end other programs, and start again"
            )

    # ---- braking ----

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
        with suppress(HardwareError), self._exclusive():
            moving = self._settle()
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

    def _settle(self) -> BoolArray:
        watched = ~self._released
        moving, done = settle(self._servos, self._scales, watched, self._clock, self._sleep)
        self._heard()
        self._released |= done
        return moving

    def let_go(self) -> str:
        """Release servos that must not hold; return the names of all joints without torque."""
        with suppress(HardwareError), self._exclusive():
            self._release(self._servos.must_let_go)
        return self._named(self._released)

    def _named(self, which: BoolArray) -> str:
        return ", ".join(np.array([servo.name for servo in self._config.servos])[which])

    def send_if_late(self) -> float:
        """Send a command if the caller's next one is late; return the time to the next call, s."""
        with self._lock:
            now = self._clock()
            left_s = self._sent_s + HOLD_PERIODS * self._period_s - now
            if self._supervisor.at_rest or self._closed.is_set():
                return self._period_s
            if left_s > 0.0:
                return left_s
            late = now - self._requested_s > REPEAT_PERIODS * self._period_s
            try:
                self.sense()
                self._send(np.zeros(7) if late else self.last_sent)
            except Exception as error:  # a thread that ended could not brake
                if self._closed.is_set():  # meanwhile, which is no fault
                    return self._period_s
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
            self._servos.close()
            return
        self._closed.set()
        if self.is_alive() and threading.current_thread() is not self:
            self.join(_JOIN_S)
        with self._lock:
            if self._on:
                with suppress(HardwareError):
                    self._servos.stop()
                    self._settle()
                with suppress(HardwareError):
                    self._servos.leave()
            self._servos.close()
