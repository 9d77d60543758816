"""An evaluation on a robot in simulated time, which a pulled cable ends, goes on where it was."""

import numpy as np
import pytest

from tests.hardware.test_config import document
from tests.hardware.virtual import PORT, VirtualRobot, WatchedWorld
from vergence.envs import task as gaze_task
from vergence.errors import ConfigurationError, HardwareError
from vergence.eval.comparison.config import EvaluateConfig
from vergence.eval.robot.evaluate import evaluate_on_robot, read_begun_config
from vergence.hardware.config import load_hardware
from vergence.models.toml_table import toml_text


@pytest.mark.slow
def test_an_evaluation_that_a_pulled_cable_ends_goes_on_where_it_was(tmp_path, monkeypatch):
    make_simulated = gaze_task.make_plant
    desk, run, ran, robots = tmp_path / "desk.toml", tmp_path / "run", [], []
    values = document()
    values["bus"] = {"port": PORT}
    desk.write_text(toml_text(values))

    def make_plant(name, head, num, log=None, **options):
        if name != "hardware":
            return make_simulated(name, head, num, **options)
        world = WatchedWorld(head, np.array([0.05, -0.1, 1.0]), latency_s=head.timing.latency_s)
        options = {"log": log, "view_check": False}
        robots.append(VirtualRobot(monkeypatch, world, load_hardware(desk), plant_options=options))
        return robots[-1].plant

    def note(done, _total):
        ran.append(done)
        if ran == [0, 1]:
            robots[-1].fault(what="unplug")

    monkeypatch.setattr(gaze_task, "make_plant", make_plant)
    config = EvaluateConfig(
        controllers=("ibvs-tuned",), plants=("hardware",), hardware=desk, stage="still",
        scenarios=("workspace",), episodes=2,
    )  # fmt: skip
    with pytest.raises(HardwareError, match="the serial line is gone"):
        evaluate_on_robot(config, run, progress=note)
    found = evaluate_on_robot(read_begun_config(run), run, progress=note, resume=True)
    assert ran == [0, 1, 1, 2]
    assert len(robots) == 2
    trials = found.trials()
    assert len(trials) == 2
    assert (trials["settle_2px_s"] >= trials["bound_2px_s"]).all()
    assert "hardware is a robot" in found.notes[-1]
    desk.write_text(desk.read_text().replace("[cameras.left]", "[cameras.left]\nlatency_s = 0.01"))
    with pytest.raises(ConfigurationError, match=r"resume: expected cameras of .*0\.01"):
        evaluate_on_robot(read_begun_config(run), run, resume=True)
