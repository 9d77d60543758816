"""The twin's calibration as an experiment, with few heads and frames."""

import numpy as np
import pandas as pd
import pytest

from tests.eval.article.checks import incomplete
from tests.eval.mappers import Backwards
from vergence.calibration.head import simulated
from vergence.errors import ConfigurationError
from vergence.eval.article.experiment import load_experiment
from vergence.eval.article.head_eye import (
    HeadEyeConfig,
    depth_errors_percent,
    worst_depth_error_percent,
)
from vergence.reporting.jobs import SerialMapper

pytestmark = pytest.mark.slow
EXPERIMENT = load_experiment("head-eye")
CONFIG = HeadEyeConfig(heads=1, poses=10, frames=2)


@pytest.fixture(scope="module")
def table():
    return EXPERIMENT.run(CONFIG, 1, SerialMapper())


@pytest.mark.nightly
def test_who_runs_the_jobs_and_when_does_not_change_a_bit(table):
    again = EXPERIMENT.run(CONFIG, 1, Backwards())
    pd.testing.assert_frame_equal(table, again, check_exact=True)


@pytest.mark.nightly
def test_the_whole_head_is_better_than_its_model(table):
    before, after = (worst_depth_error_percent(table, one) for one in ("before", "whole head"))
    assert after < 0.5 * before


@pytest.mark.nightly
def test_the_encoders_cost_a_well_known_head_most_of_its_error(table):
    read = depth_errors_percent(table, "whole head", "encoders")
    assert np.median(read - depth_errors_percent(table, "whole head")) > 0.1


def test_the_docs_and_the_captions_are_those_of_the_table(table):
    assert incomplete("head-eye", table, CONFIG) == []
    assert {row.verdict for row in EXPERIMENT.summarise(table, CONFIG)} == {"not reported"}


def test_a_board_that_does_not_fit_into_the_images_is_refused(monkeypatch):
    monkeypatch.setattr(simulated, "_MOST_TRIES", 5)
    with pytest.raises(ConfigurationError, match="a board that both eyes see whole"):
        EXPERIMENT.run(HeadEyeConfig(heads=1, poses=1, boards_m=(0.1,)), 0, SerialMapper())
