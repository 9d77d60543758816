"""The served world of an emulated head."""

from contextlib import closing

import pytest

from tests.hardware.emulator.asking import Served


@pytest.fixture
def served():
    with closing(Served()) as one:
        yield one
