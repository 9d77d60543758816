"""An emulated head in processes of its own, as `vergence emulate` makes it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.client import WorldClient

REAL_TIME = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals as serial lines"),
    # A loop stops, as it should, where the machine leaves its process no time for 0.1 s: these
    # tests run alone, after all others, and again where a machine is busy with other work.
    pytest.mark.real_time,
    pytest.mark.flaky(reruns=3, reruns_delay=15),
]
"""Marks of tests whose emulated head and loop keep real time."""


@contextmanager
def emulated(folder: Path, *options: str) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """Emulate a head while the block runs: the path of its configuration, and the process."""
    desk = folder / "desk.toml"
    words = [sys.executable, "-m", "vergence", "emulate", "--out", str(desk), *options]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = ""
            while "until Ctrl-C" not in said:
                line = process.stderr.readline() if process.stderr else ""
                assert line, f"vergence emulate has ended: {said}"
                said += line
            yield desk, process
        finally:
            process.terminate()


def world_of(desk: Path) -> closing[WorldClient]:
    """A client of the emulated head of a configuration, to be closed."""
    return closing(WorldClient(load_hardware(desk).emulator_address))
