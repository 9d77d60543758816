"""The served lines that the tests of the bus and of the servos share."""

import pytest

from tests.hardware.line import served_line


@pytest.fixture
def serve():
    """Serve servos on a pseudo-terminal until the test ends."""
    lines = []

    def start(servos, **options):
        lines.append(served_line(servos, **options))
        return lines[-1]

    yield start
    for line in lines:
        line.close()
