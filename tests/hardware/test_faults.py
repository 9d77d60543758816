"""Messages on a robot's failure in a gaze: one line that names the part, and exit status 1."""

import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.client import WorldClient

pytestmark = REAL_TIME


@pytest.fixture
def head(emulated_desk: Path, tmp_path: Path):
    """A configuration of its own of the emulated head, and its world."""
    desk = Path(shutil.copy(emulated_desk, tmp_path))
    with closing(WorldClient(load_hardware(desk).emulator_address)) as world:
        yield desk, world


def start(desk: Path, *options: str, **process: Any) -> subprocess.Popen[str]:
    """A gaze in a process of its own."""
    words = ["gaze", "--plant", "hardware", "--config", str(desk), "--controller", "state-feedback"]
    words += ["--out", str(desk.parent / "run"), *options]
    return subprocess.Popen(
        [sys.executable, "-m", "vergence", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **process,
    )


def failure(process: subprocess.Popen[str]) -> str:
    """The line that a gaze ends with; it has no other, and status 1."""
    out, said = process.communicate(timeout=120)
    assert process.returncode == 1, said
    assert out == ""
    errors = [line for line in said.splitlines() if "error" in line]
    assert len(errors) == 1, said
    assert "Traceback" not in said
    return errors[0]


def wait_until_moving(world: WorldClient) -> None:
    """Until the joints turn fast, as they do towards a target."""
    until = time.monotonic() + 120.0
    while np.abs(world.ask({"state": None})["velocities"]).max() < 0.3:
        assert time.monotonic() < until
        time.sleep(0.005)


def speed_after(world: WorldClient, seconds: float) -> float:
    """The greatest speed of a joint after some time."""
    time.sleep(seconds)
    return float(np.abs(world.ask({"state": None})["velocities"]).max())


@pytest.mark.nightly
def test_a_pulled_cable(tmp_path: Path) -> None:
    with (
        emulated(tmp_path) as (desk, _process),
        closing(WorldClient(load_hardware(desk).emulator_address)) as world,
    ):
        process = start(desk, "--target", "100", "-200", "700")
        wait_until_moving(world)
        world.ask({"unplug": None})
        assert "gone" in failure(process)
        # by the servos' own watchdog
        assert speed_after(world, 0.5) < 0.02


def test_an_end_from_outside_brakes_first_though_ctrl_c_is_ignored(head) -> None:
    desk, world = head
    process = start(
        desk,
        *("--target", "100", "-200", "700"),
        # as a shell starts what is to run in the background
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    wait_until_moving(world)
    since_s = time.monotonic()
    process.terminate()
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    rested_s = world.rest_start_s(since_s)
    assert rested_s is not None
    assert rested_s - since_s < 0.5
