"""Refusal of tags, and detectors that are copied and shared."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import Scene, cropped, glare, rig, rms, scene, several
from vergence.vision import AprilTag, TagFamily, make_detector

TAG = AprilTag()
SIDES = [(1, 0), (-1, 0), (0, 1), (0, -1)]


def test_a_half_hidden_tag_is_none_neither_found_nor_tracked():
    for roll, side, grey in some_of([0.0, 0.6, 2.2], SIDES, [0, 90, 255]):
        with named(roll, side, grey):
            camera, rendering = rig("simulated")
            one = cropped(scene(camera, TAG, pose(0.02, 0.01, 0.8, (0, 0, roll)), rendering))
            detector = make_detector(TAG)
            seen = detector.detect(one.image)
            rows, columns = np.indices(one.image.shape)
            beyond = (columns - one.point[0]) * side[0] + (rows - one.point[1]) * side[1] > 0
            near = np.hypot(columns - one.point[0], rows - one.point[1]) < 120
            hidden = np.where(beyond & near, grey, one.image).astype(np.uint8)
            assert detector.detect(hidden) is None
            assert detector.track(hidden, seen) is None


def at_side(side: tuple[int, int], beyond_px: float) -> Scene:
    """A tag whose edge is so far beyond a side of the image, or inside if negative."""
    camera, rendering = rig("simulated")
    half_px = 0.5 * TAG.edge_m * camera.focal[0]
    size = np.array([camera.width, camera.height])
    middle = 0.5 * (size - 1.0) + np.array(side) * (0.5 * size - half_px + beyond_px)
    x, y = (middle - camera.principal) / camera.focal
    return scene(camera, TAG, pose(x, y, 1.0), rendering)


@pytest.mark.parametrize(("side", "beyond_px"), list(zip(SIDES, [2.0, 12.0] * 2, strict=True)))
def test_a_tag_in_the_image_to_its_quiet_zone_is_found_and_one_that_the_edge_cuts_is_none(
    side, beyond_px
):
    """A side that is not in the image is nowhere."""
    detector, cut = make_detector(TAG, rig("simulated")[0]), at_side(side, beyond_px)
    assert detector.detect(cut.image) is None
    quiet_px = np.ptp(cut.corners[:, 0]) / 8.0
    one = at_side(side, -2.0 - quiet_px)
    found = detector.detect(one.image)
    assert found.corners_px == pytest.approx(one.corners, abs=0.1)
    assert detector.track(cut.image, found) is None


@pytest.mark.parametrize(
    ("x", "z", "turn"),
    [(0.307, 0.403, (-0.775, -0.054, 2.857)), (0.339, 0.451, (-0.264, -0.360, 0.445))],
)
def test_a_corner_just_beyond_the_images_edge_is_found_there_and_not_drawn_in(x, z, turn):
    """The AprilTag library draws it in."""
    camera, rendering = rig("simulated")
    one = scene(camera, TAG, pose(x, 0.02, z, turn), rendering)
    assert (one.corners[:, 0] > camera.width - 0.5).sum() == 1
    found = make_detector(TAG, camera).detect(one.image)
    assert found.corners_px == pytest.approx(one.corners, abs=0.05)


@pytest.mark.parametrize("away_px", [-1, 0, 2])
def test_a_tag_at_the_images_edge_is_found_with_a_sigma_as_large_as_its_error(away_px):
    camera, rendering = rig("simulated")
    rng, detector, errors = np.random.default_rng(4), make_detector(TAG), []
    for z in (0.4, 0.8):
        for turn in rng.uniform(-0.4, 0.4, (4, 3)):
            one = scene(camera, TAG, pose(0.0, 0.0, z, turn), rendering, rng)
            end = int(one.corners[:, 0].max() + 0.5) + 1 + away_px
            found = detector.detect(np.ascontiguousarray(one.image[:, :end]))
            errors.append((found.corners_px - one.corners) / found.corners_sigma_px)
    assert 0.5 < rms(errors) < 1.6


def test_glare_beside_the_tag_does_not_matter_and_on_it_may_hide_but_not_move_it():
    """Corners that are found are right to 0.1 px rms, and with a highlight on the tag to 0.3 px."""
    camera, rendering = rig("simulated")
    edge_px = TAG.edge_m * camera.focal[0] / 0.8
    one = scene(camera, TAG, pose(0.02, 0.01, 0.8, (0.1, 0.2, 0.3)), rendering)
    for angle, away in [(0.0, 1.1), (0.8, 2.5), (np.pi / 2, 1.1), (3.5, 1.5)]:
        with named(angle, away):
            image = glare(away * edge_px, 0.2 * edge_px, angle)(one.image, one.point)
            found = make_detector(TAG, camera).detect(image)
            assert rms(found.corners_px - one.corners) < 0.1
    one, detector, seen = cropped(one), make_detector(TAG), 0
    for away, angle, radius in some_of((0.0, 0.25, 0.4, 0.5, 0.7), (0.3, 2.2, 4.4), (0.05, 0.15)):
        image = glare(away * edge_px, radius * edge_px, angle)(one.image, one.point)
        found = detector.detect(image)
        if found is not None:
            seen += 1
            with named(away, angle, radius):
                assert found.corners_px == pytest.approx(one.corners, abs=0.3)
    assert seen > 0


@pytest.mark.parametrize("target", [TAG, TagFamily(family="16h5")], ids=str)
def test_a_copy_through_pickle_says_the_same(target):
    camera, rendering = rig("physical")
    one = scene(camera, AprilTag(family=target.family), pose(0.02, 0.01, 0.8), rendering)
    detector = make_detector(target, camera)
    before = pickle.loads(pickle.dumps(detector))
    (first,) = detector.detect_all(one.image)
    # one that has looked already holds what cannot be pickled
    for copy in (before, pickle.loads(pickle.dumps(detector))):
        assert copy.target == target
        assert copy.camera == camera
        (again,) = copy.detect_all(one.image)
        np.testing.assert_array_equal(again.corners_px, first.corners_px)
        np.testing.assert_array_equal(again.corners_sigma_px, first.corners_sigma_px)


@pytest.mark.slow
def test_two_threads_at_once_find_what_one_finds():
    camera, rendering = rig("physical")
    images = []
    for k in range(2):
        placed = [
            (AprilTag(id=10 * k + i), pose(-0.4 + 0.4 * i, 0.02 * k, 1.0, (0.1, 0.1 * i, 0.3 * k)))
            for i in range(3)
        ]
        images.append(several(camera, placed, rendering)[0])
    one = make_detector(TagFamily(), camera)
    alone = [one.detect_all(image) for image in images]

    def look(detector):
        return [detector.detect_all(image) for image in images for _ in range(2)]

    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(look, [one, one]))
    for found in both:
        for each, expected in zip(found, np.repeat(np.arange(2), 2), strict=True):
            for a, b in zip(each, alone[expected], strict=True):
                assert a.target == b.target
                np.testing.assert_array_equal(a.corners_px, b.corners_px)


@pytest.mark.parametrize("roll", [np.pi / 4.0, -np.pi / 4.0])
def test_two_tags_of_one_number_seen_flat_above_each_other_are_two(roll):
    """Their middles are nearer than half the long diagonal of either."""
    camera, rendering = rig("simulated")
    one = scene(camera, TAG, pose(0.0, 0.0, 0.5, (0.0, 0.0, roll)), rendering)
    height, width = one.image.shape
    flat = cv2.resize(one.image, (width, height // 4), interpolation=cv2.INTER_AREA)
    half = round(0.16 * np.ptp(one.corners[:, 0]))
    part = flat[round(one.point[1] / 4.0) - half :][: 2 * half]
    found = make_detector(TagFamily()).detect_all(np.vstack([part, part]))
    assert [each.target.id for each in found] == [TAG.id, TAG.id]
