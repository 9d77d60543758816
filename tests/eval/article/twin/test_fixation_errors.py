"""Errors of the nominal model at the fixation points of settled true heads."""

import numpy as np
import pytest

from vergence.eval.article.common.closed_loop import ClosedLoop, hold_gaze
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.fixation_errors import (
    joint_angles_imaging_at,
    mean_encoder_readings,
    mean_fix_errors_m,
    settled_fix_errors_m,
)
from vergence.eval.article.twin.heads import draw_heads
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.perturbation import ModelErrors

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
