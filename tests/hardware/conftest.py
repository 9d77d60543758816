"""The served lines that the tests of the bus and of the servos share."""

import sys

import pytest

# these need pseudo-terminals
NEED = [
    "checks",
    "dynamixel/test_bus.py",
    "emulator",
    *(f"test_{one}.py" for one in ("health", "jog", "plant", "scan_bus")),
]
collect_ignore = NEED if sys.platform == "win32" else []


@pytest.fixture
def serve():
    """Serve servos on a pseudo-terminal until the test ends."""
    from tests.hardware.line import served_line

    lines = []

    def start(servos, **options):
        lines.append(served_line(servos, **options))
        return lines[-1]

    yield start
    for line in lines:
        line.close()
