"""The physical twin: its heads, their errors and their scale, and ranks among them."""

import dataclasses

import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.eval.article.closed_loop import ClosedLoop, hold_gaze
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin import (
    DetectorNoise,
    TwinConfig,
    axis_columns,
    count_inside,
    draw_heads,
    find_error_scale,
    joint_angles_imaging_at,
    largest_depth_error_percent,
    mean_encoder_readings,
    mean_fix_errors_m,
    measure_head_noise,
    rank_in_population,
    settled_fix_errors_m,
    with_common_tilt,
)
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head_file import load_head
from vergence.models.perturbation import ModelErrors

POPULATION = np.arange(101.0)


def test_a_figure_between_the_10th_and_90th_percentile_is_inside():
    placed = rank_in_population(50.5, POPULATION)
    assert placed.inside
    assert (placed.low, placed.median, placed.high) == (10.0, 50.0, 90.0)
    assert placed.percentile == pytest.approx(100.0 * 51 / 101)
    assert placed.verdict == rank_in_population(10.0, POPULATION).verdict == "inside"
    for value in (5.0, 95.0):
        assert rank_in_population(value, POPULATION).verdict == "outside"


def test_figures_inside_are_counted():
    ranks = [rank_in_population(value, POPULATION) for value in (5.0, 10.0, 50.0, 95.0)]
    assert count_inside(ranks) == 2


def test_columns_are_ordered_by_axis_and_then_by_name():
    columns = axis_columns(error=np.eye(3), scatter=np.ones((3, 3)))
    assert list(columns)[:3] == ["error_x_mm", "scatter_x_mm", "error_y_mm"]
    assert np.array_equal(columns["error_y_mm"], [0.0, 1.0, 0.0])


def test_a_common_tilt_leaves_the_cameras_as_they_were_to_each_other(nominal):
    q = nominal.fixate((-0.4, -0.2, 1.0))
    tilted = with_common_tilt(nominal[None], np.array([0.03]))[0]
    before, after = nominal.camera_poses(q), tilted.camera_poses(q)
    assert np.allclose(np.linalg.inv(before[0]) @ before[1], np.linalg.inv(after[0]) @ after[1])
    # both eyes look lower: y is down
    assert (after[:, 1, 2] > before[:, 1, 2] + 0.02).all()


def test_one_source_alone_deviates_as_it_does_among_all(nominal):
    both = draw_heads(nominal, TWIN_SPREADS, 12, 3)
    alone = draw_heads(nominal, ModelErrors(principal_px=TWIN_SPREADS.principal_px), 12, 3)
    assert np.array_equal(both.cameras.principal, alone.cameras.principal)
    assert np.array_equal(alone.head_eye[0], nominal.head_eye)
    assert np.array_equal(np.broadcast_to(nominal.links.offset, (12, 9)), alone.links.offset)


def test_the_rest_of_a_head_is_the_same_without_a_common_tilt(nominal):
    tilted = draw_heads(nominal, TWIN_SPREADS, 12, 3)
    upright = draw_heads(nominal, dataclasses.replace(TWIN_SPREADS, common_tilt_rad=0.0), 12, 3)
    assert np.array_equal(tilted.head_eye, upright.head_eye)
    assert np.array_equal(tilted.links.d, upright.links.d)
    apart = tilted.links.offset - upright.links.offset
    moved = np.abs(apart).max(axis=0) > 0.0
    assert moved.sum() == 2
    assert np.allclose(apart.sum(axis=1), 0.0)


def test_deviations_are_proportional_to_the_errors(nominal):
    heads = [draw_heads(nominal, TWIN_SPREADS.scaled(f), 12, 3) for f in (0.5, 1.0)]
    once, twice = (one.links.offset - nominal.links.offset for one in heads)
    assert np.allclose(2.0 * once, twice)


def test_a_population_of_none_is_refused(nominal):
    with pytest.raises(ConfigurationError, match="heads: expected at least 1, got 0"):
        draw_heads(nominal, TwinConfig().errors, 0, 0)


@pytest.mark.nightly
def test_a_detector_errs_by_hundredths_of_a_pixel_near_and_far():
    near, far = (
        measure_head_noise(
            load_head("physical"), np.array([0.0, 0.0, z]), 2, 30, np.random.default_rng(0)
        )
        for z in (0.6, 2.4)
    )
    for noise in (near, far):
        assert noise.sigma_px.min() > 0.003
        assert noise.sigma_px.max() < 0.06
        assert noise.bias_px.max() < 0.03


def test_noise_at_several_places_is_a_row_a_place_of_a_table():
    places = [DetectorNoise(np.full((2, 2), s), np.full((2, 2), 2.0 * s)) for s in (0.1, 0.2)]
    frame = DetectorNoise.stacked(places).table(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]))
    assert np.allclose(frame["truth_z_mm"], [1000.0, 2000.0])
    assert np.allclose(frame["sigma_px"], [0.1, 0.2])
    assert np.allclose(frame["bias_px"], [0.2, 0.4])


