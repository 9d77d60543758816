r"""The plant of a real head: servos in velocity mode, cameras, and a schedule.

Each control period the command goes out, the plant waits for the schedule's next tick, and reads
the joints; images come meanwhile, by threads of their own. What a period sends is limited to the
speeds of head and servos, and to the speed v from which a joint still stops before its limit,

    v (lag + period) + v^2 / (2 a) = room,

a half of its greatest acceleration; while it slows down, what it coasts by at the speed u that it
still has counts too, v period + u lag + u^2 / (2 a) <= room. Servos take velocities in steps of
0.229 rev/min; what a period rounds off is carried over to the next.

The bus watchdog of the servos stops them by themselves when no packet comes for a time.
"""

import atexit
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from vergence.envs.plant import Plant
from vergence.envs.plants.eye_views import EyeViews
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.streams import IntArray
from vergence.envs.targets.board import POINT, Board
from vergence.errors import ConfigurationError, HardwareError
from vergence.hardware.cameras import EyeThread
from vergence.hardware.common_time import at_common_time
from vergence.hardware.config import (
    HardwareConfig,
    ServoConfig,
    load_hardware,
    refuse_other_head,
)
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.emulator.client import EmulatedWorld
from vergence.hardware.history import JointHistory
from vergence.hardware.pairing import Pairing, Sights
from vergence.models.boards import AprilTag, Target
from vergence.models.head import HeadModel
from vergence.models.joints import EYES, NECK
from vergence.models.parts import FloatArray
from vergence.vision.detectors import make_detector
from vergence.vision.optics import EyeCamera
from vergence.vision.tracking import Tracker

_STATE: Final = (
    table.PRESENT_VELOCITY.address,
    table.PRESENT_VELOCITY.length + table.PRESENT_POSITION.length,
)
"""Where servos have their velocity, and their position behind it."""
_SILENT_S: Final = 0.1
"""Time after which a servo that does not answer counts as gone, s."""
_MOST_RAD_S2: Final = 1e3
_BRAKING: Final = 0.5
"""Share of a joint's greatest acceleration that braking before a limit counts on."""
_STILL_TICKS: Final = 0.05
"""Commands below so many ticks are none: what was carried over is dropped, and the joint rests."""
# the way to where a trial begins
_START_GAIN: Final = 6.0
_START_RAD_S: Final = 1.5
_START_WITHIN_RAD: Final = 0.01
_START_REST_RAD_S: Final = 0.03
_START_RESTED: Final = 6
_START_TIMEOUT_S: Final = 10.0
_READY_TIMEOUT_S: Final = 10.0
_FIRST_IMAGES_S: Final = 1.0


