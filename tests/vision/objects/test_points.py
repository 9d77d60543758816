"""Both eyes stay on one point: the eye that was clicked leads, the other one agrees."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from tests.vision.objects import scenes
from vergence.errors import PointRefusedError
from vergence.vision.objects.points import PointSearch, PointSeed
from vergence.vision.objects.targets import PointTarget

ONE = scenes.rig("physical", (0.0, 0.0, 0.8))
FIRST, SECOND = np.array([330.3, 240.7]), np.array([420.0, 180.0])
FRAME_S = 1 / 120


@lru_cache
def world() -> list[scenes.Card]:
    light = scenes.noise_texture(np.random.default_rng(0), 512, 0.5)
    return [scenes.card(ONE, (0, 0, 0.8), (0.1, 0.3, 0), 1.0, light)]


@lru_cache
def image(eye: int, seed: int = 0) -> np.ndarray:
    return scenes.paint(
        ONE.cameras[eye], ONE.poses[eye], world(), ONE.rendering, np.random.default_rng(seed + eye)
    )


PLAIN = np.full((480, 640), 110, np.uint8)


def partner(pixel, eye: int = 0) -> np.ndarray:
    """True pixel in the other eye."""
    return scenes.seen_from(ONE, world(), pixel, eye)[1]


class Eyes:
    """Searches of both eyes, and their time."""

    def __init__(self, pixel=FIRST, eye: int = 0) -> None:
        self.seed = PointSeed(ONE.cameras, PointTarget())
        self.searches = PointSearch(0, self.seed), PointSearch(1, self.seed)
        self.time_s = 0.0
        if pixel is not None:
            self.seed.click(eye, pixel)

    def look(self, eye: int, shown=None, pose=None):
        pose = ONE.poses[eye] if pose is None else pose
        self.searches[eye].look(image(eye) if shown is None else shown, pose, self.time_s)
        detection = self.searches[eye].found().detection
        return None if detection is None else detection.pixel

    def both(self, left=None, right=None):
        self.time_s += FRAME_S
        return self.look(0, left), self.look(1, right)


@pytest.mark.parametrize("eye", [0, 1])
def test_a_click_in_either_eye_is_followed_in_both(eye):
    pixel = FIRST if eye == 0 else partner(FIRST)
    eyes = Eyes(pixel, eye)
    for _ in range(3):
        seen = eyes.both()
    assert seen[eye] == pytest.approx(pixel, abs=0.1)
    assert seen[1 - eye] == pytest.approx(partner(pixel, eye), abs=0.3)
    assert eyes.seed.remark == ""


def test_a_click_makes_both_eyes_forget_the_old_point_at_once():
    eyes = Eyes()
    eyes.both()
    eyes.seed.click(0, SECOND)
    assert eyes.look(1) is None  # its image comes before that of the eye that was clicked
    left, right = eyes.both()
    assert left == pytest.approx(SECOND, abs=0.1)
    assert right == pytest.approx(partner(SECOND), abs=0.3)


def test_a_point_that_is_found_while_another_one_is_clicked_is_not_reported(monkeypatch):
    eyes = Eyes()
    eyes.both()
    tracker = eyes.searches[1]._tracker
    find = tracker.find

    def clicked(*arguments, **options):
        eyes.seed.click(0, SECOND)
        return find(*arguments, **options)

    monkeypatch.setattr(tracker, "find", clicked)
    assert eyes.look(1) is None
    assert eyes.seed.sights == [None, None]


def test_a_refused_click_is_told_and_nothing_is_seen():
    eyes = Eyes((3.0, 3.0))
    assert eyes.both() == (None, None)
    assert "border" in eyes.seed.remark
    assert eyes.both() == (None, None)


def test_a_refused_pixel_that_the_target_names_is_raised():
    seed = PointSeed(ONE.cameras, PointTarget(eye=0, pixel=(3.0, 3.0)))
    with pytest.raises(PointRefusedError, match="border"):
        PointSearch(0, seed).look(image(0), ONE.poses[0], 0.0)


def test_the_other_eye_is_matched_anew_where_it_leaves_the_epipolar_line():
    eyes = Eyes()
    eyes.both()
    moved = cv2.warpAffine(image(1), np.array([[1.0, 0, 0], [0, 1, 9]]), (640, 480))
    assert eyes.both(right=moved)[1] is None
    assert eyes.both()[1] == pytest.approx(partner(FIRST), abs=0.3)


def test_an_eye_that_lost_the_point_sees_nothing_and_finds_it_again():
    eyes = Eyes()
    eyes.both()
    for _ in range(3):
        left, right = eyes.both(PLAIN, PLAIN)
        assert left is None
        assert right is None
    left, right = eyes.both()
    assert left == pytest.approx(FIRST, abs=0.1)
    assert right == pytest.approx(partner(FIRST), abs=0.3)


def test_the_first_eye_finds_the_point_where_the_other_one_sees_it():
    eyes = Eyes()
    eyes.both()
    for _ in range(260):  # longer than it is searched by itself
        eyes.searches[0]._tracker._missed += 1
    assert eyes.both()[0] == pytest.approx(FIRST, abs=0.2)


def test_a_match_at_another_distance_is_refused_while_the_point_rests():
    eyes = Eyes()
    eyes.both()
    eyes.searches[1]._tracker.forget()
    there = eyes.seed.place
    assert np.linalg.norm(there[0] - scenes.seen_from(ONE, world(), FIRST)[0]) < 0.01
    towards = ONE.poses[0][:3, 3] + 0.7 * (there[0] - ONE.poses[0][:3, 3])
    eyes.seed.place = towards, there[1]
    eyes.time_s += FRAME_S
    assert eyes.look(1) is None
    assert "distance" in eyes.seed.remark


def test_eyes_that_are_not_in_step_are_matched_to_each_others_last_image():
    eyes = Eyes(partner(FIRST), 1)
    for eye in (0, 1, 0, 1):
        eyes.time_s += 0.5 * FRAME_S
        seen = eyes.look(eye)
    assert seen == pytest.approx(partner(FIRST), abs=0.1)
    assert eyes.look(0) == pytest.approx(FIRST, abs=0.3)


def test_forgetting_starts_again_from_the_targets_pixel():
    seed = PointSeed(ONE.cameras, PointTarget(eye=0, pixel=tuple(FIRST)))
    search = PointSearch(0, seed)
    seed.click(0, SECOND)
    search.look(image(0), ONE.poses[0], 0.0)
    seed.forget()
    search.forget()
    assert search.found() is None
    search.look(image(0), ONE.poses[0], FRAME_S)
    assert search.found().detection.pixel == pytest.approx(FIRST, abs=0.1)


def test_the_pixel_of_a_robots_target_waits_until_the_head_is_at_its_start():
    seed = PointSeed(ONE.cameras, PointTarget(eye=0, pixel=(5.0, 5.0)), waits=True)
    search = PointSearch(0, seed)
    search.look(image(0), ONE.poses[0], 0.0)  # too near the border to be followed
    assert search.found().detection is None
    seed.forget()
    with pytest.raises(PointRefusedError, match="border"):
        search.look(image(0), ONE.poses[0], FRAME_S)
