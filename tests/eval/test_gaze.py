"""One gaze: its table, its picture and its summary, also where nobody knows the truth."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

from tests.envs.robot import WORLD, Robot
from tests.heads import text_of
from vergence.commands.gaze import _print_gaze
from vergence.controllers import make_controller
from vergence.envs.plant import PLANTS
from vergence.envs.task import GazeTask, rollout
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.eval.gaze import GazeConfig, gaze_result, run_gaze
from vergence.eval.gaze_figure import compose_gaze, draw_gaze
from vergence.eval.gaze_trajectory import write_trajectory
from vergence.models.head_file import load_head
from vergence.recording import Recorder

MM = 1000.0


@pytest.fixture
def on_robot(monkeypatch):
    monkeypatch.setitem(PLANTS, "robot", "tests.envs.robot:Robot")
    target = tuple(MM * x for x in WORLD)
    return run_gaze(GazeConfig(plant="robot", target_mm=target, duration_s=1.5))


def test_without_truth_what_needs_it_is_null(on_robot):
    summary = on_robot.summary()
    assert not on_robot.has_truth
    assert summary["settle_1px_s"] is None
    assert summary["truth_mm"] == [None] * 3
    assert summary["gaze"]["error_norm_mm"] is None
    true = [name for name in on_robot.trajectory if name.startswith("true_")]
    assert len(true) == 8
    assert all(np.isnan(on_robot.trajectory[name]).all() for name in true)


def test_without_truth_the_target_is_found_all_the_same(on_robot):
    # the robot's detections and joints are exact: what is left is how far the eyes have come
    assert on_robot.gaze_fix.point[0] == pytest.approx(WORLD, abs=2e-3)
    assert on_robot.view_fix.point[0] == pytest.approx(WORLD, abs=1e-6)


def test_a_robot_that_knows_the_truth_is_judged_by_it():
    target = tuple(MM * x for x in WORLD)
    emulated = "tests.envs.robot:Emulated"
    result = run_gaze(GazeConfig(plant=emulated, target_mm=target, duration_s=1.5))
    assert result.true_target_m == pytest.approx(WORLD)
    assert np.isfinite(result.residual).all()
    assert 0.0 < result.settle_1px_s < 1.5


class RobotWithCameras(Robot):
    def frames(self, place=0):
        left, right = (np.full(size[::-1], 33, np.uint8) for size in self.head.cameras.size)
        return left, right


@pytest.mark.slow
def test_without_truth_no_picture_and_no_table_has_a_target(on_robot, capsys):
    texts = compose_gaze(on_robot).findobj(Text)
    assert not any("target" in text.get_text() for text in texts)
    _print_gaze(on_robot)
    assert "truth" not in capsys.readouterr().out


@pytest.mark.slow
def test_the_errors_say_whether_they_are_true_or_measured(on_robot):
    true = gaze_of("simulated", duration_s=0.1)
    for result, kind in ((true, "true"), (on_robot, "measured")):
        assert compose_gaze(result).axes[2].get_ylabel() == f"pixel error ({kind}), px"


@pytest.mark.slow
def test_without_images_none_is_shown(on_robot):
    figure = compose_gaze(on_robot)
    assert on_robot.images is None
    assert not any(axes.images for axes in figure.axes)
    assert not any("last image" in axes.get_title() for axes in figure.axes)


def test_a_robot_s_own_images_are_shown_as_they_are(monkeypatch):
    monkeypatch.setitem(PLANTS, "robot", f"{__name__}:RobotWithCameras")
    result = run_gaze(GazeConfig(plant="robot", duration_s=0.5))
    left, right = compose_gaze(result).axes[:2]
    for axes in (left, right):
        assert (axes.images[0].get_array() == 33).all()
        assert axes.get_title().endswith("last image")


@pytest.mark.slow
def test_an_image_that_no_camera_took_says_that_it_is_drawn():
    for plant, drawn in {"kinematic": True, "rendered": False}.items():
        result = run_gaze(GazeConfig(plant=plant, duration_s=0.2))
        for axes in compose_gaze(result).axes[:2]:
            assert ("drawn" in axes.get_title()) == drawn
            assert axes.images


def test_in_a_simulation_the_errors_are_true_and_the_command_is_what_was_applied():
    result = run_gaze(GazeConfig(plant="kinematic", duration_s=1.5))
    assert result.has_truth
    assert result.summary()["gaze"]["error_norm_mm"] < 5.0
    assert result.settle_1px_s < 1.0
    table = result.trajectory
    assert len(table["time_s"]) == 181
    limit = load_head("simulated").limits.velocity.max()
    assert 0.0 < np.abs(table["command_left_pan_rad_s"]).max() <= limit


@pytest.fixture
def file_of(tmp_path):
    def write(name: str, text: str | None = None) -> str:
        path = tmp_path / f"{name}.toml"
        path.write_text(text_of(name) if text is None else text)
        return str(path)

    return write


def gaze_of(head: str, **options):
    return run_gaze(
        GazeConfig(head=head, plant="kinematic", **{"target_mm": (50.0, 0.0, 800.0), **options})
    )


def test_a_gaze_has_the_joints_and_actuators_of_its_head(file_of):
    table = gaze_of(file_of("tied"), duration_s=0.1).trajectory
    positions = [name for name in table if name.startswith("position_")]
    assert positions == [
        "position_neck_pitch_rad", "position_neck_roll_rad", "position_neck_yaw_rad",
        "position_eyes_tilt_rad", "position_left_pan_rad", "position_right_pan_rad",
    ]  # fmt: skip
    commands = [name for name in table if name.startswith("command_")]
    assert commands == ["command_tilt_rad_s", "command_version_rad_s", "command_vergence_rad_s"]
    lacking = gaze_of(file_of("vergeonly"), duration_s=0.1).trajectory
    positions = [name for name in lacking if name.startswith("position_")]
    assert positions == ["position_pan_rad", "position_left_pan_rad", "position_right_pan_rad"]


@pytest.mark.slow
def test_a_gaze_settles_about_the_least_error_and_reports_it(file_of, tmp_path):
    result = gaze_of(file_of("common"), duration_s=1.5)
    assert result.residual_px > 5.0
    assert result.summary()["residual_px"] == result.residual_px
    assert result.settle_05px_s < 1.2
    last = result.trajectory["true_error_left_u_px"][-1]
    assert last == pytest.approx(result.residual[0, 0], abs=0.5)
    draw_gaze(result, tmp_path / "gaze.png")
    assert (tmp_path / "gaze.png").stat().st_size > 10_000


def test_a_target_out_of_reach_is_told_by_its_actuator(file_of):
    narrow = text_of("tied").replace("upper_rad = 1.2", "upper_rad = 0.05")
    said = r"which vergence would be at 4\.\d degrees, outside"
    with pytest.raises(ConfigurationError, match=said):
        gaze_of(file_of("tied", narrow))


def test_a_fixed_pair_has_no_gaze(file_of):
    said = "^head: expected one whose eyes move, got 'pair'"
    with pytest.raises(ConfigurationError, match=said):
        gaze_of(file_of("pair"))


def test_unknown_names_are_refused_before_a_plant_is_opened_or_a_head_is_loaded():
    with pytest.raises(UnknownNameError, match="controller"):
        run_gaze(GazeConfig(controller="magic", plant="no such plant"))
    with pytest.raises(UnknownNameError, match="plant"):
        run_gaze(GazeConfig(plant="no such plant", head="no such head"))


def test_a_target_in_metres_is_asked_about():
    for target, asked in {(0.0, -0.1, 1.0): True, (0.0, -100.0, -1000.0): False}.items():
        with pytest.raises(ConfigurationError, match="point: expected") as caught:
            run_gaze(GazeConfig(target_mm=target, plant="kinematic"))
        assert ("is it in metres?" in str(caught.value)) == asked


class LastImageAlone(Robot):
    """A robot whose right eye's images come to an end a little before the left one's."""

    def step(self, command):
        reading = super().step(command)
        if reading.time_s[0] > 1.45:
            reading.visible[:, 1], reading.pixels[:, 1] = False, np.nan
        return reading


def test_the_last_image_of_both_eyes_counts_where_one_eyes_comes_alone(monkeypatch):
    monkeypatch.setitem(PLANTS, "robot", f"{__name__}:LastImageAlone")
    result = run_gaze(GazeConfig(plant="robot", duration_s=1.5))
    assert not result.trajectory["visible_right"][-1]
    assert result.view_fix.valid[0]
    # one that is too old for the present is none
    result = run_gaze(GazeConfig(plant="robot", duration_s=2.0))
    assert not result.view_fix.valid[0]


def test_a_gaze_that_ended_early_is_judged_by_what_was_recorded(on_robot):
    task = GazeTask(1, plant="robot", target="static")
    record = Recorder(task, 180)
    law = make_controller(on_robot.config.controller, head=task.head, gain=on_robot.config.gain)
    rollout(task, law, 60, record)
    result = gaze_result(on_robot.config, task, record)
    for name, column in on_robot.trajectory.items():
        assert np.array_equal(result.trajectory[name], column[:61], equal_nan=True)
    point_mm = [on_robot.trajectory[f"gaze_{axis}_mm"][60] for axis in "xyz"]
    assert result.gaze_fix.point[0] * MM == pytest.approx(point_mm)
    assert result.images is None


def test_the_table_of_a_gaze_is_written_as_pandas_writes_it(on_robot, tmp_path):
    write_trajectory(on_robot.trajectory, tmp_path / "trajectory.csv")
    text = (tmp_path / "trajectory.csv").read_text()
    assert text == pd.DataFrame(on_robot.trajectory).to_csv(index=False)
