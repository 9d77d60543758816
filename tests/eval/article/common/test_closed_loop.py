"""Closed-loop runs: what is recorded belongs together, and what is derived from it is right."""

import numpy as np
import pytest

from tests.eval.refusals import not_refused
from vergence.eval.article.common.closed_loop import (
    ClosedLoop,
    corrected_gaze_fix,
    dither_references_px,
    gaze_uncertainty_mm,
    hold_gaze,
    itpc_uncertainty_mm,
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
