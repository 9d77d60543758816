"""The view of the head from outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vergence.models.files.head_file import load_head
from vergence.viewer.outside_view import EYE_COLOURS, OutsideView, place_outside_camera
from vergence.viewer.pictures import opengl_works

HALF_HEIGHT = np.tan(np.deg2rad(22.5))
"""Half height of the image at 1 m, m: MuJoCo's free camera has a field of view of 45 degrees."""
ASPECT = 2.0
"""Width over height of the picture; it is wider than that."""


def image_place(camera, point):
    """Image position of a world point that is in view, from -1 to 1 in both directions."""
    azimuth, elevation = np.deg2rad([camera.azimuth, camera.elevation])
    ahead = np.array([
        np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation),
    ])  # fmt: skip
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = point - (camera.lookat - camera.distance * ahead)
    depth = seen @ ahead
    assert depth > 0.0
    across = np.array([seen @ right / ASPECT, seen @ np.cross(right, ahead)])
    return across / (depth * HALF_HEIGHT)


@settings(max_examples=50)
@given(
    z=st.floats(0.2, 5.0), x=st.floats(-1.0, 1.0), y=st.floats(-0.8, 0.8), yaw=st.floats(-1.0, 1.0)
)
def test_the_view_from_outside_shows_the_target_and_the_head(z, x, y, yaw):
    head = load_head("simulated")
    positions = head.rest()
    positions[0] = yaw
    here, target = head.base_pose(positions), z * np.array([x, y, 1.0])
    camera = place_outside_camera(here, target)
    for point in (here[:3, 3], (here @ [*target, 1.0])[:3]):
        assert (np.abs(image_place(camera, point)) < 1.0).all()


@pytest.mark.skipif(not opengl_works(), reason="no OpenGL to draw the view with")
def test_the_board_and_both_axes_are_drawn():
    head, target = load_head("simulated"), np.array([-0.4, -0.3, 1.0])
    scene = OutsideView(head)
    picture = scene.draw(head.fixate(target), target, 640, 300).astype(int)
    scene.close()
    assert (picture.min(axis=2) > 200).sum() > 50
    for colour in EYE_COLOURS:
        hue = np.argsort(colour)
        spread = picture[..., hue[2]] - picture[..., hue[0]]
        assert ((spread > 60) & (picture.argmax(axis=2) == hue[2])).sum() > 100
