"""An emulated robot in time that passes only when somebody waits: no process, no terminal."""

from types import SimpleNamespace

import numpy as np

from tests.hardware.fakes import HEAD, FakeClock, camera_config, robot_config
from vergence.errors import HardwareError
from vergence.hardware import robot as robot_module
from vergence.hardware.cameras import HeadEyes
from vergence.hardware.config import BusConfig
from vergence.hardware.drive import DriveThread
from vergence.hardware.dynamixel import bus
from vergence.hardware.dynamixel.packets import PacketParser
from vergence.hardware.emulator.faults import parse_fault
from vergence.hardware.emulator.world import World
from vergence.hardware.pairing import SearchedImage
from vergence.hardware.plant import HardwarePlant
from vergence.hardware.safety.limits import SafetyConfig

WATCHDOG_S = 0.2
LIMIT_RAD = 1.4
PORT = "/dev/null"  # one that is there


class VirtualLine:
    """The servos' line of a world, in place of `SerialLine`."""

    def __init__(self, world, clock, baud):
        self.port, self._world, self._clock, self.baud = PORT, world, clock, baud
        self._parser, self._due = PacketParser(), []

    def wire_s(self, count):
        return 10.0 * count / self.baud

    def _now(self):
        self._world.advance_to(self._clock())
        if self._world.faults.unplugged:
            raise HardwareError(f"{self.port}: the serial line is gone (was the cable pulled?)")
        return self._clock()

    def send(self, data):
        now = self._now()
        for packet in self._parser.feed(data):
            answers = self._world.answer(packet, now, self.baud)
            wire_s = self.wire_s(len(data) + sum(len(answer) for _, answer in answers))
            self._due += [(now + late_s + wire_s, answer) for late_s, answer in answers]
        self._due.sort(key=lambda one: one[0])

    def receive(self, until_s):
        self._now()
        in_time = self._due and self._due[0][0] <= until_s
        due_s, answer = self._due.pop(0) if in_time else (until_s, b"")
        self._clock.now = max(self._clock.now, due_s)
        return answer

    def drain(self):
        drained = b""
        while self._due and self._due[0][0] <= self._clock():
            drained += self._due.pop(0)[1]
        return drained

    def close(self):
        pass


class WatchedWorld(World):
    """A world that two cameras see; `seen` has by eye exposure and receipt, s, and the pixel."""

    def __init__(self, head, point, motors=None, *, latency_s, jitter_s=0.0, noise_px=0.1, seed=0):
        super().__init__(head, point, motors, seed)
        self.seen = [], []
        self._draws = np.random.default_rng((3, seed))
        self._due_s = [None, None]
        self._phases = self._draws.uniform(0.0, head.timing.frame_s, 2)
        self._camera = latency_s, jitter_s, noise_px

    def advance_to(self, now_s):
        if self._due_s[0] is None:
            self._due_s = [now_s + phase for phase in self._phases]
        while min(self._due_s) <= now_s:
            eye = int(np.argmin(self._due_s))
            super().advance_to(self._due_s[eye])
            self._expose(eye, self._due_s[eye])
            self._due_s[eye] += self.head.timing.frame_s
        super().advance_to(now_s)

    def _expose(self, eye, at_s):
        latency_s, jitter_s, noise_px = self._camera
        half_s = 0.5 * self.head.timing.exposure_s
        q, _, v = self._joints()
        if not self.head.actuation.direct:
            v[3:] = self.head.actuation.to_joints @ v[3:]
        point, *_ = self._target(q, at_s)
        pixel = self.head.project(q, point)[eye]
        ends = [self.head.project(q + side * half_s * v, point)[eye] for side in (-1.0, 1.0)]
        size = self.head.cameras.size[eye]
        shown = ((pixel > 20.0) & (pixel < size - 20.0)).all()
        smeared = np.linalg.norm(ends[1] - ends[0]) > self.head.sensor.max_smear_px
        pixel = pixel + self._draws.normal(0.0, noise_px, 2)
        late_s = latency_s + jitter_s * self._draws.random()
        received_s = max([at_s + late_s, *(one[1] for one in self.seen[eye][-1:])])
        pixel = pixel if shown and not smeared else pixel + np.nan
        self.seen[eye].append((at_s, received_s, pixel))


class VirtualEye:
    """Stands for `EyeThread`: sees the target in its middle, until its stream stalls or ends."""

    ready, frame = True, None

    def __init__(self, clock, config):
        self.config, self.ended_s, self.stalled_s = config, np.inf, np.inf
        self._clock, self._taken = clock, 0

    @property
    def newest_received_s(self):
        return HEAD.timing.frame_s * self._latest()

    def _latest(self):
        return int(min(self._clock(), self.stalled_s) / HEAD.timing.frame_s)

    def check(self):
        if self._clock() > self.ended_s:
            raise HardwareError(f"{self.config.name}: {self.config.source}: the stream ended")

    def take_searched_images(self):
        taken, self._taken = self._taken, self._latest()
        if taken == self._taken:
            return []
        now = self._clock()
        pixel = HEAD.cameras.principal[self.config.eye]
        return [SearchedImage(now - self.config.latency_s, now, pixel)]

    def forget_track(self):
        pass

    def close(self):
        pass


