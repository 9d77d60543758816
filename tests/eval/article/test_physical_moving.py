"""A moving target before the physical twin, run small."""

import numpy as np
import pytest

from tests.eval.article.checks import section_text
from tests.eval.article.small_twin import scaled, small, table_of, verdict_of
from vergence.eval.article.experiment import load_experiment
from vergence.reporting.jobs import SerialMapper

EXPERIMENT = load_experiment("physical-moving")
CONFIG = small(EXPERIMENT.name)


@pytest.fixture(scope="module")
def table():
    return table_of(EXPERIMENT.name)


@pytest.mark.nightly
def test_gaze_trails_a_moving_target_by_its_velocity_over_the_gain():
    config = small(EXPERIMENT.name, heads=8, settle_s=2.0, speed_m_s=0.06)
    numbers = EXPERIMENT.numbers(EXPERIMENT.run(config, 0, SerialMapper()), config)
    velocity = np.array(config.end_mm) - np.array(config.origin_mm)
    velocity *= 1000.0 * config.speed_m_s / np.linalg.norm(velocity)
    assert numbers["lag_x_mm"] == pytest.approx(-velocity[0] / 4.0)
    # on a still target both are the same; the encoders round away half a step at most
    assert numbers["trail_x_mm"] == pytest.approx(-velocity[0] / 4.0, rel=0.15)


@pytest.mark.slow
def test_half_the_common_tilt_makes_smaller_errors_in_y(table):
    numbers = EXPERIMENT.numbers(table, CONFIG)
    own = table[(table["case"] == "head") & (table["group"] == "population")]
    high = own[own["method"] == "gaze"]["mean_abs_y_mm"].quantile(0.9)
    assert numbers["half_gaze_high_mm"] < high
    assert numbers["common_tilt_deg"] == pytest.approx(0.4 * 1.4)


@pytest.mark.slow
def test_verdicts_follow_the_numbers(table):
    larger = scaled(table, "mean_abs_z_mm", 1e3, table["case"] == "head")
    rows = [r for r in EXPERIMENT.summarise(larger, CONFIG) if r.axis == "z"]
    assert verdict_of(rows, "mean absolute error", "gaze") == "differs"
    assert verdict_of(rows, "mean absolute error", "itpc") == "differs"
    assert EXPERIMENT.numbers(larger, CONFIG) != EXPERIMENT.numbers(table, CONFIG)


@pytest.mark.slow
def test_the_text_has_the_numbers_of_the_table(table):
    imaged = table[(table["case"] == "head") & (table["group"] == "imaged")]
    seen = imaged.set_index("method")["mean_abs_z_mm"]
    found = section_text(EXPERIMENT, table, CONFIG).found
    assert f"and {seen['gaze']:.1f} mm by gaze" in found
    assert f"and {seen['itpc']:.1f} mm by ITPC" in found
