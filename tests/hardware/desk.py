"""A robot on a desk: two pan-tilt turrets, four servos that are set up as they should be."""

import dataclasses

from tests.hardware.fakes import HEAD, TAG, camera_config
from tests.hardware.line import ServoLine, make_servo
from vergence.hardware.config import BusConfig, HardwareConfig, ServoConfig, actuator_slots
from vergence.hardware.dynamixel import bus as bus_module
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.packets import PacketParser


def ready_servos():
    return [make_servo(ident, lower=-3.2, upper=3.2) for ident in range(1, 5)]


def desk_config(port, baud_rate=1_000_000, **servo_values):
    """The configuration of such a robot; other values are those of the first servo."""
    servos = [
        ServoConfig(
            name=name, slot=slot, id=ident, zero_ticks=2048, sign=1, gear_ratio=1.0,
            lower_rad=-1.5, upper_rad=1.5,
        )
        for ident, (name, slot) in enumerate(actuator_slots(HEAD).items(), 1)
    ]  # fmt: skip
    servos[0] = dataclasses.replace(servos[0], **servo_values)
    return HardwareConfig(
        path="robot.toml", head=HEAD, target=TAG, bus=BusConfig(port=port, baud_rate=baud_rate),
        servos=tuple(servos), cameras=(camera_config(0), camera_config(1, source="8")),
        pairing_tolerance_s=0.6 * HEAD.timing.frame_s, emulator_address="",
    )  # fmt: skip


class TimelessLine:
    """A serial line whose servos answer at once, by a clock of the test's own."""

    port, baud = "/dev/ttyNONE", 1_000_000

    def __init__(self, servos, clock):
        self.servos = servos
        self._line, self._clock = ServoLine(servos), clock
        self._parser, self._waiting = PacketParser(), b""

    def wire_s(self, count):
        return 0.0

    def send(self, data, timeout_s=0.1):
        for packet in self._parser.feed(data):
            answers = self._line.answer(packet, self._clock())
            self._waiting += b"".join(answer.data for answer in answers)

    def receive(self, until_s):
        data, self._waiting = self._waiting, b""
        return data

    def drain(self):
        return self.receive(0.0)

    def close(self):
        pass


def timeless_bus(monkeypatch, servos, clock):
    line = TimelessLine(servos, clock)
    monkeypatch.setattr(bus_module, "SerialLine", lambda port, baud: line)
    return Bus(line.port)