class HardwarePlant(Plant):
    """One real head on a serial line with two cameras, or an emulated one on the wire.

    Nothing moves before the first `reset`; `prepare` opens the line and the cameras.

    Args:
        head: the model that a controller knows; it has to be the one of the configuration.
        num: 1.
        config: the path of the file that describes the hardware, see `vergence.hardware.config`,
            or what has been read of one.
        clock: a steady clock, s.
        sleep: waits for some seconds.

    Attributes:
        config: what the hardware is.
        begun_s: when the running trial began, by the clock, s.
        overruns: periods that were missed.
        trips: how often the servos' watchdog has stopped them within a trial.

    Raises:
        ConfigurationError: num is not 1, or the head is another than the configuration's.
        HeadFileError: the configuration cannot be.
    """

    def __init__(
        self,
        head: HeadModel,
        num: int = 1,
        *,
        config: str | HardwareConfig,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if num != 1:
            raise ConfigurationError(f"num: expected 1, as there is one real head, got {num}")
        self.config = config if isinstance(config, HardwareConfig) else load_hardware(config)
        refuse_other_head(self.config, head)
        self.head, self.num = head, num
        self.places_targets = bool(self.config.emulator)
        self.overruns = self.trips = 0
        self._clock, self._sleep = clock, sleep
        self._period_s = head.timing.period_s
        self._reading = Reading.empty(1)
        self._history = JointHistory()
        frame_s = head.timing.frame_s
        self._pairing = Pairing(self.config.pairing_tolerance_s, frame_s)
        self._servos = _Servos(self.config.servos, head)
        self._bus: Bus | None = None
        self._eyes: list[EyeThread] = []
        self._world: EmulatedWorld | None = None
        self._prepared = self._torque = self._begun = False
        self._missed_s: dict[int, float] = {}  # the first question that a servo has not answered
        self.begun_s = self._fed_s = self._pause_s = 0.0
        self._tick = 0

    @property
    def reading(self) -> Reading:
        """What the sensors report, in arrays that every step brings up to date."""
        return self._reading

    def prepare(self) -> None:
        """Compile what the loop calls, open the line and the cameras, and check both.

        Raises:
            HardwareError: a servo or a camera does not answer, or is another than expected.
            ConfigurationError: the line or a camera cannot be opened.
        """
        if self._prepared:
            return
        self._compile()
        atexit.register(_close, weakref.ref(self))
        try:
            self._open_bus()
            self._open_cameras()
            if self.config.emulator:
                self._world = EmulatedWorld(self.config.emulator)
        except BaseException:
            self.close()
            raise
        self._prepared = True

    def _compile(self) -> None:
        """Call every kernel of the loop once, on images that show nothing."""
        q = self.head.rest()
        poses = self.head.base_pose(q) @ self.head.camera_poses(q)
        for eye in range(2):
            width, height = self.head.cameras.size[eye].tolist()
            tracker = _tracker(self.head, eye, self.config.target)
            tracker.find(np.zeros((height, width), np.uint8), T_0_C=poses[eye])

    def _open_bus(self) -> None:
        self._bus = bus = Bus(self.config.bus.port, self.config.bus.baud_rate)
        for servo in self.config.servos:
            self._check(bus, servo)
            if bus.read(servo.id, table.OPERATING_MODE) != table.VELOCITY_MODE:
                bus.write(servo.id, table.TORQUE_ENABLE, 0)
                bus.write(servo.id, table.OPERATING_MODE, table.VELOCITY_MODE)
            bus.write(servo.id, table.BUS_WATCHDOG, 0)
            bus.write(servo.id, table.GOAL_VELOCITY, 0)
            self._servos.limit_ticks[servo.id] = bus.read(servo.id, table.VELOCITY_LIMIT)
        self._missed_s.clear()
        self._servos.forget()
        while not self._servos.known:
            self._sense_joints()

    def _check(self, bus: Bus, servo: ServoConfig) -> None:
        model = bus.ping(servo.id)
        what = f"servos: {servo.name}"
        if model is None:
            there = [one for one in range(1, 21) if bus.ping(one) is not None]
            raise HardwareError(
                f"{what}: expected a servo with the id {servo.id} on {self.config.bus.port} at "
                f"{self.config.bus.baud_rate} baud, got no answer; of the ids 1 to 20 "
                + (f"{', '.join(map(str, there))} answer" if there else "none answers")
            )
        if model not in table.MODELS:
            raise HardwareError(
                f"{what}: expected one of {', '.join(table.MODELS.values())} with the id "
                f"{servo.id}, got a servo with the model number {model}"
            )
        errors = bus.read(servo.id, table.HARDWARE_ERROR_STATUS)
        if errors:
            raise HardwareError(
                f"{what}: expected a servo without a fault, got the hardware error status "
                f"0b{errors:08b}, with which it takes no torque until it is rebooted"
            )

    def _open_cameras(self) -> None:
        for camera in self.config.cameras:
            self._eyes.append(EyeThread(camera, self.head, self.config.target, self._history))
        for eye in self._eyes:
            eye.start()
        until = self._clock() + _READY_TIMEOUT_S
        while not all(eye.ready for eye in self._eyes):
            self._sense_joints()
            for eye in self._eyes:
                eye.check()
                if not eye.ready and self._clock() > until:
                    raise HardwareError(
                        f"{eye.config.name}: expected {self.head.timing.frame_rate_hz:g} images a "
                        f"second from {eye.config.source}, got none at that pace within "
                        f"{_READY_TIMEOUT_S:g} s"
                    )
            self._sleep(self._period_s)

    @property
    def board(self) -> Board:
        """The board before an emulated head; a mere point for a robot, which looks at the world."""
        target = self.config.target
        if not self.places_targets or not isinstance(target, AprilTag):
            return POINT
        return EyeViews(self.head, target, width_rad="fit").board

    def show(self, ids: IntArray, motions: FloatArray) -> None:
        """Place the target before an emulated head, see `Plant.show`."""
        self.prepare()
        if self._world is not None:
            self._world.show(motions[0])

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Drive the joints to where a trial begins, and begin it; see `Plant.reset`.

        Raises:
            HardwareError: they do not get there, or the head does not answer.
        """
        self.prepare()
        self._begun = False
        self._switch_on()
        rested_s = self._drive_to(self.head.actuation.actuators_of(positions[0]))
        for eye in self._eyes:
            eye.forget()
        blank = Reading.empty(1)
        for own, empty in zip(self._reading, blank, strict=True):
            own[:] = empty
        self.begun_s = self._clock()
        self._tick = 0
        sights = self._first_images(rested_s)
        self.begun_s = self._clock()
        if self._world is not None:
            self._world.begin(self.begun_s)
        self._report(sights)
        self._reading.frame[0] = 0
        self._reading.command[:] = 0.0
        return self._reading

    def step(self, command: FloatArray) -> Reading:
        """Send a command and hold it for one control period, see `Plant.step`.

        Raises:
            ConfigurationError: a command is nan, or the shape is wrong.
            HardwareError: a servo or a camera has gone, or the servos have stopped by themselves.
        """
        if command.shape != (1, 7):
            raise ConfigurationError(f"command: expected shape (1, 7), got {command.shape}")
        if np.isnan(command).any():
            raise ConfigurationError("command: expected numbers, got nan")
        if not self._begun:
            self._begin()
        self._check_watchdog()
        self._reading.command[0] = self._send(command[0])
        self._wait()
        self._sense_joints()
        for eye in self._eyes:
            eye.check()
        self._report(self._newest())
        return self._reading

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """See `Plant.frames`."""
        images = [eye.frame for eye in self._eyes]
        if len(images) != 2 or images[0] is None or images[1] is None:
            return None
        return images[0], images[1]

    def truth(self) -> Truth | None:
        """What an emulated head knows about the present; None for a real one."""
        if self._world is None:
            return None
        return self._world.truth(self.head, float(self._reading.time_s[0]))

    def diagnostics(self) -> dict[str, int]:
        """How many images came alone or in pairs, periods were late and answers missing."""
        counts = self._pairing.counts
        return {
            "image_pairs": counts.pairs,
            "images_alone_left": counts.alone_left,
            "images_alone_right": counts.alone_right,
            "late_periods": self.overruns,
            "missed_answers": 0 if self._bus is None else self._bus.misses,
        }

    def close(self) -> None:
        """Bring the servos to rest, and release the line and the cameras."""
        bus, self._bus = self._bus, None
        try:
            if bus is not None:
                _stop(bus, self._servos.ids)
        finally:
            for eye in self._eyes:
                eye.close()
            if bus is not None:
                bus.close()
            if self._world is not None:
                self._world.close()
            self._eyes, self._world = [], None
            self._prepared = self._torque = self._begun = False

    # ---- the loop ----

    @property
    def _line(self) -> Bus:
        if self._bus is None:
            raise HardwareError("the head is closed: expected a reset first")
        return self._bus

    def _switch_on(self) -> None:
        """Torque at rest, and the watchdog armed anew."""
        for ident in self._servos.ids:
            self._line.write(ident, table.BUS_WATCHDOG, 0)
            self._line.write(ident, table.GOAL_VELOCITY, 0)
            if not self._torque:
                self._line.write(ident, table.TORQUE_ENABLE, 1)
        for ident in self._servos.ids:
            self._arm(ident)
        self._torque = True
        self._servos.carried[:] = 0.0
        self._fed_s, self._pause_s = self._clock(), 0.0

    def _arm(self, ident: int) -> None:
        steps = round(self.config.bus.watchdog_s / table.WATCHDOG_S)
        self._line.write(ident, table.BUS_WATCHDOG, max(1, steps))

    def _begin(self) -> None:
        """Let the trial's time begin with its first command: until then nothing has moved."""
        if self._watchdog_tripped():
            self._switch_on()
        now = self._clock()
        later = now - self.begun_s
        self.begun_s, self._tick, self._begun = now, 0, True
        for times in (self._reading.exposure_s, self._reading.received_s, self._reading.joints_s):
            times -= later
        if self._world is not None:
            self._world.begin(now)

    def _fed(self, now: float) -> None:
        """A packet has gone out: keep the longest time without one."""
        self._pause_s = max(self._pause_s, now - self._fed_s)
        self._fed_s = now

    def _watchdog_tripped(self) -> bool:
        """Whether the servos have stopped: any packet feeds them, so only a pause needs a look."""
        self._fed(self._clock())
        if self._pause_s < 0.5 * self.config.bus.watchdog_s:
            return False
        return any(
            self._line.read(one, table.BUS_WATCHDOG) == table.WATCHDOG_TRIPPED
            for one in self._servos.ids
        )

    def _check_watchdog(self) -> None:
        if self._watchdog_tripped():
            self.trips += 1
            raise HardwareError(
                f"bus: expected a packet at least every {self.config.bus.watchdog_s:g} s, got none "
                f"for {self._pause_s:.2f} s: the servos' watchdog has stopped them"
            )
        self._pause_s = 0.0

    def _send(self, velocity: FloatArray) -> FloatArray:
        """Give the servos velocities, (7,) rad/s; what was really sent."""
        ticks, sent = self._servos.ticks(velocity)
        self._line.sync_write(table.GOAL_VELOCITY, ticks)
        self._fed(self._clock())
        return sent

    def _wait(self) -> None:
        """Until the schedule's next tick; one that has passed a period ago is skipped."""
        self._tick += 1
        due_s = self.begun_s + self._tick * self._period_s
        left_s = due_s - self._clock()
        if left_s > 0.0:
            self._sleep(left_s)
        missed = int((self._clock() - due_s) // self._period_s)
        if missed > 0:
            self._tick += missed
            self.overruns += missed

    def _sense_joints(self) -> None:
        """Read the joints into the history; one that does not answer goes on as it went."""
        asked_s = self._clock()
        answers = self._line.sync_read(self._servos.ids, *_STATE)
        now = self._clock()
        self._fed(now)
        for servo in self.config.servos:
            if servo.id in answers:
                self._missed_s.pop(servo.id, None)
            elif now - self._missed_s.setdefault(servo.id, asked_s) > _SILENT_S:
                raise HardwareError(
                    f"servos: {servo.name}: expected an answer of the id {servo.id} on "
                    f"{self.config.bus.port}, got none for {_SILENT_S:g} s"
                )
        # the packets left the servos about half the exchange ago
        measured_s = 0.5 * (asked_s + now)
        self._servos.take(answers, measured_s)
        if self._servos.known:
            self._history.add(measured_s, *self._servos.joints())

    def _newest(self) -> Sights | None:
        """The newest images that have come since the last period."""
        for eye, thread in enumerate(self._eyes):
            for sight in thread.take():
                self._pairing.add(eye, sight)
        newest, now = None, self._clock()
        while (sights := self._pairing.next(now)) is not None:
            newest = sights
        return newest

    def _first_images(self, rested_s: float) -> Sights | None:
        """Images of the head at rest, where they come in time."""
        sights = None
        until = self._clock() + _FIRST_IMAGES_S
        while self._clock() < until:
            self._sleep(self._period_s)
            self._sense_joints()
            self._keep_alive()
            for eye in self._eyes:
                eye.check()
            sights = self._newest()
            if sights is not None and sights.exposed_s > rested_s:
                break
        return sights

    def _keep_alive(self) -> None:
        self._line.sync_write(table.GOAL_VELOCITY, dict.fromkeys(self._servos.ids, 0))
        self._fed(self._clock())

    def _drive_to(self, goal: FloatArray) -> float:
        """Bring the actuators to where a trial begins, slowly; when they came to rest."""
        servos = self._servos
        goal = np.clip(goal, servos.lower, servos.upper)
        limit = np.minimum(_START_RAD_S, self.head.actuation.velocity)
        begun_s, rested = self._clock(), 0
        while rested < _START_RESTED:
            self._sense_joints()
            for eye in self._eyes:
                eye.check()
            error = np.where(servos.there, goal - servos.angles, 0.0)
            moving = np.abs(servos.speeds)
            there = np.abs(error).max() < _START_WITHIN_RAD
            rested = rested + 1 if there and moving.max() < _START_REST_RAD_S else 0
            self._send(np.zeros(7) if there else np.clip(_START_GAIN * error, -limit, limit))
            if self._clock() - begun_s > _START_TIMEOUT_S:
                worst = max(self.config.servos, key=lambda one: abs(error[one.slot]))
                raise HardwareError(
                    f"servos: {worst.name}: expected the joint to reach {goal[worst.slot]:.3f} rad "
                    f"within {_START_TIMEOUT_S:g} s, got {servos.angles[worst.slot]:.3f} rad"
                )
            self._sleep(self._period_s)
        return self._clock()

    def _report(self, sights: Sights | None) -> None:
        """Bring the reading up to date."""
        reading = self._reading
        measured_s, q, v = self._history.newest()
        reading.time_s[0] = self._tick * self._period_s
        reading.joints_s[0] = measured_s - self.begun_s
        reading.positions[0], reading.velocities[0] = q, v
        if sights is None:
            return
        exposed_s, pixels = self._as_one(sights)
        reading.frame[0] += 1
        reading.exposure_s[0] = exposed_s - self.begun_s
        reading.received_s[0] = sights.ready_s - self.begun_s
        reading.positions_at_exposure[0] = self._history.at(exposed_s)
        reading.pixels[0] = pixels
        reading.visible[0] = np.isfinite(pixels).all(axis=-1)

    def _as_one(self, sights: Sights) -> tuple[float, FloatArray]:
        """One exposure's time and (2, 2) pixels; the time is a lone eye's own where one sees."""
        pixels = np.full((2, 2), np.nan)
        for eye, sight in enumerate(sights):
            if sight is not None:
                pixels[eye] = sight.pixel
        seeing = [one for one in sights if one is not None and np.isfinite(one.pixel).all()]
        if len(seeing) < 2:
            return (seeing[0].exposed_s if seeing else sights.exposed_s), pixels
        common_s = sights.exposed_s
        exposed = np.stack([self._history.at(one.exposed_s) for one in seeing])
        return common_s, at_common_time(self.head, pixels, exposed, self._history.at(common_s))


class _Servos:
    """Between angles of a head's actuators and ticks of its servos.

    Attributes:
        angles: (7,) of the neck's joints and the actuators of the eyes, rad.
        speeds: (7,) rad/s.
        there: (7,) whether there is a servo.
        lower: (7,) least angles, rad.
        upper: (7,) greatest angles, rad.
        carried: (7,) what the last commands have left over, ticks.
        limit_ticks: greatest speeds by id, ticks.
    """

    def __init__(self, servos: tuple[ServoConfig, ...], head: HeadModel) -> None:
        self._servos = servos
        self._head = head
        self.ids = [servo.id for servo in servos]
        self.angles, self.speeds = np.zeros(7), np.zeros(7)
        self.lower, self.upper = np.zeros(7), np.zeros(7)
        self.there = np.zeros(7, dtype=np.bool_)
        self.carried = np.zeros(7)
        self.limit_ticks: dict[int, int] = {}
        self._measured_s = np.full(7, np.nan)
        for servo in servos:
            self.lower[servo.slot], self.upper[servo.slot] = servo.lower_rad, servo.upper_rad
            self.there[servo.slot] = True
        timing = head.timing
        self._period_s = timing.period_s
        self._lag_s = timing.lag_s * head.actuation.lag_ratio + timing.command_latency_s
        self._brake = _BRAKING * np.clip(head.actuation.acceleration, 1e-3, _MOST_RAD_S2)

    @property
    def known(self) -> bool:
        """Whether each servo has told its angle."""
        return not np.isnan(self._measured_s[self.there]).any()

    def forget(self) -> None:
        """Know no angles: nobody has looked at the servos for a time."""
        self._measured_s[:] = np.nan

    def take(self, answers: dict[int, bytes], measured_s: float) -> None:
        """Take the answers to a question for speed and angle; who did not answer goes on.

        Args:
            answers: eight bytes by id, present velocity and present position.
            measured_s: when they were measured, s.
        """
        for servo in self._servos:
            slot, data = servo.slot, answers.get(servo.id)
            if data is None:
                # nan before the first answer; a longer silence is refused, or nobody has asked
                ahead_s = min(measured_s - self._measured_s[slot], _SILENT_S)
                if np.isnan(ahead_s):
                    continue
                self.angles[slot] += self.speeds[slot] * ahead_s
            else:
                speed = int.from_bytes(data[:4], "little", signed=True)
                ticks = int.from_bytes(data[4:], "little", signed=True)
                turns = servo.sign / servo.gear_ratio
                self.speeds[slot] = turns * speed * table.TICK_RAD_S
                self.angles[slot] = self._angle(servo, ticks)
            self._measured_s[slot] = measured_s

    @staticmethod
    def _angle(servo: ServoConfig, ticks: int) -> float:
        """The angle at a position, on the turn of the servo that is nearest to its range."""
        angle = (ticks - servo.zero_ticks) / servo.ticks_per_rad
        middle = 0.5 * (servo.lower_rad + servo.upper_rad)
        turn = table.TICKS_PER_TURN / abs(servo.ticks_per_rad)
        return angle - turn * round((angle - middle) / turn)

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """(7,) angles and (7,) speeds of the joints, rad and rad/s."""
        actuation = self._head.actuation
        q, v = actuation.joints_of(self.angles), self.speeds.copy()
        if not actuation.direct:
            v[EYES] = actuation.to_joints @ self.speeds[EYES]
        rest = self._head.rest()
        q[NECK] = np.where(self.there[NECK], q[NECK], rest[NECK])
        return q, v

    def ticks(self, velocity: FloatArray) -> tuple[dict[int, int], FloatArray]:
        """What to send for velocities, and the velocities that it stands for.

        Args:
            velocity: (7,) rad/s.

        Returns:
            Ticks by id, and (7,) rad/s.
        """
        limit = self._head.actuation.velocity
        wanted = np.clip(velocity, -limit, limit)
        up = self._stopping(self.upper - self.angles, self.speeds)
        down = self._stopping(self.angles - self.lower, -self.speeds)
        wanted = np.clip(wanted, -down, up)
        out, sent = {}, np.zeros(7)
        for servo in self._servos:
            slot, per_tick = servo.slot, servo.sign / servo.gear_ratio * table.TICK_RAD_S
            exact = wanted[slot] / per_tick
            most = self.limit_ticks.get(servo.id, 0)
            ticks = int(np.clip(np.rint(exact + self.carried[slot]), -most, most))
            still = abs(exact) < _STILL_TICKS
            self.carried[slot] = (
                0.0 if still else np.clip(exact + self.carried[slot] - ticks, -1, 1)
            )
            out[servo.id] = 0 if still else ticks
            sent[slot] = out[servo.id] * per_tick
        return out, sent

    def _stopping(self, room: FloatArray, speed: FloatArray) -> FloatArray:
        """The speed from which joints stop within some room, see the module's description."""
        late = self._brake * (self._lag_s + self._period_s)
        steady = np.sqrt(late**2 + 2.0 * self._brake * np.maximum(room, 0.0)) - late
        # a joint is still faster than its last commands, and coasts on by this
        fast = np.maximum(speed, 0.0)
        coasts = fast * self._lag_s + fast**2 / (2.0 * self._brake)
        return np.clip((room - coasts) / self._period_s, 0.0, steady)


def _tracker(head: HeadModel, eye: int, target: Target) -> Tracker:
    return Tracker(make_detector(target, EyeCamera.of(head, eye)))


def _stop(bus: Bus, ids: list[int]) -> None:
    """Zero velocity, as well as the line still allows; the watchdog is for where it does not."""
    for _ in range(3):
        with suppress(HardwareError):
            bus.sync_write(table.GOAL_VELOCITY, dict.fromkeys(ids, 0))
    for ident in ids:
        # a servo that its watchdog has stopped takes no goal before its watchdog is off
        for register in (table.BUS_WATCHDOG, table.GOAL_VELOCITY):
            with suppress(HardwareError):
                bus.write(ident, register, 0)


def _close(plant: "weakref.ref[HardwarePlant]") -> None:
    """At the end of a process that has not closed its head."""
    there = plant()
    if there is not None:
        there.close()
