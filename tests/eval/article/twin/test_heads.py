"""The population of true heads: what its errors do, and what settled fixations make of them."""

import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.eval.article.common.closed_loop import ClosedLoop, hold_gaze
from vergence.eval.article.reported import static_points
from vergence.eval.article.twin.heads import (
    SOURCES,
    TwinConfig,
    draw_heads,
    encoded,
    find_scale,
    fix_errors,
    largest_relative,
    looking,
    static_errors,
    with_common_tilt,
)
from vergence.models.files.head_file import load_head

CONFIG = TwinConfig(heads=12)
POINTS = static_points("physical")


@pytest.fixture(scope="module")
def nominal():
    return load_head("physical")


@pytest.fixture(scope="module")
def heads(nominal):
    return draw_heads(nominal, CONFIG, 0, 0.5)


def test_a_common_tilt_leaves_the_cameras_as_they_were_to_each_other(nominal):
    q = nominal.fixate((-0.4, -0.2, 1.0))
    tilted = with_common_tilt(nominal[None], np.array([0.03]))[0]
    before, after = nominal.camera_poses(q), tilted.camera_poses(q)
    assert np.allclose(np.linalg.inv(before[0]) @ before[1], np.linalg.inv(after[0]) @ after[1])
    # both eyes look lower: y is down
    assert (after[:, 1, 2] > before[:, 1, 2] + 0.02).all()


def test_one_source_alone_deviates_as_it_does_among_all(nominal):
    both = draw_heads(nominal, CONFIG, 3, 0.7)
    alone = draw_heads(nominal, CONFIG, 3, 0.7, only="principal_px")
    assert np.array_equal(both.cameras.principal, alone.cameras.principal)
    assert np.array_equal(alone.head_eye[0], nominal.head_eye)
    assert np.array_equal(np.broadcast_to(nominal.links.offset, (12, 9)), alone.links.offset)


def test_deviations_are_proportional_to_the_scale(nominal):
    once, twice = (draw_heads(nominal, CONFIG, 3, scale) for scale in (0.5, 1.0))
    assert np.allclose(
        2.0 * (once.links.offset - nominal.links.offset), twice.links.offset - nominal.links.offset
    )


@pytest.mark.parametrize("offset", [(0.0, 0.0), (-180.0, 60.0), (90.0, -150.0)])
def test_looking_puts_the_target_at_the_wanted_raw_pixels(nominal, heads, offset):
    wanted = nominal.cameras.principal + np.array(offset)
    q = looking(nominal, heads[:, None], POINTS, wanted)
    assert np.isfinite(q).all()
    assert np.allclose(heads[:, None].project(q, POINTS), wanted, atol=1e-9)


def test_nothing_looks_where_the_target_would_leave_the_image(nominal):
    outside = nominal.cameras.principal + np.array([300.0, 0.0])
    assert np.isnan(looking(nominal, nominal, POINTS[0], outside)).all()


def test_an_exact_head_makes_no_error_anywhere_in_the_image(nominal):
    pixels = nominal.cameras.principal + np.array([-150.0, 80.0])
    assert np.abs(fix_errors(nominal, nominal, POINTS, pixels, encoders=False)).max() < 1e-9


def test_errors_of_the_lens_and_focal_length_vanish_on_the_axis_alone(nominal):
    pixels = nominal.cameras.principal + np.array([-200.0, 0.0])
    for source in ("focal_relative", "distortion"):
        drawn = draw_heads(nominal, CONFIG, 0, 1.0, only=source)
        assert np.abs(static_errors(nominal, drawn, POINTS, encoders=False)).max() < 1e-9
        beside = fix_errors(nominal, drawn[:, None], POINTS, pixels, encoders=False)
        assert np.abs(beside).max() > 1e-4


def test_every_other_source_is_felt_on_the_axis(nominal):
    for source in set(SOURCES) - {"focal_relative", "distortion"}:
        drawn = draw_heads(nominal, CONFIG, 0, 1.0, only=source)
        assert np.abs(static_errors(nominal, drawn, POINTS, encoders=False)).max() > 1e-4


def test_a_tremble_blurs_the_edge_between_two_steps_of_an_encoder_only(nominal):
    step = nominal.sensor.encoder_resolution_rad
    at = step * np.array([0.0, 0.4, 0.5, 0.6, 1.0])
    assert np.allclose(encoded(nominal, at) / step, [0.0, 0.0, 0.5, 1.0, 1.0], atol=1e-6)
    exact = nominal.replace(sensor={"encoder_resolution_rad": 0.0})
    assert np.array_equal(encoded(exact, at), at)


def test_the_closed_loop_settles_where_the_geometry_says(nominal, heads):
    exact = nominal.replace(sensor={"encoder_resolution_rad": 0.0})
    true = heads.replace(sensor={"encoder_resolution_rad": 0.0})
    for point in POINTS[[0, 20]]:
        record = hold_gaze(
            ClosedLoop(
                head=exact,
                true_head=true,
                num=CONFIG.heads,
                target={"kind": "static", "point": point.tolist(), "start": "fixation"},
                samples=3,
                settle_s=4.0,
                plant="kinematic",
                plant_options={"detection_noise_px": 0.0},
            )
        )
        foreseen = 1000.0 * static_errors(exact, true, point[None])[:, 0]
        # what is left of the approach, exp(-4 x 4), is worth a thousandth of a millimetre
        assert np.allclose(record.gaze_error_mm[-1], foreseen, atol=2e-3)
        assert np.allclose(record.itpc_error_mm[-1], foreseen, atol=2e-3)


def test_the_scale_makes_the_median_head_the_article_s(nominal):
    config = TwinConfig(heads=30)
    scale = find_scale(nominal, config, 1)
    errors = static_errors(nominal, draw_heads(nominal, config, 1, scale), POINTS)
    # the encoders' steps make the median jump by some tenths of a per cent of 30 heads
    assert np.median(largest_relative(errors, POINTS)) == pytest.approx(4.97, abs=0.15)


def test_a_scale_of_the_user_s_is_taken(nominal):
    assert find_scale(nominal, TwinConfig(scale=0.3), 0) == 0.3


def test_less_than_the_encoders_give_is_refused(nominal):
    with pytest.raises(ConfigurationError, match="encoders alone"):
        find_scale(nominal, TwinConfig(heads=3, largest_error_percent=0.1), 0)
