"""A log tells again what happened, and a law asked again asks for the same."""

import numpy as np
import pytest

from tests.recording.logged import STEPS, log_trials
from vergence.errors import VergenceError
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay

pytest.importorskip("mcap")


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    return path, log_trials(path)


def test_the_same_law_asks_for_the_same_to_the_bit(logged):
    found = replay(ReplayConfig(log=logged[0], controller="state-feedback"))
    assert found.again.summary() == {
        "controller": "state-feedback",
        "commands": 2 * STEPS,
        "identical": 2 * STEPS,
        "greatest_difference_rad_s": 0.0,
    }


def test_another_law_asks_for_something_else_on_the_same_readings(logged):
    found = replay(ReplayConfig(log=logged[0], controller="ibvs"))
    assert found.again.summary()["identical"] < STEPS
    kept = found.trajectory()["position_left_pan_rad"].to_numpy().reshape(2, -1)
    for positions, record in zip(kept, logged[1], strict=True):
        assert (positions == record.reading.positions[:, 0, 3]).all()


def test_metrics_are_those_of_what_was_true(logged):
    found = replay(ReplayConfig(log=logged[0]))
    assert found.again is None
    for result, record in zip(found.results, logged[1], strict=True):
        assert (result.truth_m == record.truth.target[-1, 0]).all()
    rows = found.gazes.rows()
    assert [row["gaze"] for row in rows] == [1, 2]
    assert np.isfinite([row["point_error_mm"] for row in rows]).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"gaze": 3}, "gaze: expected 1 to 2"),
        ({"controller": "nobody"}, "controller: expected one of"),
    ],
)
def test_what_cannot_be_is_refused(logged, options, said):
    with pytest.raises(VergenceError, match=said):
        replay(ReplayConfig(log=logged[0], **options))
