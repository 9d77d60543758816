"""Tracking: near the prediction while the target is followed, everywhere once it is lost."""

import numpy as np
import pytest

from tests.vision.poses import pose
from vergence.models.parts import Rendering
from vergence.vision import Camera, TargetRenderer, make_detector, make_planar_target
from vergence.vision.tracking import Tracker


@pytest.fixture
def drawing(pinhole: Camera, rendering: Rendering) -> TargetRenderer:
    return TargetRenderer(pinhole, make_planar_target("tag"), rendering)


class Watched:
    """A detector that keeps where it was told to look; None for the whole image."""

    def __init__(self, drawing: TargetRenderer) -> None:
        self._detector = make_detector(drawing.target, drawing.camera)
        self.camera = drawing.camera
        self.looked = []

    def search(self, image, near_px, way):
        self.looked.append(None)
        return self._detector.search(image, near_px, way)

    def track(self, image, predicted):
        self.looked.append(tuple(predicted.point_px))
        return self._detector.track(image, predicted)


def images(drawing: TargetRenderer, *x: float) -> list[np.ndarray]:
    """The target at places from left to right, 1 m ahead."""
    out = []
    for where in x:
        drawing.draw(pose(where, 0.0, 1.0))
        out.append(drawing.frame.copy())
    return out


def test_the_target_is_expected_where_its_motion_takes_it(drawing):
    detector = Watched(drawing)
    tracker = Tracker(detector)
    x = (0.0, 0.03, 0.06)
    first, second, _third = (tracker.find(image).point_px for image in images(drawing, *x))
    whole, once, moved = detector.looked
    assert whole is None
    assert once == tuple(first)
    assert moved == pytest.approx(2.0 * second - first)


def test_a_prediction_takes_the_place_of_the_motion(drawing):
    detector = Watched(drawing)
    tracker = Tracker(detector)
    still, moved = images(drawing, 0.0, 0.2)
    tracker.find(still)
    assert tracker.find(moved, (640.0, 430.0)) is not None
    assert detector.looked[1:] == [(640.0, 430.0)]


def test_a_target_that_jumps_is_searched_in_the_whole_image(drawing):
    detector = Watched(drawing)
    tracker = Tracker(detector)
    here, far = images(drawing, 0.0, 0.5)
    last = tracker.find(here).point_px
    found = tracker.find(far).point_px
    assert found == pytest.approx(drawing.camera.project([[0.5, 0.0, 1.0]])[0], abs=0.1)
    assert detector.looked == [None, tuple(last), None]


def test_a_lost_target_is_searched_anew(drawing):
    detector = Watched(drawing)
    tracker = Tracker(detector)
    here, empty = *images(drawing, 0.0), np.full_like(drawing.frame, 120)
    for lose in (lambda: tracker.find(empty), tracker.forget):
        tracker.find(here)
        assert lose() is None
        detector.looked.clear()
        assert tracker.find(here) is not None
        assert detector.looked == [None]


def test_an_image_known_to_be_empty_need_not_be_searched(drawing):
    detector = Watched(drawing)
    assert Tracker(detector).find(drawing.frame, search=False) is None
    assert detector.looked == []


def test_a_motion_of_the_camera_counts_by_the_targets_distance(drawing):
    """A camera that moves by 20 mm sees a target at 0.5 m move by f / 25."""
    detector = Watched(drawing)
    tracker = Tracker(detector)
    moved = pose(0.02, 0.0, 0.0)
    drawing.draw(pose(0.0, 0.0, 0.5))
    first = tracker.find(drawing.frame, T_0_C=np.eye(4))
    drawing.draw(pose(-0.02, 0.0, 0.5))
    tracker.find(drawing.frame, T_0_C=moved)
    expected = first.point_px - (drawing.camera.focal[0] / 25.0, 0.0)
    assert detector.looked[1] == pytest.approx(expected, abs=0.2)


def test_a_sigma_comes_with_each_pixel(drawing):
    """The scatter of 100 images of a target at rest is what the sigmas say, to a third."""
    tracker, rng = Tracker(make_detector(drawing.target, drawing.camera)), np.random.default_rng(3)
    found = []
    for _ in range(100):
        drawing.draw(pose(0.01, 0.02, 1.5), rng)
        found.append(tracker.find(drawing.frame))
    scatter = np.std([each.point_px for each in found], axis=0)
    said = np.sqrt(np.mean([each.sigma_px**2 for each in found], axis=0))
    assert said == pytest.approx(scatter, rel=0.35)
    scatter = np.std([each.corners_px for each in found], axis=0)
    said = np.sqrt(np.mean([each.corners_sigma_px**2 for each in found], axis=0))
    assert said == pytest.approx(scatter, rel=0.35)
