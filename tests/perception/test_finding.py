"""Several targets in one image, each once, and in live images: found, followed and counted."""

import cv2
import numpy as np
import pytest

from tests.naming import refused
from tests.perception.drawn import Studio, corners_in_space, pose_at
from vergence import load_head
from vergence.errors import ConfigurationError
from vergence.perception.finding import (
    FamilyTracker,
    LiveStatistics,
    TargetFinder,
    make_live_finder,
    parse_targets,
    tag_number,
    watch_targets,
)
from vergence.perception.locate import _match
from vergence.vision import BoardDetection, Camera, make_detector
from vergence.vision.objects.targets import parse_gaze_target
from vergence.vision.targets import AprilTag, Checkerboard, TagFamily

HEAD = load_head("physical")


def side_by_side(*tags: int) -> list[np.ndarray]:
    """Both eyes' images of two tags, one in either half."""
    halves = []
    for tag, x in zip(tags, (-0.12, 0.12), strict=True):
        studio = Studio(HEAD, AprilTag(id=tag, edge_m=0.1))
        halves.append(studio.take(pose_at([x, -0.05, 0.8]), np.random.default_rng(tag)))
    # the eyes' axes are parallel: seen from either eye the tags stand 2 x 120 mm apart, and the
    # middle between them is shifted by half of the baseline
    images = []
    for eye in range(2):
        middle = int(HEAD.project(HEAD.rest(), [0.0, -0.05, 0.8])[eye, 0])
        images.append(np.hstack([halves[0][eye][:, :middle], halves[1][eye][:, middle:]]))
    return images


@pytest.mark.slow
def test_a_family_is_found_by_number_and_a_stated_tag_keeps_its_size():
    image = side_by_side(7, 3)[0]
    found = TargetFinder(parse_targets(["tag:36h11:7:100", "tag:36h11"])).find(image)
    assert [str(one.target) for one in found] == ["tag:36h11:7:100", "tag:36h11:3"]
    found = TargetFinder(parse_targets(["tag:36h11"])).find(image)
    assert [tag_number(one.target) for one in found] == [3, 7]
    for texts in ([], ["tag"], ["nothing:1"]):
        refused("target: expected", parse_targets, texts)


@pytest.mark.slow
def test_tags_are_matched_by_number_and_one_that_is_there_twice_is_not():
    finders = [
        TargetFinder(parse_targets(["tag:36h11::100"]), Camera.of(HEAD, e)) for e in range(2)
    ]
    left, right = (s.find(i) for s, i in zip(finders, side_by_side(7, 3), strict=True))
    located, missed = _match(HEAD, HEAD.rest(), "a", left, right)
    assert missed == []
    for one, x in zip(located, (0.12, -0.12), strict=True):
        np.testing.assert_allclose(one.centre.point, [x, -0.05, 0.8], atol=0.02)
        assert abs(one.centre.point[0] - x) < 0.002
    left, right = (s.find(i) for s, i in zip(finders, side_by_side(7, 7), strict=True))
    assert len(left) == len(right) == 2
    located, missed = _match(HEAD, HEAD.rest(), "a", left, right)
    assert located == []
    assert [(str(one.target), one.seen_in) for one in missed] == [("tag:36h11:7:100", "twice")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("head", "name", "place", "turn", "least"),
    [
        ("physical", "charuco:6x5:30:22:4X4_50", [0.0, -0.05, 0.6], [0.0, 0.0, 0.0], 16),
        ("simulated", "aprilgrid:5x4:30:0.3", [0.0, -0.02, 0.4], [0.2, 0.1, 0.1], 4 * 20),
    ],
)
def test_a_board_of_markers_is_one_target_whose_edges_are_as_stated(head, name, place, turn, least):
    head, targets, pose = load_head(head), parse_targets([name]), pose_at(place, turn)
    images = Studio(head, targets[0]).take(pose, np.random.default_rng(0))
    found = [TargetFinder(targets, Camera.of(head, e)).find(images[e]) for e in range(2)]
    assert [len(each) for each in found] == [1, 1]
    (one,), _ = _match(head, head.rest(), "a", *found)
    assert one.valid.sum() >= least
    assert one.spacing.mean_m == pytest.approx(0.03, rel=0.005)
    assert (np.abs(one.centre.point - place) < 4.0 * one.centre.sigma).all()
    if name.startswith("aprilgrid"):
        errors = one.fix.point - corners_in_space(targets[0], pose)
        assert np.sqrt(np.mean((errors / one.fix.sigma) ** 2)) < 1.5
        assert one.spacing.edge_count == 4 * 20  # edges of tags; the gaps between them are no edges


BOTH = side_by_side(7, 3)[0]
NOTHING = np.full_like(BOTH, 110)
MIDDLE = int(HEAD.project(HEAD.rest(), [0.0, -0.05, 0.8])[0, 0])
LEFT_ALONE = np.hstack([BOTH[:, :MIDDLE], NOTHING[:, MIDDLE:]])
TAG, OTHER = AprilTag(id=5), AprilTag(id=6)


def at(u, v, target=TAG):
    return BoardDetection(
        target, np.array([u, v]), np.zeros((4, 2)), np.full(2, 0.1), np.zeros((4, 2))
    )


