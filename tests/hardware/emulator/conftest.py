"""The world of an emulated head behind its server, at a time that the test sets."""

import threading
from contextlib import closing

import pytest

from tests.hardware.emulator.asking import POINT
from tests.hardware.fakes import FakeClock
from vergence import load_head
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.server import EmulatorServer
from vergence.hardware.emulator.world import World


@pytest.fixture
def served():
    with closing(Served()) as one:
        yield one


class Served:
    def __init__(self):
        self.clock = FakeClock()
        self.world = World(load_head("turrets"), POINT)
        self.server = EmulatorServer(self.world, clock=self.clock)
        self._over = threading.Event()
        self._thread = threading.Thread(
            target=self.server.serve, args=(self._over.is_set,), kwargs={"poll_s": 0.01}
        )
        self._thread.start()
        self.client = WorldClient(self.server.address)

    def close(self):
        self.client.close()
        self._over.set()
        self._thread.join()
        self.server.close()
