"""The Cramer-Rao bound of a corner's pixel, and the detector beside it."""

import numpy as np
import pytest

from vergence.eval.article.board_views import (
    FixedView,
    board_poses_in_eyes,
    cramer_rao_bound,
    shifted_pose,
)
from vergence.models.head_file import load_head


@pytest.fixture(scope="module")
def head():
    return load_head("simulated")


def pose(head, depth):
    point = np.array([0.0, -0.1, depth])
    return board_poses_in_eyes(head, head.fixate(point), point)[0]


def test_a_fixated_board_lies_on_the_principal_point(head):
    view = FixedView(head, 0)
    assert np.allclose(view.true_pixel(pose(head, 1.0)), head.cameras.principal[0], atol=1e-9)
    moved = shifted_pose(head, 0, pose(head, 1.0), (0.3, -0.7))
    assert np.allclose(view.true_pixel(moved) - head.cameras.principal[0], (0.3, -0.7))


def test_the_bound_is_that_of_an_edge_of_gaussian_blur(head):
    # A corner's window has two edges of 11 px; each gives (c / 2 s) / sqrt(pi) / noise^2 a pixel
    # of length for a step c blurred by s, along its normal, and the corner itself takes a little.
    rendering = head.rendering
    step = rendering.white_grey - rendering.black_grey
    blur = np.hypot(rendering.blur_px, np.sqrt(1.0 / 12.0))
    variance = rendering.noise_grey**2 + 1.0 / 12.0
    information = 11.0 * step**2 / (2.0 * np.sqrt(np.pi) * blur) / variance
    bound = cramer_rao_bound(head, 0, pose(head, 1.5)).window
    assert np.allclose(bound, 1.0 / np.sqrt(information), rtol=0.15)


def test_the_bound_grows_with_the_noise(head):
    noisy = head.replace(rendering={"noise_grey": 4.0})
    ratio = np.sqrt((16.0 + 1.0 / 12.0) / (4.0 + 1.0 / 12.0))
    for quiet, loud in zip(
        cramer_rao_bound(head, 0, pose(head, 1.0)),
        cramer_rao_bound(noisy, 0, pose(head, 1.0)),
        strict=True,
    ):
        assert np.allclose(loud, ratio * quiet)


def test_a_larger_image_of_the_board_tells_more(head):
    near, far = (cramer_rao_bound(head, 0, pose(head, depth)) for depth in (0.6, 2.4))
    assert (near.board < far.board).all()
    assert (far.board < far.window).all()


@pytest.mark.slow
def test_the_detector_scatters_more_than_the_bound_of_its_window(head):
    board = pose(head, 2.0)
    pixels = FixedView(head, 0).detect([board] * 100, np.random.default_rng(0))
    bound = cramer_rao_bound(head, 0, board).window
    assert (pixels.std(axis=0) > bound).all()
    assert (pixels.std(axis=0) < 5.0 * bound).all()
