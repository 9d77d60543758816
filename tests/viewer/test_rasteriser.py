"""Triangles in the pixels that they cover, the nearest in front."""

import numpy as np

from vergence.viewer.rasteriser import Triangles, paint_triangles

RED, BLUE = (200, 0, 0), (0, 0, 200)


def triangle(*corners, colour=RED, shades=(1.0, 1.0, 1.0)):
    return Triangles(np.array([corners], float), np.array([shades]), np.array([colour], float))


def painted(*triangles, size=64, focal=32.0):
    image = np.zeros((size, size, 3), np.uint8)
    seen = Triangles(*(np.concatenate(part) for part in zip(*triangles, strict=True)))
    paint_triangles(image, seen, focal, (0.5 * (size - 1), 0.5 * (size - 1)))
    return image


def test_a_triangle_covers_the_pixels_whose_centres_are_in_it():
    image = painted(triangle((-0.5, -0.5, 1.0), (-0.5, 0.5, 1.0), (0.5, -0.5, 1.0)))
    v, u = np.mgrid[:64, :64]
    inside = (u > 15.5) & (v > 15.5) & (u + v < 63.0 + 1e-9)
    assert ((image == RED).all(axis=2) == inside).all()


def test_neighbours_leave_no_gap():
    a, b, c, d = (-0.51, -0.43, 1.1), (-0.4, 0.47, 0.9), (0.53, 0.4, 1.0), (0.5, -0.38, 1.2)
    covered = painted(triangle(a, b, c), triangle(a, c, d)).any(axis=2)
    for row in covered[covered.any(axis=1)]:
        inside = np.flatnonzero(row)
        assert row[inside[0] : inside[-1] + 1].all()


def test_the_nearer_of_two_that_intersect_is_seen_at_each_pixel():
    left_near, right_near = (
        triangle((-1, -1, near), (-1, 1, near), (1, 0, far), colour=colour)
        for (near, far), colour in (((1.0, 2.0), RED), ((2.0, 1.0), BLUE))
    )
    image = painted(left_near, right_near, size=64, focal=20.0)
    assert (image[32, 20] == RED).all()
    assert (image[32, 44] == BLUE).all()


def test_what_lies_out_of_view_or_behind_the_camera_or_shows_its_back_is_left_out():
    far_left = triangle((-9.5, -0.5, 1.0), (-9.5, 0.5, 1.0), (-8.5, -0.5, 1.0))
    behind = triangle((-0.5, -0.5, -1.0), (-0.5, 0.5, -1.0), (0.5, -0.5, 1.0))
    back = triangle((-0.5, -0.5, 1.0), (0.5, -0.5, 1.0), (-0.5, 0.5, 1.0))
    assert not painted(far_left, behind, back).any()


def test_brightness_runs_linearly_between_the_corners():
    image = painted(
        triangle((-1, -1, 1.0), (-1, 3, 1.0), (3, -1, 1.0), shades=(0.0, 0.0, 1.0)), size=64
    )
    row = image[0, :, 0].astype(float)
    assert np.abs(row - 200.0 * np.arange(64) / 128.0).max() < 2.0
