"""Closed loops: what a record holds, and how much of the detector's noise reaches the eyes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.eval.refusals import not_refused
from vergence.eval.article.closed_loop import (
    ClosedLoop,
    LinearLoop,
    _matrices,
    corrected_gaze_fix,
    dither_references_px,
    gaze_uncertainty_mm,
    hold_gaze,
    itpc_uncertainty_mm,
    noise_bandwidth_hz,
    noise_gain,
)
from vergence.models.head_file import load_head
from vergence.triangulation import triangulate_views

POINT = (0.05, -0.1, 1.0)
STILL = {"kind": "static", "point": POINT, "start": "fixation"}


@pytest.fixture(scope="module")
def head():
    return load_head("simulated")


def loop(head, **changes):
    silent = {"plant": "kinematic", "plant_options": {"detection_noise_px": 0.0}}
    return ClosedLoop(**{"head": head, "target": STILL, "samples": 20, **silent, **changes})


def test_without_noise_both_methods_find_the_point(head):
    record = hold_gaze(loop(head))
    assert np.abs(record.gaze_error_mm).max() < 1e-2
    assert np.abs(record.itpc_error_mm).max() < 1e-6


def test_pixels_and_angles_belong_to_the_exposure_of_a_moving_target(head):
    # without noise, every detection is where the target was when its image was exposed
    record = hold_gaze(loop(head, target={"kind": "circle", "period": 10.0}, samples=100, every=3))
    assert np.allclose(record.pixels, record.true_pixels_at_exposure, atol=1e-9)
    assert np.abs(record.itpc_error_mm).max() < 1e-6
    latency = head.timing.latency_s
    assert np.allclose(record.time_s - record.exposure_s, latency)
    moved = np.linalg.norm(record.target - record.target_at_exposure, axis=-1)
    assert np.allclose(moved, 2.0 * np.pi / 10.0 * 0.1 * latency, rtol=1e-3)


def test_samples_are_the_asked_periods_apart(head):
    record = hold_gaze(loop(head, samples=5, every=4, settle_s=0.5))
    assert np.allclose(record.time_s, 0.5 + 4 * np.arange(5) / 120.0)


def test_several_heads_have_an_axis_and_their_own_noise(head):
    noisy = loop(head, num=3, plant_options={"detection_noise_px": 0.02})
    record = hold_gaze(noisy)
    assert record.pixels.shape == (20, 3, 2, 2)
    assert record.itpc.point.shape == (20, 3, 3)
    assert len(np.unique(record.pixels[-1, :, 0, 0])) == 3
    alone = hold_gaze(loop(head, plant_options={"detection_noise_px": 0.02}))
    assert np.array_equal(alone.pixels, record.pixels[:, 0])


def test_a_reference_holds_the_target_beside_the_principal_point(head):
    record = hold_gaze(loop(head, references_px=((1.5, -0.5),), settle_s=4.0))
    assert np.allclose(record.pixel_error, [1.5, -0.5], atol=1e-3)
    # the pixels tell, so the fix from them does not care
    assert np.abs(record.itpc_error_mm).max() < 1e-6


def test_references_share_the_samples(head):
    record = hold_gaze(
        loop(head, references_px=((0.4, 0.0), (-0.4, 0.0)), samples=960, settle_s=4.0)
    )
    u = record.pixel_error[:, 0, 0]
    assert u[479] == pytest.approx(0.4, abs=1e-3)
    assert u[-1] == pytest.approx(-0.4, abs=1e-3)


def test_dithering_covers_a_pixel_evenly():
    for side in (1, 2, 4):
        offsets = np.array(dither_references_px(side))
        assert len(offsets) == side**2
        assert np.allclose(offsets.mean(axis=0), 0.0)
        # the phases within a pixel are a comb: harmonics below its order average to nothing
        for order in range(1, side):
            assert np.abs(np.exp(2j * np.pi * order * offsets).mean(axis=0)).max() < 1e-12


def test_the_article_s_gaze_uncertainty_is_that_of_two_views_straight_ahead(head):
    q = head.fixate((0.0, -0.03, 1.0))
    sigma = np.array([[0.01, 0.02], [0.03, 0.015]])
    gaze = gaze_uncertainty_mm(head, q, sigma)
    views = itpc_uncertainty_mm(head, q, head.cameras.principal, sigma)
    assert np.allclose(gaze, views, rtol=0.02)


def test_gaze_corrected_by_its_pixel_error_is_the_fix_from_pixels(head):
    q = head.fixate(POINT)
    error = np.array([[0.3, -0.2], [-0.25, -0.15]])
    depth = np.full(2, 0.99)
    corrected = corrected_gaze_fix(head, q, error, depth)
    views = triangulate_views(head, q, head.cameras.principal + error)
    moved = np.linalg.norm(views.point - np.array(POINT))
    assert np.linalg.norm(corrected.point - views.point) < 2e-3 * moved


def test_what_cannot_be_is_refused(head):
    wrong = {"samples": 0, "every": 0, "num": 0, "settle_s": -1.0, "references_px": ()}
    cases = [({name: value}, name) for name, value in wrong.items()]
    assert not_refused(lambda options: hold_gaze(loop(head, **options)), cases) == []


PERIOD = 1.0 / 120.0
RIG = LinearLoop(gain=4.0, period_s=PERIOD, delay_periods=8, lag_s=0.03)


def test_without_delay_and_lag_it_is_that_of_an_exponential_average():
    for gain in (0.5, 4.0, 20.0):
        loop = LinearLoop(gain=gain, period_s=PERIOD, delay_periods=0, lag_s=0.0)
        share = gain * PERIOD
        assert noise_gain(loop) ** 2 == pytest.approx(share / (2.0 - share))
    assert noise_gain(replace(RIG, gain=30.0)) == np.inf


def test_a_slow_loop_has_the_bandwidth_of_a_first_order_low_pass():
    assert noise_bandwidth_hz(replace(RIG, gain=0.1)) == pytest.approx(0.1 / 4.0, rel=0.03)


def impulse_response(loop, steps):
    """Response of the optical axis to a single detection that is off by one pixel, px."""
    step, state = _matrices(loop)
    response = np.empty(steps)
    for k in range(steps):
        response[k] = state[0]
        state = step @ state
    return response


def test_the_variance_is_the_sum_of_the_squared_impulse_response():
    for gain in (1.0, 4.0):
        loop = replace(RIG, gain=gain)
        response = impulse_response(loop, 4000)
        assert np.sum(response**2) == pytest.approx(noise_gain(loop) ** 2, rel=1e-9)


def test_a_constant_bias_reaches_the_eyes_in_full():
    # the axis moves against the bias: what is measured settles at zero
    assert impulse_response(RIG, 4000).sum() == pytest.approx(-1.0, abs=1e-9)


def test_delay_and_a_lower_rate_let_more_noise_through():
    assert noise_gain(RIG) > noise_gain(replace(RIG, delay_periods=0, lag_s=0.0))
    assert noise_gain(RIG.at_rate(30.0)) > noise_gain(RIG)


@pytest.mark.slow
def test_loops_that_run_scatter_as_much():
    head = load_head("simulated")
    loop = ClosedLoop(
        head=head, target={"kind": "static", "point": (0.0, -0.1, 1.0), "start": "fixation"},
        plant="kinematic", num=60, samples=600,
    )  # fmt: skip
    record = hold_gaze(loop)
    axis = record.true_pixels_at_exposure - head.cameras.principal
    noise = record.pixels - record.true_pixels_at_exposure
    # 60 heads x 4 axes x 5 s at 2 x 1.36 Hz are 3,300 independent values: 1.2 %
    assert axis.std() / noise.std() == pytest.approx(noise_gain(LinearLoop.of(head, 4.0)), rel=0.05)
