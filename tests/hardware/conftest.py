"""The served lines that the tests of the bus and of the servos share, and their idle core."""

import os
import time
from pathlib import Path

import pytest


@pytest.fixture
def robot(monkeypatch):
    from tests.hardware.virtual import VirtualRobot

    return VirtualRobot(monkeypatch)


@pytest.fixture(autouse=True)
def proved(request, monkeypatch):
    """Robots in simulated time whose joints are known to follow, but in tests of the proof."""
    from tests.hardware.virtual import VirtualRobot

    monkeypatch.setattr(VirtualRobot, "proves", "prove" in request.node.name)


@pytest.fixture
def serve():
    from tests.hardware.line import ServedLine

    lines = []

    def start(servos, **options):
        lines.append(ServedLine(servos, **options))
        return lines[-1]

    yield start
    for line in lines:
        line.close()


@pytest.fixture
def own():
    """Four servos of the test's own, that are set up as they should be."""
    from tests.hardware.line import ready_servos

    return ready_servos()


@pytest.fixture(autouse=True)
def idle_core(request):
    """Tests of real time wait, for 20 s at most, until other work leaves them a core."""

    def ticks():
        return [int(word) for word in Path("/proc/stat").read_text().splitlines()[0].split()[1:]]

    end_s = time.monotonic() + 20.0
    while request.node.get_closest_marker("real_time") and time.monotonic() < end_s:
        before = ticks()
        time.sleep(0.5)
        passed = [now - then for now, then in zip(ticks(), before, strict=True)]
        # time of all cores that is idle, or taken by what yields to others
        if (passed[1] + passed[3]) * (os.cpu_count() or 1) >= sum(passed):
            break
