"""The whole way: an emulated head on the wire, two streams, and a law that turns it."""

import dataclasses
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated
from tests.hardware.fakes import HEAD
from vergence.envs.plants.cameras import RoomImageRenderer
from vergence.errors import ConfigurationError
from vergence.eval.robot.config import DeployConfig, ReplayConfig
from vergence.eval.robot.deploy import GazeState, deploy
from vergence.eval.robot.replay import replay
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.hardware.config import load_hardware
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.emulator.server import parse_sized_board, tilted_board_pose
from vergence.hardware.looker import RobotLooker
from vergence.recording.events import Looker
from vergence.recording.follow import Click, write_click
from vergence.recording.log import read_log
from vergence.vision.objects.scenes import parse_scene

pytestmark = REAL_TIME


BREAKS = """
import numpy as np

class Breaks:
    def __init__(self, head, layout):
        self.calls = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        if self.calls > 20:
            return 1 / 0
        return np.full((1, 4), 0.1, np.float32), state
"""
README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with emulated(tmp_path_factory.mktemp("desk")) as (path, _process):
        yield path


def gaze(desk: Path, out: Path, *target: str, **options: Any) -> subprocess.Popen[str]:
    """`vergence gaze` on the emulated head, in a process of its own."""
    words = ["gaze", "--plant", "hardware", "--config", str(desk), "--out", str(out)]
    words += ["--point", *target]
    return subprocess.Popen(
        [sys.executable, "-m", "vergence", *words], stderr=subprocess.PIPE, text=True, **options
    )


def test_the_command_turns_the_head_to_the_target(desk: Path, tmp_path: Path) -> None:
    with gaze(desk, tmp_path / "run", "50", "-80", "900") as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["truth_mm"] == pytest.approx([50.0, -80.0, 900.0])
    assert (tmp_path / "run" / "hardware.toml").read_text() == desk.read_text()
    for fix in (result["gaze"], result["itpc"]):
        assert (np.abs(fix["error_mm"]) < 3.5 * np.array(fix["sigma_mm"])).all()


@pytest.mark.nightly
def test_the_ten_lines_of_the_readme_run_on_it(desk: Path) -> None:
    code = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[0]
    simulated, robot = re.findall(r"^(?:# )?env = .*$", code, re.MULTILINE)
    code = code.replace(simulated, "").replace(robot, robot.removeprefix("# "))
    names: dict[str, Any] = {}
    try:
        exec(code.replace("desk.toml", str(desk)).replace("env.close()", ""), names)
        assert names["truncated"]
        assert np.abs(names["env"].unwrapped.truth().pixel_error).max() < 2.0
    finally:
        names["env"].close()


def test_a_law_is_deployed_logged_and_asks_for_the_same_again(desk: Path, tmp_path: Path) -> None:
    config = DeployConfig(controller="state-feedback", hardware=desk, gazes=2, duration_s=1.0)
    shown: list[GazeState] = []
    result = deploy(config, tmp_path / "run.mcap", show=shown.append)
    summary = result.summary()
    assert (summary["gazes"], summary["settled_fraction"], summary["faults"]) == (2, 1.0, [])
    assert summary["point_error_median_mm"] < 100.0
    assert {present.number for present in shown} == {1, 2}
    again = replay(ReplayConfig(log=result.log, controller="state-feedback"))
    assert again.rerun is not None
    commands = again.rerun.summary()
    assert commands["identical"] == commands["commands"] == len(shown) - 2
    assert again.gazes.rows() == result.gazes.rows()
    assert all(one.images is not None for one in again.results)
    assert len(again.log.detections) > 2 * 2 * 25


