"""Live statistics: rates over a window of time, noise as it is, none without enough images."""

import numpy as np
import pytest

from tests.perception.test_target_finder import HEAD, side_by_side
from vergence.perception.finding import (
    FamilyTracker,
    LiveStatistics,
    make_live_finders,
    watch_targets,
)
from vergence.vision import Detection, make_detector
from vergence.vision.targets import AprilTag, Checkerboard, TagFamily

BOTH = side_by_side(7, 3)[0]
NOTHING = np.full_like(BOTH, 110)
MIDDLE = int(HEAD.project(HEAD.rest(), [0.0, -0.05, 0.8])[0, 0])
LEFT_ALONE = np.hstack([BOTH[:, :MIDDLE], NOTHING[:, MIDDLE:]])
TAG, OTHER = AprilTag(id=5), AprilTag(id=6)


def at(u, v, target=TAG):
    return Detection(target, np.array([u, v]), np.zeros((4, 2)), np.full(2, 0.1), np.zeros((4, 2)))


def test_rates_are_of_the_window_and_totals_of_all():
    statistics = LiveStatistics([TAG], window_s=1.0)
    for image in range(40):
        statistics.add(0.1 * image, 0.02, [at(1.0, 2.0)] if image >= 20 and image % 2 else [])
    state = statistics.window_summary()
    (tag,) = state.targets
    assert (state.images, state.seconds) == (40, pytest.approx(3.92))
    assert state.frame_rate_hz == pytest.approx(10.0)
    assert state.detection_ms == pytest.approx(20.0)
    assert tag.rate == pytest.approx(0.5, abs=0.06)
    assert (tag.images_with_target, tag.images) == (6, 11)
    (tag,) = statistics.run_summary().targets
    assert (tag.images_with_target, tag.images, tag.rate) == (10, 40, 0.25)
    assert tag.document()["images_without"] == 30


def test_the_summary_is_over_the_whole_run():
    rng = np.random.default_rng(1)
    statistics = LiveStatistics([TAG], window_s=1.0)
    points = rng.normal([5000.0, 240.0], [0.4, 0.1], (400, 2))
    points[200:] += 3.0  # the camera was bumped half way
    for image, point in enumerate(points):
        statistics.add(
            0.05 * image if image < 200 else 10.0 + 0.1 * (image - 200), 0.01, [at(*point)]
        )
    (tag,), (last,) = statistics.run_summary().targets, statistics.window_summary().targets
    np.testing.assert_allclose(tag.noise_px, points.std(axis=0, ddof=1), rtol=1e-9)
    np.testing.assert_allclose(tag.point_px, points.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(tag.sigma_px, 0.1, rtol=1e-9)
    # the window has ten images after the bump: their noise by itself
    assert (last.noise_px < 1.0).all()
    assert (tag.noise_px > 1.4).all()
    assert statistics.run_summary().frame_rate_hz == pytest.approx(399 / 29.9)
    assert statistics.window_summary().frame_rate_hz == pytest.approx(10.0)


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
    for image in range(20):
        assert numbers(find(NOTHING if image % 3 == 2 else BOTH)) == (
            [] if image % 3 == 2 else [3, 7]
        )


def test_a_tag_that_comes_is_found_at_once_or_within_fifteen_images():
    find = FamilyTracker(Counting())
    for _ in range(20):
        assert numbers(find(NOTHING)) == []
    assert numbers(find(LEFT_ALONE)) == numbers(find(LEFT_ALONE))
    assert len(numbers(find(LEFT_ALONE))) == 1
    seen = [len(find(BOTH)) for _ in range(16)]
    assert seen[-1] == 2


@pytest.mark.slow
def test_a_tag_that_went_is_not_searched_for_for_ever():
    counting = Counting()
    find = FamilyTracker(counting)
    find(BOTH)
    for _ in range(40):
        find(LEFT_ALONE)
    before = counting.full
    for _ in range(30):
        assert len(find(LEFT_ALONE)) == 1
    assert counting.full - before == 2


def test_each_target_has_its_finder():
    finders = make_live_finders(
        [TagFamily(), next(iter(make_detector(TagFamily()).detect_all(BOTH))).target]
    )
    assert [numbers(find(BOTH)) for find in finders] == [[3, 7], [3]]
