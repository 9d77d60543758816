"""The uncertainties, with few images."""

import dataclasses

import pandas as pd
import pytest

from tests.eval.article.checks import incomplete, section_text
from tests.eval.article.small_twin import scaled
from tests.eval.mappers import Backwards
from vergence.eval.article.experiment import load_experiment
from vergence.eval.article.uncertainty import (
    UncertaintyConfig,
    averaging_errors,
    cramer_rao_bounds_px,
    noise_gains,
    propagation_ratios,
    sigma_ratio_tolerance,
)
from vergence.reporting.jobs import SerialMapper

pytestmark = pytest.mark.slow
EXPERIMENT = load_experiment("uncertainty")
CONFIG = UncertaintyConfig(
    draws=20, point_step=20, gains=(4.0,), heads=40, loop_samples=200, image_gains=(4.0,),
    image_samples=20, reach_draws=4, averaging_depths_m=(2.5,), frames=16, replicates=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def table():
    return EXPERIMENT.run(CONFIG, 1, SerialMapper())


@pytest.mark.nightly
def test_who_runs_the_jobs_and_when_does_not_change_a_bit():
    few = dataclasses.replace(
        CONFIG, draws=4, point_step=21, gains=(4.0,), heads=2, loop_samples=5, image_samples=4,
        reach_draws=2, averaging_depths_m=(1.5,), frames=4, replicates=1,
    )  # fmt: skip
    tables = [EXPERIMENT.run(few, 1, mapper) for mapper in (SerialMapper(), Backwards())]
    pd.testing.assert_frame_equal(*tables, check_exact=True)


@pytest.mark.nightly
def test_propagation_agrees_with_the_real_detector():
    table = EXPERIMENT.run(dataclasses.replace(CONFIG, draws=40), 1, SerialMapper())
    exact = propagation_ratios(table).xs("itpc", level="method")
    assert ((exact - 1.0).abs() < sigma_ratio_tolerance(CONFIG)).to_numpy().all()


@pytest.mark.nightly
def test_white_noise_scatters_as_the_bandwidth_says(table):
    gains = noise_gains(table, CONFIG)
    white = gains[gains["source"] == "white noise"]
    assert ((white["measured"] / white["predicted"] - 1.0).abs() < white["chance"]).all()


def test_no_average_beats_the_bound(table):
    found = averaging_errors(table)
    best_px = min(found.still_px, found.dithered_px)
    assert found.board_px < found.window_px < best_px
    assert (cramer_rao_bounds_px(table)["board"] < cramer_rao_bounds_px(table)["window"]).all()


def test_the_summary_says_what_agrees(table):
    rows = EXPERIMENT.summarise(table, CONFIG)
    assert {row.experiment for row in rows} == {"uncertainty"}
    assert {"agrees", "not reported"} <= {row.verdict for row in rows}
    assert all(row.article_low is None for row in rows)


def test_figures_and_numbers_are_those_of_the_docs_and_no_panel_is_empty(table):
    assert incomplete("uncertainty", table, CONFIG) == []


def test_a_wrong_propagation_differs(table):
    wrong = table.copy()
    wrong.loc[wrong["quantity"] == "propagated", "value"] *= 2.0

    def ahead(of):
        rows = EXPERIMENT.summarise(of, CONFIG)
        return {row.verdict for row in rows if "Monte Carlo, ahead" in row.quantity}

    assert ahead(table) == {"agrees"}
    assert ahead(wrong) == {"differs"}
    assert EXPERIMENT.numbers(wrong, CONFIG)["ahead_percent"] > 60.0


def test_the_verdicts_on_averaging_follow_the_errors(table):
    def verdicts(of):
        rows = EXPERIMENT.summarise(of, CONFIG)
        return [row.verdict for row in rows if row.quantity.startswith("error of the mean of 16")]

    still = (
        (table["quantity"] == "error")
        & (table["fixation"] == "still")
        & (table["frames"] == CONFIG.frames)
    )
    assert verdicts(scaled(table, "value", 1e3, still))[-2:] == ["differs", "better"]
    assert verdicts(scaled(table, "value", 1e-3, still))[-2:] == ["agrees", "alike"]


def test_the_text_has_the_numbers_of_the_table(table):
    found = averaging_errors(table)
    text = section_text(EXPERIMENT, table, CONFIG)
    assert f"One frame is off by {found.single_px:.4f} px" in text.found
    assert "the mean of 16 frames" in text.found


def test_a_bound_is_the_root_of_the_mean_square_over_images():
    rows = [
        {"part": "bound", "depth_mm": depth, "quantity": quantity, "value": scale * value}
        for depth, scale in ((500.0, 1.0), (1000.0, 2.0))
        for quantity, values in (("board", (3.0, 4.0)), ("window", (6.0, 8.0)))
        for value in values
    ]
    found = cramer_rao_bounds_px(pd.DataFrame(rows))
    assert found["board"].tolist() == pytest.approx([12.5**0.5, 2.0 * 12.5**0.5])
    assert (found["window"] == 2.0 * found["board"]).all()