def test_a_deployment_is_resumed_with_the_gazes_that_are_missing(
    desk: Path, tmp_path: Path
) -> None:
    config = DeployConfig(controller="state-feedback", hardware=desk, gazes=1, duration_s=1.0)
    first = deploy(config, tmp_path / "first.mcap")
    config = dataclasses.replace(config, gazes=2, resume=first.log)
    second = deploy(config, tmp_path / "second.mcap")
    assert second.gazes.rows()[:1] == first.gazes.rows()
    assert second.summary()["gazes"] == 2
    assert len(read_log(second.log).trials) == 1
    for changed, said in (
        ({"resume": second.log}, "with which 2 are complete"),
        ({"controller": "ibvs"}, "resume: expected the controller of"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            deploy(dataclasses.replace(config, **changed), tmp_path / "third.mcap")


def test_a_policy_that_raises_rests_and_names_its_line(desk: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(BREAKS)
    config = DeployConfig(controller=f"{mine}:Breaks", hardware=desk)
    result = deploy(config, tmp_path / "run.mcap")
    with closing(WorldClient(load_hardware(desk).emulator_address)) as world:
        ended_s = time.monotonic()
        while (rested_s := world.rest_start_s(ended_s - 1.0)) is None:
            assert time.monotonic() < ended_s + 5.0
        assert rested_s < ended_s + 0.2  # what the joints' lag leaves
    assert re.search(r"mine\.py:\d+ in predict: ZeroDivisionError", str(result.error))
    log = read_log(result.log)
    assert "ZeroDivisionError" in log.stop_reasons[0]
    assert log.trials[0].steps == 19  # of 21 calls one prepared, and the last one raised
    assert np.abs(log.trials[0].readings.command).max() > 0.1


def test_a_dry_run_asks_the_policy_and_moves_nothing(desk: Path, tmp_path: Path) -> None:
    config = DeployConfig(controller="ibvs", hardware=desk, duration_s=1.0, dry_run=True)
    result = deploy(config, tmp_path / "run.mcap")
    log = read_log(result.log)
    positions = log.trials[0].truths.positions if log.trials[0].truths else np.empty(0)
    assert np.ptp(positions, axis=0).max() < 1e-6  # a lag that fades
    assert np.abs(log.trials[0].requested_velocities()).max() > 0.01
    assert not log.trials[0].readings.command.any()
    assert result.summary()["settled_fraction"] is None


def test_a_termination_brakes_though_ctrl_c_is_ignored(desk: Path, tmp_path: Path) -> None:
    def ignore() -> None:
        """As a shell starts what is to run in the background."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    with (
        closing(WorldClient(load_hardware(desk).emulator_address)) as world,
        gaze(desk, tmp_path / "run", "100", "-200", "700", preexec_fn=ignore) as process,
    ):
        until_s = time.monotonic() + 120.0
        while np.abs(world.ask({"state": None})["velocities"]).max() < 0.3:
            assert time.monotonic() < until_s
            assert process.poll() is None
            time.sleep(0.005)
        since_s = time.monotonic()
        process.terminate()
        _, said = process.communicate(timeout=120)
        assert process.returncode == 130, said
        assert "Traceback" not in said
        rested_s = world.rest_start_s(since_s)
    assert rested_s is not None
    assert rested_s - since_s < 0.5


BALL = Path("docs/examples/ball_target.py").resolve()
FAILS = f"""
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


def deploy_command(desk, *words):
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


@pytest.mark.nightly
def test_it_looks_at_a_ball_and_comes_to_rest_when_the_detector_fails(tmp_path):
    (tmp_path / "mine.py").write_text(FAILS)
    with emulated(tmp_path, "--head", "icub", "--scene", "ball:#ff8000:80") as (desk, _process):
        looked = deploy_command(desk, "--target", f"{BALL}:Ball", "--json")
        assert looked.returncode == 0, looked.stderr
        assert json.loads(looked.stdout)["settled_fraction"] == 1.0
        failed = deploy_command(
            desk, "--target", "mine.py:Breaks", "--gazes", "3", "--no-view-check"
        )
        assert failed.returncode == 1
        assert "mine.py:10 in detect: RuntimeError: no more" in failed.stderr.splitlines()[-1]
        with closing(WorldClient(load_hardware(desk).emulator_address)) as world:
            assert np.abs(world.ask({"state": None})["velocities"]).max() < 0.03


@pytest.mark.nightly
def test_it_looks_at_a_named_point_and_then_at_a_clicked_one(tmp_path):
    log, named, clicked = tmp_path / "one.mcap", (210.0, 80.0), np.array([120.0, 150.0])
    words = "--target", "point", "--pixel", "left", *map(str, named), "--log", str(log)
    with emulated(tmp_path, "--head", "icub", "--scene", "room") as (desk, _process):
        looked = deploy_command(desk, *words, "--json")
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


@pytest.mark.nightly
def test_sights_are_those_of_the_true_head_at_its_angles(tmp_path: Path) -> None:
    options = ["--board", str(BOARD), "--errors", str(SCALE), "--seed", str(SEED)]
    with (
        emulated(tmp_path, *options) as (desk, _process),
        closing(WorldClient(load_hardware(desk).emulator_address)) as world,
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