class VirtualCamera(VirtualEye):
    """An eye that sees what a world has shown it."""

    newest_received_s = None

    def __init__(self, clock, config, images):
        super().__init__(clock, config)
        self._images, self.newest_received_s = images, clock()

    def take_searched_images(self):
        new = []
        while self._taken < len(self._images) and self._images[self._taken][1] <= self._clock():
            _, self.newest_received_s, pixel = self._images[self._taken]
            exposed_s = self.newest_received_s - self.config.latency_s
            new.append(SearchedImage(exposed_s, self.newest_received_s, pixel))
            self._taken += 1
        return new


class VirtualClock(FakeClock):
    """Time in which a robot's drive has its say while somebody else sleeps."""

    drive = None

    def sleep(self, seconds):
        until_s = self.now + seconds
        while self.drive is not None and self.now + (look_s := self.drive.send_if_late()) < until_s:
            self.now += look_s
        self.now = max(self.now, until_s)

    def stand_still(self, seconds):
        """Let time pass in which this process does not run at all."""
        self.now += seconds


def virtual_config(head=HEAD, latency_s=0.1, **safety):
    """The configuration of a robot in simulated time, with bounds of `SafetyConfig`."""
    bus_config = BusConfig(port=PORT, watchdog_s=WATCHDOG_S)
    return robot_config(bus_config, head, LIMIT_RAD, latency_s, safety=SafetyConfig(**safety))


class VirtualRobot:
    """A plant in simulated time; camera i shows the world's eye `eyes[i]`; more are bounds."""

    proves = True

    def __init__(
        self, monkeypatch, world=None, config=None, eyes=(0, 1), plant_options=None, **safety
    ):
        self.clock = VirtualClock(1000.0)
        self._order = eyes
        self.world = world or World(HEAD, np.array([0.0, -0.1, 1.0]))
        self.world.advance_to(self.clock())
        monkeypatch.setattr(
            bus, "SerialLine", lambda _port, baud: VirtualLine(self.world, self.clock, baud)
        )
        monkeypatch.setattr(bus, "time", SimpleNamespace(monotonic=self.clock))
        self.config = config or virtual_config(**safety)
        monkeypatch.setattr(DriveThread, "start", lambda drive: setattr(self.clock, "drive", drive))
        monkeypatch.setattr(robot_module, "compile_loop_kernels", lambda _head, _target: None)
        monkeypatch.setattr(robot_module, "check_local_cameras", lambda _config: [])
        monkeypatch.setattr(HeadEyes, "open", lambda eyes, _idle: self._open_cameras(eyes))
        self.options = {
            "clock": self.clock, "sleep": self.clock.sleep,
            "view_check": isinstance(self.world, WatchedWorld), **(plant_options or {}),
        }  # fmt: skip
        self.plant = HardwarePlant(self.config.head, config=self.config, **self.options)
        self.plant.robot.supervisor.proved_joints[:] |= not self.proves

    def _open_cameras(self, eyes):
        if isinstance(self.world, WatchedWorld):
            self.eyes = [
                VirtualCamera(self.clock, camera, self.world.seen[shown])
                for camera, shown in zip(self.config.cameras, self._order, strict=True)
            ]
        else:
            self.eyes = [VirtualEye(self.clock, camera_config(eye)) for eye in range(2)]
        eyes.threads.extend(self.eyes)

    def begin(self, left_pan_rad=0.0):
        """Begin a trial straight ahead but for one joint."""
        start = self.config.head.rest()[None].copy()
        start[0, 3] += left_pan_rad
        self.plant.reset(np.zeros(1, np.int64), start)

    def step(self, speeds, count=1):
        """Request speeds, rad/s, of one or all joints, for some periods; the last reading."""
        for _ in range(count):
            reading = self.plant.step(np.broadcast_to(np.asarray(speeds, float), (1, 7)))
        return reading

    def follow(self, command, seconds):
        """Step commands by the time, s, for some seconds or until the robot is stopped."""
        until_s = self.clock() + seconds
        while self.clock() < until_s and not self.plant.fault:
            self.plant.step(command(self.clock()))

    def fault(self, **request):
        fault = parse_fault(request, self.world.ids, timed=False)
        self.world.begin_fault(fault, self.clock())

    def rested_s(self, since_s):
        """After how long from a time on all joints rested, s; inf if one turns now."""
        rested_s = self.world.rest_report(since_s, self.clock())["rested_s"]
        return np.inf if rested_s is None else rested_s - since_s

    def registers(self, register):
        return [servo.get(register) for servo in self.world.servos.values()]
