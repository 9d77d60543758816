"""A robot looks at what a user's own detector finds, in the images of an emulated head."""

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.client import WorldClient

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


def deploy(desk, *words):
    command = [sys.executable, "-m", "vergence", "deploy", "state-feedback", "--config", str(desk)]
    return subprocess.run(
        [*command, *words],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=desk.parent,
    )


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
