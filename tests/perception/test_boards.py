"""The middle of a board and the distances on it, also where corners are missing."""

import numpy as np
import pytest

from vergence import load_head
from vergence.perception.finding import centre_weights, target_centre_px, weighted_sum
from vergence.perception.locate import measure_spacing, neighbour_distances_m
from vergence.vision import Camera, Detection
from vergence.vision.targets import AprilTag, Checkerboard, neighbour_pairs

BOARD = Checkerboard(columns=5, rows=4, square_m=0.03)


def test_a_board_and_a_part_of_it_have_one_middle_on_a_plane_in_space_and_a_line_has_none():
    weights = centre_weights(BOARD.corners_m, np.ones(20, bool))
    np.testing.assert_allclose(weights, 1.0 / 20.0, atol=1e-12)
    rng = np.random.default_rng(0)
    whole = BOARD.corners_m @ rng.normal(size=(2, 3))
    points = whole + rng.normal(size=3)
    for seen in ([0, 1, 2, 6, 7], [], [3], [0, 4], [0, 1, 2, 3]):
        found = np.isin(np.arange(20), seen)
        weights = centre_weights(BOARD.corners_m, found)
        if len(seen) < 5:
            assert np.isnan(weights).all(), seen
            continue
        middle = weighted_sum(np.where(found[:, None], points, np.nan), weights)
        np.testing.assert_allclose(middle - points[0], whole.mean(axis=0) - whole[0], atol=1e-9)


def detection(target, corners):
    sigma = np.where(np.isfinite(corners), 0.1, np.nan)
    return Detection(target, corners[0], corners, np.full(2, 0.1), sigma)


def test_the_pixel_of_the_middle_is_where_the_lens_puts_it():
    camera = Camera.of(load_head("physical"), 0)
    flat = np.column_stack([BOARD.corners_m, np.zeros(20)])
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    points = flat @ turn.T + [0.08, -0.05, 0.4]
    corners = camera.project(points)
    true = camera.project([points.mean(axis=0)])[0]
    pixel, sigma = target_centre_px(detection(BOARD, corners), camera)
    np.testing.assert_allclose(pixel, true, atol=1e-6)
    np.testing.assert_allclose(sigma, 0.1 / np.sqrt(20.0), atol=1e-12)
    corners[[0, 3, 7, 11]] = np.nan
    pixel, _ = target_centre_px(detection(BOARD, corners), camera)
    np.testing.assert_allclose(pixel, true, atol=1e-6)
    corners[5:] = np.nan
    assert np.isnan(target_centre_px(detection(BOARD, corners), camera)[0]).all()


def test_neighbours_are_an_edge_apart():
    assert len(neighbour_pairs(BOARD)) == 4 * 4 + 5 * 3
    assert len(neighbour_pairs(AprilTag())) == 4
    points = np.column_stack([BOARD.corners_m, np.zeros(20)])
    np.testing.assert_allclose(neighbour_distances_m(BOARD, 1.01 * points), 0.0303, atol=1e-12)
    points[0] = np.nan
    spacing = measure_spacing(BOARD, [points, 1.02 * points])
    assert spacing[:4] == pytest.approx((0.0303, 0.0003, 2 * 29, 0.03))


def test_what_was_not_stated_and_what_was_not_found_is_none_in_json():
    unsaid = Checkerboard(columns=5, rows=4, size_known=False)
    nothing = np.full((20, 3), np.nan)
    assert measure_spacing(unsaid, [nothing]).document() == {
        "mean": None, "spread": None, "count": 0, "stated": None,
    }  # fmt: skip
