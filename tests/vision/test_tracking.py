"""Tracking: near the prediction while the target is followed, also by a head that moves itself.

Everywhere once it is lost.
"""

import numpy as np
import pytest

from tests.vision.poses import pose
from tests.vision.scenes import rig, scene, shadow
from vergence import load_head
from vergence.models.parts import Rendering
from vergence.vision import (
    AprilGrid,
    AprilTag,
    Camera,
    CharucoBoard,
    Checkerboard,
    TargetRenderer,
    Tracker,
    make_detector,
)

TARGETS = {
    "tag": AprilTag(),
    "checkerboard": Checkerboard(),
    "charuco": CharucoBoard(columns=5, rows=4, square_m=0.04),
    "aprilgrid": AprilGrid(columns=4, rows=3, tag_m=0.04),
}


@pytest.fixture
def drawing(pinhole: Camera, rendering: Rendering) -> TargetRenderer:
    return TargetRenderer(pinhole, TARGETS["tag"], rendering)


class Watched:
    """A detector that keeps where it was told to look; None for the whole image."""

    def __init__(self, target, camera) -> None:
        self._detector = make_detector(target, camera)
        self.target, self.camera = target, camera
        self.looked = []

    def search(self, image, near_px, way):
        self.looked.append(None)
        return self._detector.search(image, near_px, way)

    def track(self, image, predicted):
        self.looked.append(tuple(predicted.point_px))
        return self._detector.track(image, predicted)


def watched(drawing: TargetRenderer) -> tuple[Watched, Tracker]:
    detector = Watched(drawing.target, drawing.camera)
    return detector, Tracker(detector)


def images(drawing: TargetRenderer, *x: float) -> list[np.ndarray]:
    """The target at places from left to right, 1 m ahead."""
    out = []
    for where in x:
        drawing.draw(pose(where, 0.0, 1.0))
        out.append(drawing.frame.copy())
    return out


def test_the_target_is_expected_where_its_motion_takes_it(drawing):
    detector, tracker = watched(drawing)
    x = (0.0, 0.03, 0.06)
    first, second, _third = (tracker.find(image).point_px for image in images(drawing, *x))
    whole, once, moved = detector.looked
    assert whole is None
    assert once == tuple(first)
    assert moved == pytest.approx(2.0 * second - first)


def test_a_prediction_takes_the_place_of_the_motion(drawing):
    detector, tracker = watched(drawing)
    still, moved = images(drawing, 0.0, 0.2)
    tracker.find(still)
    assert tracker.find(moved, (640.0, 430.0)) is not None
    assert detector.looked[1:] == [(640.0, 430.0)]


def test_a_target_that_jumps_is_searched_in_the_whole_image(drawing):
    detector, tracker = watched(drawing)
    here, far = images(drawing, 0.0, 0.5)
    last = tracker.find(here).point_px
    found = tracker.find(far).point_px
    assert found == pytest.approx(drawing.camera.project([[0.5, 0.0, 1.0]])[0], abs=0.1)
    assert detector.looked == [None, tuple(last), None]


def test_a_lost_target_is_searched_anew(drawing):
    detector, tracker = watched(drawing)
    here, empty = *images(drawing, 0.0), np.full_like(drawing.frame, 120)
    for lose in (lambda: tracker.find(empty), tracker.forget):
        tracker.find(here)
        assert lose() is None
        detector.looked.clear()
        assert tracker.find(here) is not None
        assert detector.looked == [None]


def test_an_image_known_to_be_empty_need_not_be_searched(drawing):
    detector, tracker = watched(drawing)
    assert tracker.find(drawing.frame, search=False) is None
    assert detector.looked == []


def test_a_motion_of_the_camera_counts_by_the_targets_distance(drawing):
    """A camera that moves by 20 mm sees a target at 0.5 m move by f / 25."""
    detector, tracker = watched(drawing)
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


def swinging(name: str, count: int, swing_rad: float) -> np.ndarray:
    """(n, 4, 4) T_0_C of the left eye at 30 images a second, each joint at its own rate."""
    head = load_head(name)
    seconds = np.arange(count)[:, None] / 30.0
    rates = 2.0 * np.pi * np.linspace(0.5, 1.1, len(head.rest()))
    q = head.rest() + swing_rad * np.sin(seconds * rates)
    return np.stack([head.base_pose(each) @ head.camera_poses(each)[0] for each in q])