POINTS = static_points("physical")
COUNT = 12


@pytest.fixture(scope="module")
def heads(nominal):
    return draw_heads(nominal, TWIN_SPREADS.scaled(0.5), COUNT, 0)


def drawn_by(nominal, source):
    return draw_heads(nominal, ModelErrors(**{source: getattr(TWIN_SPREADS, source)}), COUNT, 0)


def test_looking_puts_the_target_at_the_wanted_raw_pixels(nominal, heads):
    for offset in ((0.0, 0.0), (-180.0, 60.0), (90.0, -150.0)):
        wanted = nominal.cameras.principal + np.array(offset)
        q = joint_angles_imaging_at(nominal, heads[:, None], POINTS, wanted)
        assert np.isfinite(q).all()
        assert np.allclose(heads[:, None].project(q, POINTS), wanted, atol=1e-9)


def test_nothing_looks_where_the_target_would_leave_the_image(nominal):
    outside = nominal.cameras.principal + np.array([300.0, 0.0])
    assert np.isnan(joint_angles_imaging_at(nominal, nominal, POINTS[0], outside)).all()


def test_an_exact_head_makes_no_error_anywhere_in_the_image(nominal):
    pixels = nominal.cameras.principal + np.array([-150.0, 80.0])
    assert np.abs(mean_fix_errors_m(nominal, nominal, POINTS, pixels, encoders=False)).max() < 1e-9


def test_errors_of_the_lens_and_focal_length_vanish_on_the_axis_alone(nominal):
    pixels = nominal.cameras.principal + np.array([-200.0, 0.0])
    for source in ("focal_relative", "distortion"):
        drawn = drawn_by(nominal, source)
        assert np.abs(settled_fix_errors_m(nominal, drawn, POINTS, encoders=False)).max() < 1e-9
        beside = mean_fix_errors_m(nominal, drawn[:, None], POINTS, pixels, encoders=False)
        assert np.abs(beside).max() > 1e-4


def test_every_other_source_is_felt_on_the_axis(nominal):
    for source in set(vars(TWIN_SPREADS)) - {"focal_relative", "distortion"}:
        drawn = drawn_by(nominal, source)
        assert np.abs(settled_fix_errors_m(nominal, drawn, POINTS, encoders=False)).max() > 1e-4


def test_a_tremble_blurs_the_edge_between_two_steps_of_an_encoder_only(nominal):
    step = nominal.sensor.encoder_resolution_rad
    at = step * np.array([0.0, 0.4, 0.5, 0.6, 1.0])
    counts = mean_encoder_readings(nominal, at) / step
    assert np.allclose(counts, [0.0, 0.0, 0.5, 1.0, 1.0], atol=1e-6)
    exact = nominal.replace(sensor={"encoder_resolution_rad": 0.0})
    assert np.array_equal(mean_encoder_readings(exact, at), at)


def test_the_closed_loop_settles_where_the_geometry_says(nominal, heads):
    exact = nominal.replace(sensor={"encoder_resolution_rad": 0.0})
    true = heads.replace(sensor={"encoder_resolution_rad": 0.0})
    for point in POINTS[[0, 20]]:
        record = hold_gaze(
            ClosedLoop(
                head=exact, true_head=true, num=COUNT,
                target={"kind": "static", "point": point.tolist(), "start": "fixation"}, samples=3,
                settle_s=4.0, plant="kinematic", plant_options={"detection_noise_px": 0.0},
            )
        )  # fmt: skip
        foreseen = 1000.0 * settled_fix_errors_m(exact, true, point[None])[:, 0]
        # what is left of the approach, exp(-4 x 4), is worth a thousandth of a millimetre
        assert np.allclose(record.gaze_error_mm[-1], foreseen, atol=2e-3)
        assert np.allclose(record.itpc_error_mm[-1], foreseen, atol=2e-3)


@pytest.mark.nightly
def test_the_scale_makes_the_median_head_the_article_s(nominal):
    config = TwinConfig(heads=30)
    scale = find_error_scale(nominal, config, 1)
    errors = settled_fix_errors_m(
        nominal, draw_heads(nominal, config.errors.scaled(scale), 30, 1), POINTS
    )
    # the encoders' steps make the median jump by some tenths of a per cent of 30 heads
    assert np.median(largest_depth_error_percent(errors, POINTS)) == pytest.approx(4.97, abs=0.15)


def test_a_scale_of_the_user_s_is_taken(nominal):
    assert find_error_scale(nominal, TwinConfig(scale=0.3), 0) == 0.3


def test_less_than_the_encoders_give_is_refused(nominal):
    with pytest.raises(ConfigurationError, match="encoders alone"):
        find_error_scale(nominal, TwinConfig(heads=3, largest_error_percent=0.1), 0)
