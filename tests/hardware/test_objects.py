"""Robots with heads and scenes of their own: what they look at, and what a looker sees."""

import json
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated, world_of
from tests.hardware.fakes import HEAD
from vergence.envs.plants.cameras import RoomImageRenderer
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.server import parse_sized_board, tilted_board_pose
from vergence.hardware.robot import RobotLooker
from vergence.recording.events import Looker
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


def deploy(
    desk,
    *words,
):
    command = [sys.executable, "-m", "vergence", "deploy", "state-feedback", "--config", str(desk)]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [*command, *words], stdout=pipe, stderr=pipe, text=True, cwd=desk.parent
    )


def deployed(desk, *words):
    """The exit code, output and errors of a deployment that has ended."""
    with deploy(desk, *words) as process:
        out, said = process.communicate(timeout=120)
    return process.returncode, out, said


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
        code, out, said = deployed(desk, "--target", f"{BALL}:Ball", "--json")
        assert code == 0, said
        assert json.loads(out)["settled_fraction"] == 1.0
        failing = "--target", "mine.py:Breaks", "--gazes", "3", "--no-view-check"
        code, _out, said = deployed(desk, *failing)
        assert code == 1
        assert "mine.py:10 in detect: RuntimeError: no more" in said.splitlines()[-1]
        with world_of(desk) as world:
            assert np.abs(world.ask({"state": None})["velocities"]).max() < 0.03


def test_it_looks_at_a_named_point_and_then_at_a_clicked_one(tmp_path):
    log, named, clicked = tmp_path / "one.mcap", (210.0, 80.0), np.array([120.0, 150.0])
    words = "--target", "point", "--pixel", "left", *map(str, named), "--log", str(log)
    with emulated(tmp_path, "--head", "icub", "--scene", "room") as (desk, _process):
        code, _out, said = deployed(desk, *words, "--json")
        assert code == 0, said
        (trial,) = read_log(log).trials
        head = load_hardware(desk).head
        assert trial.truths is None
        assert_looks_at(head, trial, named, 0.0)
        log.unlink()
        with deploy(desk, *words, "--duration", "6") as robot:
            while robot.poll() is None and not moving(log):
                time.sleep(0.2)
            time.sleep(1.5)
            clicked_s = time.monotonic()
            write_click(log, Click(0, clicked, clicked_s))
        (trial,) = read_log(log).trials
        assert_looks_at(head, trial, clicked, clicked_s - trial.begun_s)


def moving(log):
    return log.exists() and any(trial.commands for trial in read_log(log).trials)


BOARD = parse_sized_board("checkerboard:9x6:24")
SEED, SCALE = 4, 0.5
TRUE = HEAD.perturbed(np.random.default_rng(SEED), TWIN_SPREADS.scaled(SCALE))
CORNERS = np.column_stack([BOARD.corners_m, np.zeros(len(BOARD.corners_m)), np.ones(54)])
T_0_T = tilted_board_pose(HEAD, BOARD, 0.7)
TURNS = np.array([[0, 0, 0, 0], [0.1, 0.05, 0.1, -0.1], [0.104, 0.046, 0.1, -0.1],
                  [-0.2, 0.1, -0.1, 0.1], [0.1, -0.15, -0.2, -0.1]])  # fmt: skip
ASIDE = np.array([0, 0, 0, 1.2, 0, 0, 0])


def projected(q: np.ndarray) -> np.ndarray:
    """(2, n, 2) px, where the true head has the board's corners."""
    points = CORNERS @ T_0_T.T @ np.linalg.inv(TRUE.base_pose(q)).T
    return np.stack([TRUE.project(q, point[:3]) for point in points], axis=1)


def test_sights_are_those_of_the_true_head_at_its_angles(tmp_path: Path) -> None:
    options = ["--board", str(BOARD), "--errors", str(SCALE), "--seed", str(SEED)]
    with (
        emulated(tmp_path, *options) as (desk, _process),
        world_of(desk) as world,
        closing(RobotLooker(desk, BOARD)) as looker,
    ):
        _known: Looker = looker
        for turn in TURNS:
            q = HEAD.rest() + np.array([0, 0, 0, *turn])
            sight = looker.look(q)
            true_q = np.array(world.ask({"state": None})["positions"])
            assert np.abs(true_q - q).max() < 0.005
            assert np.abs(sight.positions - true_q).max() < HEAD.sensor.encoder_resolution_rad
            beside_px = sight.corners_px - projected(true_q)
            assert np.sqrt(np.mean(beside_px**2)) < 0.07
            assert np.abs(beside_px).max() < 0.3
        aside = looker.look(HEAD.rest() + ASIDE)
        assert aside.corners_px[0] is None
        assert aside.corners_px[1] is not None
