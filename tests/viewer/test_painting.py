"""The head from outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.naming import named
from vergence.models.head_file import load_head, presets
from vergence.viewer.eye_pictures import EYE_COLOURS
from vergence.viewer.painting import HeadPainter

TARGET = np.array([0.12, -0.08, 0.5])
NOWHERE = np.full(3, np.nan)


@pytest.fixture(scope="module")
def head():
    return load_head("simulated")


@pytest.fixture(scope="module")
def painter(head):
    return HeadPainter(head)


def white(picture):
    return (picture > 242).all(axis=2)


def coloured(picture, colour):
    """True where a picture has about a colour's hue."""
    hue, picture = np.argsort(colour), picture.astype(int)
    spread = picture[..., hue[2]] - picture[..., hue[0]]
    return (spread > 60) & (picture.argmax(axis=2) == hue[2])


@pytest.mark.slow
def test_the_board_and_both_axes_are_painted_on_every_preset():
    for name in presets():
        with named(name):
            head = load_head(name)
            target = np.array([0.02, -0.02, 0.4])
            picture = HeadPainter(head).draw(head.fixate(target), target, 640, 300)
            assert picture.shape == (300, 640, 3)
            assert white(picture).sum() > 500
            for colour in EYE_COLOURS:
                assert coloured(picture, colour).sum() > 300


def test_the_eyes_move_in_the_picture_when_they_turn(head, painter):
    at_rest = painter.draw(head.rest(), TARGET, 640, 300)
    turned = painter.draw(head.fixate(TARGET), TARGET, 640, 300)
    assert (at_rest != turned).any(axis=2).mean() > 0.01
    for colour in EYE_COLOURS:
        assert (coloured(at_rest, colour) != coloured(turned, colour)).sum() > 200


def test_an_unknown_target_has_no_board(head, painter):
    assert white(painter.draw(head.rest(), TARGET, 640, 300)).sum() > 500
    assert not white(painter.draw(head.rest(), TARGET, 640, 300, board=False)).any()
    assert not white(painter.draw(head.rest(), NOWHERE, 640, 300)).any()


def test_the_fix_is_marked_where_it_is(head, painter):
    fix, camera = np.array([0.0, 0.0, 0.3]), painter.place_camera(head.rest(), TARGET, 2.0)
    without, marked = (
        painter.draw(head.rest(), TARGET, 600, 300, fix=one, camera=camera)
        for one in (NOWHERE, fix)
    )
    v, u = np.nonzero((without != marked).any(axis=2))
    assert 20 < len(u) < 400
    assert max(np.ptp(u), np.ptp(v)) < 25


@settings(max_examples=50, deadline=None)
@given(
    z=st.floats(0.2, 5.0), x=st.floats(-1.0, 1.0), y=st.floats(-0.8, 0.8), yaw=st.floats(-1.0, 1.0)
)
def test_both_the_target_and_the_eyes_are_in_view(head, painter, z, x, y, yaw):
    positions, target = head.rest(), z * np.array([x, y, 1.0])
    positions[0] = yaw
    camera = painter.place_camera(positions, target, 2.0)
    points = np.concatenate([head.camera_poses(positions)[:, :3, 3], [target]])
    # the simulated head's upright frame is its frame 0
    frame_n = head.base_pose(positions)
    seen = (points @ frame_n[:3, :3].T + frame_n[:3, 3] - camera.position) @ camera.rotation
    assert (seen[:, 2] > 0.0).all()
    places = seen[:, :2] / seen[:, 2:] * camera.focal
    assert (np.abs(places) < [1.0, 0.5]).all()
