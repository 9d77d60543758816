"""A log tells again what happened, and a law asked again asks for the same."""

import hashlib

import numpy as np
import pytest

from tests.recording.logged import STEPS, log_trials
from vergence.errors import VergenceError
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay
from vergence.eval.robot.replay_folder import write_replay_folder
from vergence.recording.log import read_log

pytest.importorskip("mcap")


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    return path, log_trials(path)


def test_the_same_law_asks_for_the_same_to_the_bit(logged):
    found = replay(ReplayConfig(log=logged[0], controller="state-feedback"))
    assert found.rerun.summary() == {
        "controller": "state-feedback", "commands": 2 * STEPS, "identical": 2 * STEPS,
        "greatest_difference_rad_s": 0.0,
    }  # fmt: skip


def test_another_law_asks_for_something_else_on_the_same_readings(logged):
    found = replay(ReplayConfig(log=logged[0], controller="ibvs"))
    assert found.rerun.summary()["identical"] < STEPS
    kept = found.trajectory()["position_left_pan_rad"].to_numpy().reshape(2, -1)
    for positions, record in zip(kept, logged[1], strict=True):
        assert (positions == record.reading.positions[:, 0, 3]).all()


def test_metrics_are_those_of_what_was_true(logged):
    found = replay(ReplayConfig(log=logged[0]))
    assert found.rerun is None
    for result, record in zip(found.results, logged[1], strict=True):
        assert (result.true_target_m == record.truth.target[-1, 0]).all()
    rows = found.gazes.rows()
    assert [row["gaze"] for row in rows] == [1, 2]
    assert np.isfinite([row["point_error_mm"] for row in rows]).all()


def test_a_dry_run_has_nothing_to_judge(tmp_path):
    log_trials(tmp_path / "dry.mcap", dry_run="True")
    summary = replay(ReplayConfig(log=tmp_path / "dry.mcap")).summary()
    assert summary["settled_fraction"] is None
    assert summary["rows"][0]["settle_2px_s"] is None


@pytest.mark.parametrize("fault", [False, True])
def test_a_gaze_that_ended_early_counts_if_a_fault_ended_it(tmp_path, fault):
    path = tmp_path / "run.mcap"
    log_trials(path, steps=8, fault=fault, trials=1, planned="60")
    summary = replay(ReplayConfig(log=path)).summary()
    assert summary["gazes"] == int(fault)
    assert summary["settled_fraction"] == (0.0 if fault else None)


def test_a_log_without_gazes_tells_its_faults_and_is_written_whole(tmp_path):
    path, out = tmp_path / "run.mcap", tmp_path / "out"
    log_trials(path, trials=0, fault=True)
    path.write_bytes(path.read_bytes()[:-1])
    found = replay(ReplayConfig(log=path, controller="ibvs"))
    assert found.summary()["faults"] == ["bus: gone"]
    out.mkdir()
    write_replay_folder(out, found)
    assert not read_log(out / "recovered.mcap").truncation_reason


OWN = """
import numpy as np

class Law:
    def __init__(self, head, layout, path="mine"):
        assert path == "mine"

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((1, 4), np.float32), state
"""


def test_own_code_never_runs_with_options_that_a_log_names(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    word = f"{tmp_path / 'mine.py'}:Law"
    sha256 = hashlib.sha256(OWN.encode()).hexdigest()
    facts = {"controller": word, "options": '{"path": "evil.zip"}', "controller_sha256": sha256}
    log_trials(tmp_path / "run.mcap", facts=facts)
    found = replay(ReplayConfig(log=tmp_path / "run.mcap", controller=word))
    assert "evil.zip" in found.notes[0]


def test_what_cannot_be_is_refused(logged):
    for options, said in [
        ({"gaze": 3}, "gaze: expected 1 to 2"),
        ({"controller": "nobody"}, "controller: expected one of"),
    ]:
        with pytest.raises(VergenceError, match=said):
            replay(ReplayConfig(log=logged[0], **options))
