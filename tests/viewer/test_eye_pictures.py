"""Marks of an eye's picture stand where the camera has them, however small its image is."""

import cv2
import numpy as np
import pytest

from vergence.envs.task import EyeImages, GazeTask
from vergence.models.head_file import load_head
from vergence.viewer.eye_pictures import EYE_COLOURS, draw_eye
from vergence.viewer.moment import moment_of


@pytest.mark.parametrize(("name", "shrunk_to"), [("simulated", None), ("icub", 250)])
def test_the_principal_point_is_marked_in_its_place(name, shrunk_to):
    head = load_head(name)
    shown = moment_of(GazeTask(1, head=head, plant="kinematic"))
    left, right = (np.full(size[::-1], 120, np.uint8) for size in head.cameras.size)
    if shrunk_to:
        height = round(shrunk_to / left.shape[1] * left.shape[0])
        left, right = (cv2.resize(one, (shrunk_to, height)) for one in (left, right))
    shown = shown._replace(images=EyeImages(left, right, False), pixels=np.full((2, 2), np.nan))
    picture = draw_eye(head, shown, 0, 250).astype(int)
    v, u = np.nonzero(np.abs(picture - EYE_COLOURS[0]).sum(axis=-1) < 30)
    expected = 250 / head.cameras.size[0, 0] * head.cameras.principal[0]
    assert [u.mean(), v.mean()] == pytest.approx(expected, abs=1.5)