def test_rates_noise_and_points_are_of_the_window_and_of_the_whole_run():
    rng = np.random.default_rng(1)
    statistics = LiveStatistics([TAG], window_s=1.0)
    points = rng.normal([5000.0, 240.0], [0.4, 0.1], (400, 2))
    points[200:] += 3.0  # the camera was bumped half way
    times_s = np.concatenate([0.05 * np.arange(200), 10.0 + 0.1 * np.arange(200)])
    for image, (time_s, point) in enumerate(zip(times_s, points, strict=True)):
        statistics.add(time_s, 0.02, [at(*point)] if image % 2 else [])
    run, window = statistics.run_summary(), statistics.window_summary()
    (tag,), (last,) = run.targets, window.targets
    assert (run.images, run.seconds) == (400, pytest.approx(29.92))
    assert (run.frame_rate_hz, window.frame_rate_hz) == pytest.approx((399 / 29.9, 10.0))
    assert (run.detection_ms, window.detection_ms) == pytest.approx((20.0, 20.0))
    assert (tag.images_with_target, tag.images, tag.rate) == (200, 400, 0.5)
    assert (last.images_with_target, last.images) == (6, 11)
    assert tag.document()["images_without"] == 200
    np.testing.assert_allclose(tag.noise_px, points[1::2].std(axis=0, ddof=1), rtol=1e-9)
    np.testing.assert_allclose(tag.point_px, points[1::2].mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(tag.sigma_px, 0.1, rtol=1e-9)
    # the window has images after the bump alone: their noise by itself
    assert (last.noise_px < 1.0).all()
    assert (tag.noise_px > 1.4).all()


def test_targets_that_were_asked_for_are_shown_unseen_and_others_once_seen():
    board = Checkerboard()
    statistics = LiveStatistics([board])
    assert statistics.window_summary().document()["targets"][0]["detection_rate"] == 0.0
    statistics.add(0.0, 0.01, [at(1.0, 1.0), at(2.0, 2.0, OTHER)])
    document = statistics.window_summary().document()
    assert [row["id"] for row in document["targets"]] == [None, 5, 6]
    assert document["frame_rate_hz"] is None
    assert document["targets"][1]["noise_px"] is None
    assert document["targets"][0]["point_px"] is None


def test_watching_ends_with_the_time_or_with_the_images():
    now = [0.0]

    def find(image):
        now[0] += 0.25
        return [at(float(image[0, 0]), 0.0)]

    images = [np.full((2, 2), i, np.uint8) for i in range(12)]
    shown = []
    for seconds, over, count in ((1.0, True, 4), (None, False, 12)):
        statistics = LiveStatistics()
        ended = watch_targets(
            images, [find], statistics, lambda: now[0], time_limit_s=seconds, on_update=shown.append
        )
        assert (ended, statistics.window_summary().images) == (over, count)
    assert [state.images for state in shown] == [4, 4, 8, 12]


class Counting:
    """A family's detector that counts its searches of whole images."""

    def __init__(self) -> None:
        self.own, self.full, self.quick = make_detector(TagFamily()), 0, 0
        self.track = self.own.track

    def detect_all(self, image):
        self.full += 1
        return self.own.detect_all(image)

    def search(self, image):
        self.quick += 1
        return self.own.search(image)


def numbers(found):
    return sorted(each.target.id for each in found)


@pytest.mark.slow
def test_tags_that_stay_are_followed_and_found_in_every_image():
    counting = Counting()
    find = FamilyTracker(counting)
    for shift in range(17):
        image = np.roll(BOTH, shift, axis=1)
        found = find(image)
        assert numbers(found) == [3, 7]
        for each, true in zip(found, counting.own.detect_all(image), strict=True):
            np.testing.assert_allclose(each.point_px, true.point_px, atol=0.05)
    assert (counting.full, counting.quick) == (2, 0)


@pytest.mark.slow
def test_tags_that_blink_are_found_whenever_they_are_there():
    find = FamilyTracker(Counting())
    for image in [BOTH, BOTH, NOTHING] * 7:
        assert numbers(find(image)) == ([] if image is NOTHING else [3, 7])


@pytest.mark.slow
def test_a_tag_that_comes_is_found_at_once_or_soon_and_one_that_went_is_soon_given_up():
    counting = Counting()
    find = FamilyTracker(counting)
    for _ in range(20):
        assert numbers(find(NOTHING)) == []
    assert [len(find(LEFT_ALONE)) for _ in range(2)] == [1, 1]
    assert len([find(BOTH) for _ in range(16)][-1]) == 2
    for _ in range(40):
        find(LEFT_ALONE)
    before = counting.full
    assert [len(find(LEFT_ALONE)) for _ in range(30)] == [1] * 30
    assert counting.full - before == 2


def test_each_target_has_its_finder():
    one_tag = make_detector(TagFamily()).detect_all(BOTH)[0].target
    finders = [make_live_finder(target) for target in (TagFamily(), one_tag)]
    assert [numbers(find(BOTH)) for find in finders] == [[3, 7], [3]]


def test_a_colour_is_found_in_live_images_whether_a_camera_is_known_or_not():
    image = np.full((120, 160, 3), 90, np.uint8)
    cv2.circle(image, (60, 50), 9, (0, 128, 255), -1)
    target = parse_gaze_target("colour:#ff8000")
    statistics = LiveStatistics([target])
    finder = make_live_finder(target)
    for k in range(3):
        statistics.add(0.1 * k, 0.01, finder(image))
    (one,) = statistics.run_summary().targets
    assert one.rate == 1.0
    assert np.abs(one.point_px - [60.0, 50.0]).max() < 0.2
    assert one.document()["target"] == "colour:#ff8000"
    assert finder(np.full((120, 160), 90, np.uint8)) == []
    with pytest.raises(ConfigurationError, match="single image shows"):
        make_live_finder(parse_gaze_target("point:left:1:2"))