@pytest.mark.parametrize(
    ("name", "kind"), list(zip(["simulated", "physical"] * 2, TARGETS, strict=True))
)
def test_a_target_at_rest_is_tracked_while_neck_and_eyes_swing(name, kind):
    """At 30 images a second, up to 15 px from image to image: only the first is searched."""
    camera, rendering = rig(name)
    target, rng = TARGETS[kind], np.random.default_rng(0)
    poses = swinging(name, 14, 0.06)
    T_0_T = poses[0] @ pose(0.02, 0.01, 0.9, (0.1, 0.2, 0.1))
    detector = Watched(target, camera)
    tracker, moved = Tracker(detector), []
    for T_0_C in poses:
        one = scene(camera, target, np.linalg.inv(T_0_C) @ T_0_T, rendering, rng)
        found = tracker.find(one.image, T_0_C=T_0_C)
        assert found.point_px == pytest.approx(one.point, abs=0.3)
        moved.append(one.point)
    assert np.abs(np.diff(moved, axis=0)).max() > 4.0
    assert detector.looked.count(None) == 1


@pytest.mark.parametrize(("kind", "axis"), list(zip(TARGETS, [0, 1, 2, 0], strict=True)))
def test_a_camera_that_turns_by_100_mrad_between_images_tracks_by_its_pose(kind, axis):
    """62 px, or a roll about the axis."""
    camera, rendering = rig("simulated")
    target, turn = TARGETS[kind], np.zeros(3)
    turn[axis] = 0.1
    detector = Watched(target, camera)
    tracker, T_0_C, T_0_T = Tracker(detector), np.eye(4), pose(0.02, 0.01, 1.0, (0.1, 0.2, 0))
    for step in range(4):
        one = scene(camera, target, np.linalg.inv(T_0_C) @ T_0_T, rendering)
        found = tracker.find(one.image, T_0_C=T_0_C)
        assert found.point_px == pytest.approx(one.point, abs=0.2)
        assert detector.looked.count(None) == 1
        # there and back again
        T_0_C = T_0_C @ pose(0, 0, 0, tuple(turn if step % 2 == 0 else -turn))


@pytest.mark.slow
@pytest.mark.parametrize("kind", TARGETS)
def test_a_target_that_was_hidden_is_found_again_where_it_then_is(kind):
    camera, rendering = rig("simulated")
    target, rng = TARGETS[kind], np.random.default_rng(1)
    tracker = Tracker(make_detector(target, camera))
    empty = scene(camera, target, pose(0, 0, -1.0), rendering).image
    for x in (-0.2, 0.25):
        for step in range(3):
            one = scene(camera, target, pose(x + 0.01 * step, 0.02, 1.0), rendering, rng)
            found = tracker.find(one.image)
            if found is None:  # one way of searching an image
                assert step == 0
                continue
            assert found.point_px == pytest.approx(one.point, abs=0.2)
        assert tracker.find(empty) is None
        assert tracker.find(empty) is None


def test_a_target_beyond_the_eye_is_not_expected_anywhere_else():
    """A camera that turned its back sees nothing, and does not fail."""
    camera, rendering = rig("simulated")
    tracker = Tracker(make_detector(TARGETS["tag"], camera))
    one = scene(camera, TARGETS["tag"], pose(0.0, 0.0, 1.0), rendering)
    assert tracker.find(one.image, T_0_C=np.eye(4)) is not None
    empty = np.full_like(one.image, 120)
    assert tracker.find(empty, T_0_C=pose(0, 0, 0, (0, np.pi, 0))) is None
    assert tracker.find(one.image, T_0_C=np.eye(4)) is not None


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_a_shadow_that_comes_over_a_tag_does_not_end_its_track(angle):
    """From even light into half shadow while the tag moves by 3 px an image."""
    camera, rendering = rig("simulated")
    rng, tracker = np.random.default_rng(2), Tracker(make_detector(TARGETS["tag"], camera))
    for step in range(12):
        place = pose(0.005 * step, 0, 1.0, (0.2, 0.1, 0))
        one = scene(camera, TARGETS["tag"], place, rendering, rng)
        image, at = one.image, one.point + 3.0 * step - 20
        found = tracker.find(image if step < 2 else shadow(0.5, angle)(image, at), search=step == 0)
        assert found.corners_px == pytest.approx(one.corners, abs=0.3)


@pytest.mark.parametrize(("y", "depth_m"), [(-0.6, 4.5), (-0.05, 1.0), (0.0, 4.5), (0.6, 1.0)])
def test_a_lost_tag_of_any_size_is_found_within_four_images_wherever_it_is(y, depth_m):
    camera, rendering = rig("simulated")
    tracker = Tracker(make_detector(TARGETS["tag"], camera))
    empty = scene(camera, TARGETS["tag"], pose(0, 0, -1.0), rendering).image
    place, rng = pose(0.1, y * depth_m, depth_m), np.random.default_rng(3)
    one = scene(camera, TARGETS["tag"], place, rendering, rng)
    for empties in range(1, 5):
        for _ in range(empties):
            assert tracker.find(empty) is None
        finds = [tracker.find(one.image) for _ in range(4)]
        assert finds[-1].point_px == pytest.approx(one.point, abs=0.2)
        tracker.forget()
