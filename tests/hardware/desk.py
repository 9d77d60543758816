"""A robot on a desk: two pan-tilt turrets, four servos that are set up as they should be."""

import dataclasses
from types import SimpleNamespace

from tests.hardware.fakes import robot_config
from tests.hardware.line import ServoLine, make_servo
from vergence.hardware.config import BusConfig
from vergence.hardware.dynamixel import bus as bus_module
from vergence.hardware.dynamixel import checks
from vergence.hardware.dynamixel.packets import PacketParser


def ready_servos():
    return [make_servo(ident, lower=-3.2, upper=3.2) for ident in range(1, 5)]


def desk_config(port, baud_rate=1_000_000, **servo_values):
    """The configuration of such a robot; other values are those of the first servo."""
    config = robot_config(BusConfig(port=port, baud_rate=baud_rate))
    first = dataclasses.replace(config.servos[0], **servo_values)
    return dataclasses.replace(config, servos=(first, *config.servos[1:]))


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


def timeless_line(monkeypatch, servos, clock):
    line = TimelessLine(servos, clock)
    monkeypatch.setattr(bus_module, "SerialLine", lambda port, baud: line)
    monkeypatch.setattr(checks, "os", SimpleNamespace(path=SimpleNamespace(exists=bool)))
    return line
