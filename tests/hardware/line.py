"""Emulated servos on a real pseudo-terminal, served by a thread."""

import os
import pty
import select
import threading
import time
import tty

from vergence.hardware.dynamixel.packets import Parser
from vergence.hardware.emulator.servos import Servo, ServoLine


def make_servo(id=1, **options):
    """A servo with a quick joint."""
    return Servo(
        id, **{"lag_s": 0.02, "acceleration": 50.0, "lower": -1.0, "upper": 1.0, **options}
    )


class ServedLine:
    """A `ServoLine` behind a serial port.

    Args:
        line: the servos.
        echo: whether packets come back, as from adapters for half-duplex lines.
        alter: gives what is sent in place of the answers to a packet.

    Attributes:
        port: the device to open.
    """

    def __init__(self, line, echo=False, alter=lambda packet, answers: answers):
        self.line, self.echo, self.alter = line, echo, alter
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._wake, self._waker = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def send(self, data):
        """Send bytes that nobody asked for."""
        os.write(self._master, data)

    def hang_up(self):
        """Pull the cable."""
        if self._thread.is_alive():
            os.write(self._waker, b"x")
            self._thread.join()
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1

    def close(self):
        """Stop serving."""
        self.hang_up()
        os.close(self._wake)
        os.close(self._waker)

    def _serve(self):
        parser = Parser()
        while True:
            ready, _, _ = select.select([self._master, self._wake], [], [])
            if self._wake in ready:
                return
            data = os.read(self._master, 4096)
            if self.echo:
                os.write(self._master, data)
            for packet in parser.feed(data):
                answers = self.line.answer(packet, time.monotonic())
                if out := self.alter(packet, answers):
                    os.write(self._master, out)


def served_line(servos, **options):
    """Servos behind a port, to be closed."""
    return ServedLine(ServoLine(servos), **options)
