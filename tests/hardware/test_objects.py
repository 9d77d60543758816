"""A robot looks at what a user's own detector finds, in the images of an emulated head."""

import json
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated
from vergence.envs.plants.cameras import RoomImageRenderer
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.client import WorldClient
from vergence.recording.follow import Click, write_click
from vergence.recording.log import read_log
from vergence.vision.objects.scenes import parse_scene

pytestmark = [*REAL_TIME, pytest.mark.nightly]
BALL = Path("docs/examples/ball_target.py").resolve()
BREAKS = f"""
import runpy
from pathlib import Path

class Breaks(runpy.run_path({str(BALL)!r})["Ball"]):
    calls = 0
    def detect(self, image, hint):
        self.calls += 1
        if self.calls > 150:
            raise RuntimeError("no more")
        return super().detect(image, hint)
"""


def command(desk, *words):
    return [
        sys.executable, "-m", "vergence", "deploy", "state-feedback", "--config", str(desk), *words
    ]  # fmt: skip


def deploy(desk, *words):
    return subprocess.run(
        command(desk, *words),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=desk.parent,
    )


def assert_looks_at(head, trial, pixel, at_s):
    """Assert that both eyes end on the place of the room that the left one saw at a pixel."""
    times = trial.readings.time_s[:, 0]
    q = trial.readings.positions[np.searchsorted(times, at_s), 0]
    place = RoomImageRenderer(head, parse_scene("room")).surface(q, 0, pixel)
    base = head.base_pose(q) @ [*place, 1.0]
    end = trial.readings.positions[-1, 0]
    seen = head.project(end, (np.linalg.inv(head.base_pose(end)) @ base)[:3])
    assert np.abs(seen - head.cameras.principal).max() < 3.0


def test_it_looks_at_a_ball_and_comes_to_rest_when_the_detector_fails(tmp_path):
    (tmp_path / "mine.py").write_text(BREAKS)
    with emulated(tmp_path, "--head", "icub", "--scene", "ball:#ff8000:80") as (desk, _process):
        looked = deploy(desk, "--target", f"{BALL}:Ball", "--json")
        assert looked.returncode == 0, looked.stderr
        assert json.loads(looked.stdout)["settled_fraction"] == 1.0
        failed = deploy(desk, "--target", "mine.py:Breaks", "--gazes", "3", "--no-view-check")
        assert failed.returncode == 1
        assert "mine.py:10 in detect: RuntimeError: no more" in failed.stderr.splitlines()[-1]
        with closing(WorldClient(load_hardware(desk).emulator_address)) as world:
            assert np.abs(world.ask({"state": None})["velocities"]).max() < 0.03


def test_it_looks_at_a_named_point_and_then_at_a_clicked_one(tmp_path):
    log, named, clicked = tmp_path / "one.mcap", (210.0, 80.0), np.array([120.0, 150.0])
    words = "--target", "point", "--pixel", "left", *map(str, named), "--log", str(log)
    with emulated(tmp_path, "--head", "icub", "--scene", "room") as (desk, _process):
        looked = deploy(desk, *words, "--json")
        assert looked.returncode == 0, looked.stderr
        (trial,) = read_log(log).trials
        head = load_hardware(desk).head
        assert trial.truths is None
        assert_looks_at(head, trial, named, 0.0)
        log.unlink()
        with subprocess.Popen(command(desk, *words, "--duration", "6")) as robot:
            while robot.poll() is None and not moving(log):
                time.sleep(0.2)
            time.sleep(1.5)
            clicked_s = time.monotonic()
            write_click(log, Click(0, clicked, clicked_s))
        (trial,) = read_log(log).trials
        assert_looks_at(head, trial, clicked, clicked_s - trial.begun_s)


def moving(log):
    return log.exists() and any(trial.commands for trial in read_log(log).trials)
