"""The whole way: an emulated head on the wire, two streams, and a law that turns it."""

import dataclasses
import json
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.hardware.emulated import REAL_TIME, emulated, world_of
from tests.naming import refused
from vergence.eval.robot.config import DeployConfig, ReplayConfig
from vergence.eval.robot.deploy import GazeState, deploy
from vergence.eval.robot.replay import replay
from vergence.models.toml_table import toml_text
from vergence.recording.log import read_log

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
    words = [sys.executable, "-m", "vergence", "gaze", "--plant", "hardware"]
    words += ["--config", str(desk), "--out", str(out), "--point", *target]
    return subprocess.Popen(words, stderr=subprocess.PIPE, text=True, **options)


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
        refused(said, deploy, dataclasses.replace(config, **changed), tmp_path / "third.mcap")


def test_a_policy_that_raises_rests_and_names_its_line(desk: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(BREAKS)
    config = DeployConfig(controller=f"{mine}:Breaks", hardware=desk)
    result = deploy(config, tmp_path / "run.mcap")
    with world_of(desk) as world:
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
    # as a shell starts what is to run in the background
    ignore = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)
    with (
        world_of(desk) as world,
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


def test_a_bus_of_somebodys_own_turns_eyes_that_see(desk: Path, tmp_path: Path) -> None:
    template = README.parent / "docs" / "examples" / "own_bus.py"
    (tmp_path / template.name).write_text(template.read_text())
    values = tomllib.loads(desk.read_text())
    values["bus"] = {"kind": "own_bus.py:OwnBus", "world": values["emulator"]["address"]}
    for servo in values["servos"]:
        del servo["zero_ticks"]
    robot = tmp_path / "own.toml"
    robot.write_text(toml_text(values))
    wanted = DeployConfig(controller="state-feedback", hardware=robot, gazes=2, duration_s=2.0)
    with pytest.warns(match="expected servos that stop by themselves"):
        found = deploy(wanted, tmp_path / "log.mcap")
    assert found.error is None
    assert found.gazes.summary()["settled_fraction"] == 1.0
