"""The moving target on the simulated rig, on a part of a turn."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from tests.eval.article.checks import incomplete, unjudged
from tests.eval.mappers import Backwards
from vergence.eval.article.experiment import load_experiment, rows_where
from vergence.eval.article.simulated_moving import (
    NONE,
    SimulatedMovingConfig,
    _follow,
    errors_by_case,
)
from vergence.reporting.jobs import SerialMapper

pytestmark = pytest.mark.slow
EXPERIMENT = load_experiment("simulated-moving")
CONFIG = SimulatedMovingConfig(samples=8, settle_s=0.3)
"""With images, the eyes have not settled: these take nearly all the time."""


@pytest.fixture(scope="module")
def table():
    short = EXPERIMENT.run(CONFIG, 1, SerialMapper())
    unimaged = (short["case"] == "exact") & (short["noise"] == NONE)
    settled = _follow(dataclasses.replace(CONFIG, settle_s=1.4), 1, "exact", NONE, 0.0)
    return pd.concat([short[~unimaged], settled], ignore_index=True)


@pytest.mark.nightly
def test_who_runs_the_jobs_and_when_does_not_change_a_bit():
    few = SimulatedMovingConfig(samples=2, settle_s=0.1)
    tables = [EXPERIMENT.run(few, 1, mapper) for mapper in (SerialMapper(), Backwards())]
    pd.testing.assert_frame_equal(*tables, check_exact=True)


def test_the_article_s_samples_make_one_turn():
    config = SimulatedMovingConfig()
    assert config.samples * config.every / 120.0 == pytest.approx(config.period_s, rel=0.01)


def test_the_axes_trail_by_speed_over_gain_along_the_path(table):
    rows = rows_where(table, case="exact", method="gaze", noise=NONE)
    error = rows[["error_x_mm", "error_y_mm"]].to_numpy()
    speed = 100.0 * 2.0 * np.pi / CONFIG.period_s
    assert np.allclose(np.linalg.norm(error, axis=1), speed / CONFIG.gain, rtol=0.03)
    # backwards: against the velocity, which is square to the radius
    x, y = rows["target_x_mm"].to_numpy(), rows["target_y_mm"].to_numpy() + 100.0
    along = (error * np.stack([y, -x], axis=1) / 100.0).sum(axis=1)
    assert (along < 0.0).all()


def test_without_noise_pixels_of_one_exposure_do_not_trail(table):
    rows = rows_where(table, case="exact", method="itpc", noise=NONE)
    assert rows[["error_x_mm", "error_y_mm", "error_z_mm"]].abs().to_numpy().max() < 1e-6


def test_an_undated_fix_is_late_by_the_latency(table):
    rows = rows_where(table, case="exact", method="itpc, undated", noise=NONE)
    late = np.linalg.norm(rows[["error_x_mm", "error_y_mm"]], axis=1)
    assert np.allclose(late, 10.0 * 8.0 / 120.0, rtol=0.01)


def test_lag_moves_gaze_far_more_than_itpc_with_images(table):
    errors = errors_by_case(table)
    gaze, itpc = (errors["exact", method, "images"] for method in ("gaze", "itpc"))
    assert gaze.plane_mm > 10.0 * itpc.plane_mm
    assert gaze.standard_deviation["z"] < 0.5 * itpc.standard_deviation["z"]


def test_summary_figures_and_numbers_are_those_of_the_article_and_the_docs(table):
    assert incomplete("simulated-moving", table, CONFIG) == []
    assert unjudged(EXPERIMENT.summarise(table, CONFIG), "simulated moving") == []


def test_the_verdict_on_the_trail_follows_the_numbers(table):
    def verdict(of):
        (row,) = [r for r in EXPERIMENT.summarise(of, CONFIG) if "way behind" in r.quantity]
        return row.verdict

    assert verdict(table) == "target met"
    assert verdict(table.assign(error_x_mm=2.0 * table["error_x_mm"])) == "target missed"


def test_the_numbers_of_the_text_are_those_of_the_table(table):
    numbers = EXPERIMENT.numbers(table, CONFIG)
    z = rows_where(table, case="principal", method="gaze", noise="images")["error_z_mm"]
    assert numbers["principal_gaze_z_mm"] == pytest.approx(z.abs().mean())
    assert numbers["speed_over_gain_mm"] == pytest.approx(10.0 / 4.0)
    assert numbers["article_gaze_scatter_mm"] == 0.30


def test_the_more_noise_a_loop_lets_through_the_more_gaze_scatters(table):
    numbers = EXPERIMENT.numbers(table, CONFIG)
    expected = [numbers[f"expected_exact_{rate}_hz_mm"] for rate in (120, 60, 30)]
    assert expected == sorted(expected)
    assert expected[0] < numbers["article_itpc_scatter_mm"]
