"""Recordings are shown as they were: run folders of gazes, and logs of robots."""

import json

import numpy as np
import pytest

from tests.recording.logged import STEPS, log_trials
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.eval.gaze import run_gaze
from vergence.eval.gaze_config import GazeConfig
from vergence.eval.gaze_trajectory import write_trajectory
from vergence.recording.events import MAX_GAP_RATIO, LoopHealth
from vergence.recording.log import read_log
from vergence.reporting.runs import write_config_and_head, write_json
from vergence.viewer.recorded import load_recorded


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The run folder of a gaze, without its picture, and the gaze."""
    folder = tmp_path_factory.mktemp("gaze")
    result = run_gaze(GazeConfig(plant="kinematic", head="icub", target_mm=(0, 0, 800)))
    write_json(folder / "result.json", result.summary())
    write_trajectory(result.trajectory, folder / "trajectory.csv")
    write_config_and_head(folder, result.config, result.head)
    return folder, result


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    pytest.importorskip("mcap")
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    log_trials(path, fault=True, levels=(40, 90))
    return path


def test_a_run_folder_shows_the_gaze_that_was_run(run):
    folder, result = run
    recorded = load_recorded(folder)
    shown = recorded.moment(len(recorded.times_s) - 1)
    assert shown.positions == pytest.approx(result.positions)
    assert shown.target == pytest.approx(result.true_target_m)
    assert shown.fix.point == pytest.approx(result.gaze_fix.point[0])
    last = {name: column[-1] for name, column in result.trajectory.items()}
    errors = [
        np.hypot(last[f"true_error_{eye}_u_px"], last[f"true_error_{eye}_v_px"])
        for eye in ("left", "right")
    ]
    assert shown.errors_px == pytest.approx(errors)
    assert recorded.errors_px()[-1] == pytest.approx(errors)


@pytest.mark.slow
def test_a_gaze_without_faults_raises_no_alarm(tmp_path):
    result = run_gaze(GazeConfig(plant="mujoco", target_mm=(120, -80, 350)))
    write_json(tmp_path / "result.json", result.summary())
    write_trajectory(result.trajectory, tmp_path / "trajectory.csv")
    write_config_and_head(tmp_path, result.config, result.head)
    recorded, ratios = load_recorded(tmp_path), []
    health = LoopHealth(recorded.head)
    for index in range(len(recorded.times_s)):
        health.add(recorded.reading(index))
        ratios.append(health.gap_ratio)
    assert 0.0 < np.nanmax(ratios) < MAX_GAP_RATIO


def test_images_that_nobody_took_are_called_drawn(run):
    assert load_recorded(run[0]).moment(3).images.drawn


def test_a_log_shows_each_reading_at_its_time(log):
    recorded, trials = load_recorded(log), read_log(log).trials
    assert len(recorded.times_s) == 2 * (STEPS + 1)
    assert recorded.begins == (0, STEPS + 1)
    assert (np.diff(recorded.times_s) > 0.0).all()
    shown = recorded.moment(STEPS + 1 + 40)
    seen = trials[1].readings
    assert shown.pixels == pytest.approx(seen.pixels[40, 0], nan_ok=True)
    assert shown.detection_age_s == pytest.approx((seen.time_s - seen.exposure_s)[40, 0])
    assert shown.target == pytest.approx(trials[1].truths.target[40, 0])
    left, right, drawn = shown.images
    assert ([left.mean(), right.mean()], drawn) == (pytest.approx([40, 90], abs=2.0), False)
    assert recorded.gaze_at(STEPS) == 1
    assert recorded.gaze_at(STEPS + 1) == 2
    assert recorded.index_at(recorded.times_s[70] + 1e-6) == 70
    assert recorded.notes == ("stopped: bus: gone",)


def test_something_else_is_refused_in_words(run, log, tmp_path):
    with pytest.raises(UnreadableFileError, match=r"trajectory\.csv"):
        load_recorded(tmp_path)
    with pytest.raises(UnreadableFileError):
        load_recorded(tmp_path / "missing.mcap")
    for name in ("trajectory.csv", "head.toml", "config.toml"):
        (tmp_path / name).write_bytes((run[0] / name).read_bytes())
    (tmp_path / "result.json").write_text(json.dumps({"truth_mm": "nowhere"}))
    with pytest.raises(UnreadableFileError, match="run folder of a gaze"):
        load_recorded(tmp_path)
    empty = tmp_path / "empty.mcap"
    log_trials(empty, trials=0)
    with pytest.raises(ConfigurationError, match="with a gaze"):
        load_recorded(empty)
