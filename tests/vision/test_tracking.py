"""Tracking: near the prediction while the target is followed, also by a head that moves itself.

Everywhere once it is lost.
"""

import numpy as np
import pytest

from tests.vision.poses import pose
from tests.vision.scenes import CAMERA, RENDERING, rig, scene, shadow
from vergence import load_head
from vergence.vision import (
    AprilGrid,
    AprilTag,
    CharucoBoard,
    Checkerboard,
    Tracker,
    make_detector,
)  # fmt: skip

TAG = AprilTag()
TARGETS = {
    "tag": TAG,
    "checkerboard": Checkerboard(),
    "charuco": CharucoBoard(columns=5, rows=4, square_m=0.04),
    "aprilgrid": AprilGrid(columns=4, rows=3, tag_m=0.04),
}
EMPTY = scene(CAMERA, TAG, pose(0, 0, -1.0), RENDERING).image


class Watched:
    """A detector that keeps where it was told to look; None for the whole image."""

    def __init__(self, target=TAG, camera=CAMERA) -> None:
        self._detector = make_detector(target, camera)
        self.target, self.camera = target, camera
        self.looked = []

    def search(self, image, near_px, way):
        self.looked.append(None)
        return self._detector.search(image, near_px, way)

    def track(self, image, predicted):
        self.looked.append(tuple(predicted.point_px))
        return self._detector.track(image, predicted)


def at(x: float, z: float = 1.0) -> np.ndarray:
    """An image of a tag."""
    return scene(CAMERA, TAG, pose(x, 0.0, z), RENDERING).image


def test_the_target_is_expected_where_its_motion_takes_it():
    detector = Watched()
    tracker = Tracker(detector)
    first, second, _third = (tracker.find(at(x)).point_px for x in (0.0, 0.03, 0.06))
    whole, once, moved = detector.looked
    assert whole is None
    assert once == tuple(first)
    assert moved == pytest.approx(2.0 * second - first)


def test_a_prediction_takes_the_place_of_the_motion():
    detector = Watched()
    tracker = Tracker(detector)
    tracker.find(at(0.0))
    predicted = tuple(CAMERA.project([[0.2, 0.0, 1.0]])[0] - 5.0)
    assert tracker.find(at(0.2), predicted) is not None
    assert detector.looked[1:] == [predicted]


def test_a_target_that_jumps_is_searched_in_the_whole_image():
    detector = Watched()
    tracker = Tracker(detector)
    last = tracker.find(at(0.0)).point_px
    found = tracker.find(at(0.5)).point_px
    assert found == pytest.approx(CAMERA.project([[0.5, 0.0, 1.0]])[0], abs=0.1)
    assert detector.looked == [None, tuple(last), None]


def test_a_lost_target_is_searched_anew_unless_the_image_is_known_to_be_empty():
    detector = Watched()
    tracker = Tracker(detector)
    for lose in (lambda: tracker.find(EMPTY), tracker.forget):
        tracker.find(at(0.0))
        assert lose() is None
        detector.looked.clear()
        assert tracker.find(at(0.0), search=False) is None
        assert detector.looked == []
        assert tracker.find(at(0.0)) is not None
        assert detector.looked == [None]


def test_a_motion_of_the_camera_counts_by_the_targets_distance():
    """A camera that moves by 20 mm sees a target at 0.5 m move by f / 25."""
    detector = Watched()
    tracker = Tracker(detector)
    first = tracker.find(at(0.0, 0.5), T_0_C=np.eye(4))
    tracker.find(at(-0.02, 0.5), T_0_C=pose(0.02, 0.0, 0.0))
    expected = first.point_px - (CAMERA.focal[0] / 25.0, 0.0)
    assert detector.looked[1] == pytest.approx(expected, abs=0.2)


def test_a_camera_that_turned_its_back_sees_nothing_and_does_not_fail():
    tracker = Tracker(make_detector(TAG, CAMERA))
    assert tracker.find(at(0.0), T_0_C=np.eye(4)) is not None
    assert tracker.find(EMPTY, T_0_C=pose(0, 0, 0, (0, np.pi, 0))) is None
    assert tracker.find(at(0.0), T_0_C=np.eye(4)) is not None


