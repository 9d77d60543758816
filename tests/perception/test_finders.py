"""Families in live images: followed, and searched for no more than they have to be."""

import numpy as np
import pytest

from tests.perception.test_target_finder import HEAD, side_by_side
from vergence.perception.live import FamilyTracker, make_live_finders
from vergence.vision import make_detector
from vergence.vision.targets import TagFamily

BOTH = side_by_side(7, 3)[0]
NOTHING = np.full_like(BOTH, 110)
MIDDLE = int(HEAD.project(HEAD.rest(), [0.0, -0.05, 0.8])[0, 0])
LEFT_ALONE = np.hstack([BOTH[:, :MIDDLE], NOTHING[:, MIDDLE:]])


class Counting:
    """A family's detector that counts its searches of whole images."""

    def __init__(self) -> None:
        self.own, self.full, self.quick = make_detector(TagFamily()), 0, 0

    def detect_all(self, image):
        self.full += 1
        return self.own.detect_all(image)

    def search(self, image):
        self.quick += 1
        return self.own.search(image)

    def track(self, image, predicted):
        return self.own.track(image, predicted)


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
