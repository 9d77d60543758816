"""Points are followed and matched truly, and refused in words where they cannot be."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from tests.vision.objects import scenes
from vergence.errors import ConfigurationError, PointRefusedError
from vergence.vision.objects.patches import PointTracker
from vergence.vision.objects.points import match_point

ONE = scenes.rig("physical", (0.0, 0.0, 0.8))
CAMERA, PIXEL = ONE.cameras[0], np.array([330.3, 240.7])


@lru_cache
def world(kind: str = "noise") -> list[scenes.Card]:
    y, x = np.mgrid[:512, :512]
    light = {
        "noise": lambda: scenes.noise_texture(np.random.default_rng(0), 512, 0.5),
        "plain": lambda: np.full((64, 64), 0.4, np.float32),
        "edge": lambda: np.where(y < 256, 0.2, 0.6),
        "tiles": lambda: 0.3 + 0.3 * ((x // 8 + y // 8) % 2),
    }[kind]()
    return [scenes.card(ONE, (0, 0, 0.8), (0.1, 0.3, 0), 1.0, light.astype(np.float32))]


def painted(eye: int, near, kind: str = "noise", pose=None, **changes) -> np.ndarray:
    pose = ONE.poses[eye] if pose is None else pose
    rng = np.random.default_rng(eye + 1)
    return scenes.paint(
        ONE.cameras[eye], pose, world(kind), ONE.rendering, rng, near=near, reach_px=90, **changes
    )


@lru_cache
def pair(kind: str = "noise") -> tuple[np.ndarray, np.ndarray]:
    _, truth = scenes.seen_from(ONE, world(kind), PIXEL)
    return painted(0, PIXEL, kind), painted(1, truth, kind, gain=1.1, offset=-10.0)


def turned(angle_rad: float) -> np.ndarray:
    pose = ONE.poses[0].copy()
    pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(np.array([0.3, 1.0, 0.2]) * angle_rad)[0]
    return pose


def truth_at(pose: np.ndarray) -> np.ndarray:
    point, _ = scenes.seen_from(ONE, world(), PIXEL)
    return scenes.project(ONE._replace(poses=np.stack([pose, pose])), world(), point, 0)


def test_a_point_is_found_in_the_other_eye_despite_misread_encoders_gain_and_offset():
    point, truth = scenes.seen_from(ONE, world(), PIXEL)
    poses = scenes.misread(ONE, np.random.default_rng(4), 2.0)
    found = match_point(ONE.cameras, pair(), poses, PIXEL)
    assert found.pixel == pytest.approx(truth, abs=0.2)
    assert (np.abs(found.pixel - truth) < 4.0 * found.sigma_px).all()
    true = match_point(ONE.cameras, pair(), ONE.poses, PIXEL)
    assert true.depth_m == pytest.approx(np.linalg.norm(point - ONE.poses[0][:3, 3]), rel=0.01)


def test_a_match_leads_back_from_the_other_eye():
    there = match_point(ONE.cameras, pair(), ONE.poses, PIXEL)
    back = match_point(ONE.cameras, pair(), ONE.poses, there.pixel, eye=1)
    assert back.pixel == pytest.approx(PIXEL, abs=0.2)


def test_a_wrong_near_depth_does_not_force_a_match():
    found = match_point(ONE.cameras, pair(), ONE.poses, PIXEL)
    misled = match_point(ONE.cameras, pair(), ONE.poses, PIXEL, near_depth_m=0.4)
    assert misled.pixel == pytest.approx(found.pixel, abs=0.05)


@pytest.mark.parametrize(
    ("kind", "words"),
    [("plain", "textureless"), ("edge", "textureless"), ("tiles", "repeating")],
)
def test_what_cannot_be_told_apart_is_refused_in_words(kind, words):
    with pytest.raises(PointRefusedError, match=words):
        match_point(ONE.cameras, pair(kind), ONE.poses, PIXEL)
    with pytest.raises(PointRefusedError, match=words):
        PointTracker(CAMERA).begin(pair(kind)[0], PIXEL, ONE.poses[0])


def test_a_point_that_the_other_eye_does_not_see_is_refused():
    left, right = pair()
    with pytest.raises(PointRefusedError, match="nothing like it"):
        match_point(ONE.cameras, (left, np.flipud(right)), ONE.poses, PIXEL)


def test_a_point_outside_of_the_image_or_at_its_border_is_refused():
    tracker, image = PointTracker(CAMERA), pair()[0]
    with pytest.raises(PointRefusedError, match="border"):
        tracker.begin(image, (5.0, 200.0), ONE.poses[0])
    with pytest.raises(PointRefusedError, match="640 x 480"):
        tracker.begin(image, (700.0, 200.0), ONE.poses[0])


def test_a_point_is_followed_while_the_eye_turns_and_encoders_err():
    tracker, rng = PointTracker(CAMERA), np.random.default_rng(0)
    tracker.begin(pair()[0], PIXEL, ONE.poses[0])
    for step in range(1, 6):
        pose = turned(0.03 * step)
        truth = truth_at(pose)
        read = scenes.misread(ONE._replace(poses=np.stack([pose, pose])), rng, 2.0)[0]
        found = tracker.find(painted(0, truth, pose=pose, smear_px=(2.0, 1.0)), read)
        assert found.pixel == pytest.approx(truth, abs=0.3)
        assert (found.sigma_px < 0.3).all()


def test_a_hidden_point_is_not_seen_and_found_again():
    tracker, image = PointTracker(CAMERA), pair()[0]
    tracker.begin(image, PIXEL, ONE.poses[0])
    hidden = painted(0, PIXEL, "plain")
    assert all(tracker.find(hidden, ONE.poses[0]) is None for _ in range(3))
    assert tracker.find(image, turned(0.05)).pixel == pytest.approx(PIXEL, abs=0.1)


def test_a_template_that_was_renewed_returns_to_the_first_one():
    tracker, image = PointTracker(CAMERA), pair()[0]
    tracker.begin(image, PIXEL, ONE.poses[0])
    y, x = np.mgrid[-240:240, -320:320]
    stain = 70.0 * np.exp(-((x + 240 - 234.0) ** 2 + (y - 4.0) ** 2) / 30.0)
    soiled = np.clip(image - stain, 0, 255).astype(np.uint8)
    stained = [tracker.find(soiled, ONE.poses[0]) for _ in range(20)]
    assert all(each is None or np.hypot(*(each.pixel - PIXEL)) < 0.5 for each in stained)
    clean = [tracker.find(image, ONE.poses[0]) for _ in range(5)][-1]
    assert clean.pixel == pytest.approx(PIXEL, abs=0.02)
    assert (clean.sigma_px < 0.1).all()


def ball(half_px: float, rng: np.random.Generator):
    """Images of a ball without texture, 5 px an image against what is behind it."""
    grid = rng.normal(size=(75, 100)).astype(np.float32)
    behind = 115 + 25 * cv2.resize(grid, (800, 600), interpolation=cv2.INTER_CUBIC)
    y, x = np.mgrid[:480, :640].astype(np.float32)
    step = np.array([4.0, 3.0])
    for k in range(13):
        centre = np.array([320.4, 240.2]) + 0.6 * k * step
        shift = np.array([[1, 0, -60 - 0.4 * k * step[0]], [0, 1, -40 - 0.4 * k * step[1]]])
        cover = np.clip(half_px - np.hypot(x - centre[0], y - centre[1]) + 0.5, 0, 1)
        light = cover * 200 + (1 - cover) * cv2.warpAffine(behind, shift, (640, 480))
        grey = cv2.GaussianBlur(light, (0, 0), 0.7) + rng.normal(0, 4, light.shape)
        yield np.clip(np.rint(grey), 0, 255).astype(np.uint8), centre


@pytest.mark.parametrize("half_px", [6, 12, 30, 60])
def test_an_object_without_texture_is_carried_by_its_outline(half_px):
    tracker, seen = PointTracker(CAMERA), 0
    for k, (image, centre) in enumerate(ball(half_px, np.random.default_rng(half_px))):
        if k == 0:
            tracker.begin(image, centre, ONE.poses[0], half_px=half_px, checked=False)
            continue
        found = tracker.find(image, ONE.poses[0])
        if found is not None:
            assert np.hypot(*(found.pixel - centre)) < 1.5
            seen += 1
    assert seen >= (10 if half_px >= 12 else 0)


def test_what_is_not_checked_may_repeat_and_reach_over_the_border():
    tracker = PointTracker(CAMERA)
    tracker.begin(pair("tiles")[0], PIXEL, ONE.poses[0], checked=False)
    image = np.roll(pair()[0], (-236, -326), axis=(0, 1))
    at = PIXEL - (326, 236)
    with pytest.raises(PointRefusedError, match="border"):
        tracker.begin(image, at, ONE.poses[0])
    tracker.begin(image, at, ONE.poses[0], checked=False)
    assert tracker.find(image, ONE.poses[0]).pixel == pytest.approx(at, abs=0.1)
    with pytest.raises(PointRefusedError, match="640 x 480"):
        tracker.begin(image, (-1.0, 5.0), ONE.poses[0], checked=False)


def test_the_error_of_the_first_pixel_stays_in_the_standard_deviations():
    tracker, image = PointTracker(CAMERA), pair()[0]
    known = tracker.begin(image, PIXEL, ONE.poses[0]).sigma_px
    tracker.begin(image, PIXEL, ONE.poses[0], sigma_px=(0.3, 0.4))
    found = tracker.find(image, ONE.poses[0])
    assert found.sigma_px == pytest.approx([0.3, 0.4], abs=3 * known.max())
    assert (found.sigma_px > (0.3, 0.4)).all()


def test_nothing_is_found_before_a_point_is_given_and_after_it_is_dropped():
    tracker, image = PointTracker(CAMERA), pair()[0]
    assert tracker.find(image, ONE.poses[0]) is None
    tracker.begin(image, PIXEL, ONE.poses[0])
    tracker.forget()
    assert tracker.find(image, ONE.poses[0]) is None


def test_wrong_arguments_are_refused():
    for change, words in (({"eye": 2}, "eye"), ({"depth_range_m": (0.0, 1.0)}, "depth_range_m"),
                          ({"near_depth_m": -1.0}, "near_depth_m")):  # fmt: skip
        with pytest.raises(ConfigurationError, match=words):
            match_point(ONE.cameras, pair(), ONE.poses, PIXEL, **change)
    with pytest.raises(ConfigurationError, match="half_px"):
        PointTracker(CAMERA).begin(pair()[0], PIXEL, ONE.poses[0], half_px=0.0)
