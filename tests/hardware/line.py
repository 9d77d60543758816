"""Emulated servos on a real pseudo-terminal, served by a thread."""

import os
import pty
import select
import threading
import time
import tty

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

    def __init__(self, line, echo=False, alter=lambda packet, answers: answers, hears_rate=False):
        self.line, self.echo, self.alter, self.hears_rate = line, echo, alter, hears_rate
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


def served_line(servos, **options):
    return ServedLine(ServoLine(servos), **options)
