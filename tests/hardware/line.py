"""Emulated servos on a pseudo-terminal or on a line without time, and a robot that has them."""

import dataclasses
import os
import pty
import select
import threading
import time
import tty

import pytest

from tests.hardware.fakes import robot_config
from vergence.hardware.config import BusConfig
from vergence.hardware.dynamixel import bus as bus_module
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.packets import PacketParser
from vergence.hardware.emulator.server import baud_rate_of
from vergence.hardware.emulator.servo import ENCODER_ERROR, EmulatedServo
from vergence.hardware.emulator.world import ServoLine


def make_servo(id=1, **options):
    """A servo with a quick joint, at 1 Mb/s, that answers at once, and stops without encoder."""
    usual = {"lag_s": 0.02, "acceleration": 50.0, "lower": -1.0, "upper": 1.0}
    servo = EmulatedServo(id, **usual | options)
    servo.set(table.BAUD_RATE, table.BAUD_RATES.index(1_000_000))
    servo.set(table.RETURN_DELAY_TIME, 0)
    servo.set(table.SHUTDOWN, servo.get(table.SHUTDOWN) | ENCODER_ERROR)
    return servo


class ServedLine:
    """A `ServoLine` behind a serial port, with the servos' own delays."""

    def __init__(self, servos, echo=False, alter=lambda packet, answers: answers, hears_rate=False):
        self.line = ServoLine(servos)
        self.echo, self.alter, self.hears_rate = echo, alter, hears_rate
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._wake, self._waker = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def send(self, data):
        os.write(self._master, data)

    def hang_up(self):
        if self._thread.is_alive():
            os.write(self._waker, b"x")
            self._thread.join()
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1

    def close(self):
        self.hang_up()
        os.close(self._wake)
        os.close(self._waker)

    def _serve(self):
        parser = PacketParser()
        while True:
            ready, _, _ = select.select([self._master, self._wake], [], [])
            if self._wake in ready:
                return
            data = os.read(self._master, 4096)
            rate = baud_rate_of(self._master) if self.hears_rate else None
            if self.echo:
                os.write(self._master, data)
            for packet in parser.feed(data):
                answers = self.line.answer(packet, time.monotonic(), rate)
                if delay_s := sum(answer.return_delay_s for answer in answers):
                    time.sleep(delay_s)
                if out := self.alter(packet, b"".join(answer.data for answer in answers)):
                    os.write(self._master, out)


def ready_servos(**options):
    """Four servos that are set up as they should be, of two pan-tilt turrets on a desk."""
    return [make_servo(ident, lower=-3.2, upper=3.2, **options) for ident in range(1, 5)]


def desk_config(port, baud_rate=1_000_000, **servo_values):
    """The configuration of such a robot; other values are those of the first servo."""
    config = robot_config(BusConfig(port=port, baud_rate=baud_rate))
    first = dataclasses.replace(config.servos[0], **servo_values)
    return dataclasses.replace(config, servos=(first, *config.servos[1:]))


def open_briefly(config):
    """The open servos of a configuration, whose answers are waited for no longer than needed."""
    opened = config.make_servos(time.monotonic)
    opened.open()
    opened._bus.single_timeout_s = 0.01
    return opened


class TimelessLine:
    """A serial line whose servos answer at once, by a clock of the test's own."""

    port, baud = "/dev/null", 1_000_000  # one that is there

    def __init__(self, servos, clock):
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


def open_timeless(config, servos, clock):
    """The open servos of a configuration, by emulated ones on a line without time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bus_module, "SerialLine", lambda _port, _baud: TimelessLine(servos, clock))
        opened = config.make_servos(clock)
        opened.open()
    return opened