def test_a_sigma_comes_with_each_pixel():
    """The scatter of 100 images of a target at rest is what the sigmas say, to a third.

    The point's lies in the article's range, 0.006 to 0.057 px, or a little below it.
    """
    tracker, rng = Tracker(make_detector(TAG, CAMERA)), np.random.default_rng(3)
    place = pose(0.01, 0.02, 1.5)
    found = [tracker.find(scene(CAMERA, TAG, place, RENDERING, rng).image) for _ in range(100)]
    for values, sigmas in (("point_px", "sigma_px"), ("corners_px", "corners_sigma_px")):
        scatter = np.std([getattr(each, values) for each in found], axis=0)
        said = np.sqrt(np.mean([getattr(each, sigmas) ** 2 for each in found], axis=0))
        assert said == pytest.approx(scatter, rel=0.35)
        if values == "point_px":
            assert (scatter > 0.004).all()
            assert (scatter < 0.057).all()


@pytest.mark.parametrize(
    ("kind", "name"), list(zip(TARGETS, ["simulated", "physical"] * 2, strict=True))
)
def test_a_target_at_rest_is_tracked_while_neck_and_eyes_swing_and_the_camera_jerks(kind, name):
    """At 30 images a second, and by 100 mrad from image to image: only the first is searched."""
    head, (camera, rendering) = load_head(name), rig(name)
    target, rng = TARGETS[kind], np.random.default_rng(0)
    detector = Watched(target, camera)
    tracker, T_0_T, seen = Tracker(detector), None, []
    for step in range(8):
        rates = 2.0 * np.pi * np.linspace(0.5, 1.1, len(head.rest()))
        q = head.rest() + 0.06 * np.sin(step / 30.0 * rates)
        jerk = pose(0, 0, 0, (0.07 * (step % 2), 0, 0.07 * (step // 2 % 2)))
        T_0_C = head.base_pose(q) @ head.camera_poses(q)[0] @ jerk
        if T_0_T is None:
            T_0_T = T_0_C @ pose(0.02, 0.01, 0.9, (0.1, 0.2, 0.1))
        one = scene(camera, target, np.linalg.inv(T_0_C) @ T_0_T, rendering, rng)
        found = tracker.find(one.image, T_0_C=T_0_C)
        assert found.point_px == pytest.approx(one.point, abs=0.3)
        if step:
            assert detector.looked[-1] == pytest.approx(one.point, abs=1.0)
        seen.append(one.point)
    assert np.abs(np.diff(seen, axis=0)).max() > 30.0


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_a_shadow_that_comes_over_a_tag_does_not_end_its_track(angle):
    """From even light into half shadow while the tag moves by 3 px an image."""
    tracker, rng = Tracker(make_detector(TAG, CAMERA)), np.random.default_rng(2)
    for step in range(12):
        one = scene(CAMERA, TAG, pose(0.005 * step, 0, 1.0, (0.2, 0.1, 0)), RENDERING, rng)
        shaded = shadow(0.5, angle)(one.image, one.point + 3.0 * step - 20)
        found = tracker.find(one.image if step < 2 else shaded, search=step == 0)
        assert found.corners_px == pytest.approx(one.corners, abs=0.3)


@pytest.mark.parametrize(
    ("kind", "y", "depth_m"),
    [("tag", -0.6, 4.5), ("tag", -0.05, 1.0), ("tag", 0.0, 4.5), ("tag", 0.6, 1.0),
     ("checkerboard", 0.1, 1.0), ("charuco", 0.1, 1.0), ("aprilgrid", 0.1, 1.0)],
)  # fmt: skip
def test_a_lost_target_is_found_within_four_images_wherever_it_is(kind, y, depth_m):
    target, rng = TARGETS[kind], np.random.default_rng(3)
    tracker = Tracker(make_detector(target, CAMERA))
    one = scene(CAMERA, target, pose(0.1, y * depth_m, depth_m), RENDERING, rng)
    for empties in range(1, 5):
        for _ in range(empties):
            assert tracker.find(EMPTY) is None
        finds = [tracker.find(one.image) for _ in range(4)]
        assert finds[-1].point_px == pytest.approx(one.point, abs=0.2)
        tracker.forget()
