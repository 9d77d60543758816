"""A moving target before the physical twin, run small."""

import numpy as np
import pandas as pd
import pytest

from tests.eval.article.checks import section_text, unjudged
from tests.eval.article.twin.small import scaled, small, verdict_of
from vergence.eval.article.experiment import load_experiment
from vergence.eval.jobs import ProcessMapper, SerialMapper

EXPERIMENT = load_experiment("physical-moving")
CONFIG = small("physical-moving", speed_m_s=0.5, settle_s=0.5, table_every=4)


@pytest.fixture(scope="module")
def table():
    return EXPERIMENT.run(CONFIG, 0, SerialMapper())


def test_two_processes_give_the_same_table_bit_for_bit(table):
    again = EXPERIMENT.run(CONFIG, 0, ProcessMapper(2))
    pd.testing.assert_frame_equal(table, again, check_exact=True)


def test_another_seed_gives_other_heads(table):
    assert not EXPERIMENT.run(CONFIG, 1, SerialMapper()).equals(table)


def test_the_summary_judges_every_result_of_the_article(table):
    assert unjudged(EXPERIMENT.summarise(table, CONFIG), "physical moving") == []


def test_no_panel_of_a_figure_is_empty(table):
    figures = EXPERIMENT.draw(table, CONFIG)
    assert figures
    for figure in figures.values():
        for panel in figure.axes:
            assert panel.has_data()
            assert panel.get_xlabel()


def test_gaze_trails_a_moving_target_by_its_velocity_over_the_gain():
    config = small("physical-moving", heads=20, settle_s=2.0)
    numbers = EXPERIMENT.numbers(EXPERIMENT.run(config, 0, SerialMapper()), config)
    velocity = np.array(config.end_mm) - np.array(config.origin_mm)
    velocity *= 1000.0 * config.speed_m_s / np.linalg.norm(velocity)
    assert numbers["lag_x_mm"] == pytest.approx(-velocity[0] / 4.0)
    # on a still target both are the same; the encoders round away half a step at most
    assert numbers["trail_x_mm"] == pytest.approx(-velocity[0] / 4.0, rel=0.15)


def test_half_the_common_tilt_makes_smaller_errors_in_y(table):
    numbers = EXPERIMENT.numbers(table, CONFIG)
    own = table[(table["case"] == "head") & (table["group"] == "population")]
    high = own[own["method"] == "gaze"]["mean_abs_y_mm"].quantile(0.9)
    assert numbers["half_gaze_high_mm"] < high
    assert numbers["common_tilt_deg"] == pytest.approx(0.4 * 1.4)


def test_verdicts_follow_the_numbers(table):
    larger = scaled(table, "mean_abs_z_mm", 1e3, table["case"] == "head")
    rows = [r for r in EXPERIMENT.summarise(larger, CONFIG) if r.axis == "z"]
    assert verdict_of(rows, "mean absolute error", "gaze") == "larger"
    assert verdict_of(rows, "mean absolute error", "itpc") == "larger"
    assert EXPERIMENT.numbers(larger, CONFIG) != EXPERIMENT.numbers(table, CONFIG)


def test_the_text_has_the_numbers_of_the_table(table):
    imaged = table[(table["case"] == "head") & (table["group"] == "imaged")]
    seen = imaged.set_index("method")["mean_abs_z_mm"]
    found = section_text(EXPERIMENT, table, CONFIG).found
    assert f"and {seen['gaze']:.1f} mm by gaze" in found
    assert f"and {seen['itpc']:.1f} mm by ITPC" in found
