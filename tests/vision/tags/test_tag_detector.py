"""Tags of every family: found upright and by their numbers, and refused where they are not."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pyapriltags
import pytest

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import (
    CAMERA,
    RENDERING,
    Scene,
    cropped,
    glare,
    rig,
    rms,
    scene,
    several,
    shifted,
)
from vergence.vision import AprilTag, TagFamily, make_detector
from vergence.vision.tag_families import CORRECTED_BITS, tag_family
from vergence.vision.targets import texture

TAG = AprilTag()
SIDES = [(1, 0), (-1, 0), (0, 1), (0, -1)]
FAMILIES = tuple(CORRECTED_BITS)
ROLLS = dict(zip(FAMILIES, [0.0, 0.8, np.pi / 2, np.pi, -1.0] * 2, strict=False))
CELL_M = 0.016


def tag(family: str, identity: int = 0) -> AprilTag:
    """Tag with cells of 10 px at 1 m before the simulated rig."""
    return AprilTag(family=family, id=identity, edge_m=CELL_M * tag_family(family).width_at_border)


def drawn(target: AprilTag, roll: float = 0.0, turn: tuple[float, float] = (0.0, 0.0)) -> Scene:
    T_C_T = pose(0.013, -0.021, 1.0) @ pose(0, 0, 0, (0, 0, roll)) @ pose(0, 0, 0, (*turn, 0))
    return scene(CAMERA, target, T_C_T, RENDERING, np.random.default_rng(1))


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_tag_is_found_by_its_number_its_upper_left_corner_first(family):
    """To 0.1 px: taken for another corner it would be beside by the edge, 60 px and more."""
    count, every = len(tag_family(family).code_words), TagFamily(family=family, edge_m=0.1)
    for identity in (0, count // 2, count - 1):
        target = tag(family, identity)
        one = drawn(target, ROLLS[family], (0.2, -0.3))
        found = make_detector(target, CAMERA).detect(one.image)
        assert found.target == target
        assert found.corners_px == pytest.approx(one.corners, abs=0.1)
        assert found.point_px == pytest.approx(one.point, abs=0.1)
    (found,) = make_detector(every).detect_all(cropped(one).image)
    assert found.target == AprilTag(family=family, id=count - 1, edge_m=0.1)


def test_a_drawing_is_found_with_a_sigma_as_small_as_its_error():
    """White of 255 is a drawing's white here, not a camera's that is clipped."""
    for family, cell_px, black in some_of(FAMILIES, [3, 7, 25, 36], [0, 3]):
        with named(family, cell_px, black):
            target, rim_px = tag(family), 12
            image = np.maximum(texture(target, cell_px, rim_px=rim_px), black).astype(np.uint8)
            place = np.array(target.origin_cells) * cell_px - 0.5 + rim_px
            found = make_detector(target).detect(image)
            corners = target.corners_m / target.cell_m * cell_px + place
            assert found.corners_px == pytest.approx(corners, abs=0.05)
            assert found.corners_sigma_px.max() < 0.1


@pytest.mark.slow
def test_a_tag_of_another_family_or_number_is_none_nor_a_mirrored_or_inverted_one():
    for family, other in zip(FAMILIES, FAMILIES[1:] + FAMILIES[:1], strict=True):
        with named(family, other):
            one, five = cropped(drawn(tag(family, 4))), make_detector(tag(family, 5))
            assert five.detect(one.image) is None
            seen = make_detector(tag(family, 4)).detect(one.image)
            assert five.track(one.image, seen._replace(target=tag(family, 5))) is None
            others = cropped(drawn(tag(other, 3))).image
            for image in (others, one.image[:, ::-1], 255 - one.image):
                detector = make_detector(TagFamily(family=family))
                assert detector.detect_all(np.ascontiguousarray(image)) == []


@pytest.mark.parametrize("family", ["36h11", "16h5", "Standard41h12"])
def test_the_librarys_own_detector_reads_what_is_drawn_upright(family):
    """Its homography takes (-1, -1), the tag's upper left, to where the upper left was drawn."""
    one = drawn(tag(family, 7), 0.4)
    (read,) = pyapriltags.Detector(families=f"tag{family}").detect(one.image)
    assert read.tag_id == 7
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    seen = cv2.perspectiveTransform(corners[None], read.homography)[0] - 0.5
    assert seen == pytest.approx(one.corners, abs=1.0)


@pytest.mark.parametrize(("family", "edge_px"), [("16h5", 120.0), ("Standard41h12", 60.0)])
def test_a_sharp_tag_whose_blocks_of_light_might_be_its_cells_is_found(family, edge_px):
    """A block for each cell would have one colour, and levels of its own for it."""
    target, sharp = AprilTag(family=family, id=0, edge_m=0.12), replace(RENDERING, blur_px=0.35)
    depth_m = target.edge_m * CAMERA.focal[0] / edge_px
    for turn in ((0.0, 0.0, 0.0), (0.2, -0.1, 0.4)):
        one = scene(CAMERA, target, pose(0.0, 0.0, depth_m, turn), sharp)
        found = make_detector(target, CAMERA).detect(one.image)
        assert found.corners_px == pytest.approx(one.corners, abs=0.1)


# several tags


def tags_around(*identities: int) -> tuple[np.ndarray, list[Scene]]:
    """An image of tags beside and above each other, at several sizes, and each tag."""
    places = [(-0.35, -0.2, 1.0), (0.3, -0.15, 0.9), (-0.2, 0.2, 1.1), (0.35, 0.25, 1.2)]
    placed = [
        (AprilTag(id=identity), pose(*place, (0.1, -0.1, 0.7 * k)))
        for k, (identity, place) in enumerate(zip(identities, places, strict=False))
    ]
    return several(CAMERA, placed, RENDERING)


def test_of_several_tags_all_are_found_by_their_numbers_or_the_one_asked_for():
    image, scenes = tags_around(586, 3, 44, 0)
    found = make_detector(TagFamily(), CAMERA).detect_all(image)
    assert [each.target.id for each in found] == [0, 3, 44, 586]
    for each, k in zip(found, (3, 1, 2, 0), strict=True):
        assert each.corners_px == pytest.approx(scenes[k].corners, abs=0.1)
    detector = make_detector(AprilTag(id=44), CAMERA)
    (alone,) = detector.detect_all(image)
    for found in (alone, detector.detect(image), detector.search(image, scenes[0].point)):
        assert found.target.id == 44
        assert found.point_px == pytest.approx(scenes[2].point, abs=0.1)


@pytest.mark.slow
def test_two_threads_at_once_find_all_tags_that_one_finds():
    images = [tags_around(*identities)[0] for identities in ((586, 3), (44, 0, 7))]
    detector = make_detector(TagFamily(), CAMERA)
    alone = [detector.detect_all(image) for image in images]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(detector.detect_all, 4 * images))
    for found, expected in zip(together, 4 * alone, strict=True):
        for one, other in zip(found, expected, strict=True):
            assert one.target == other.target
            np.testing.assert_array_equal(one.corners_px, other.corners_px)


def test_of_prints_of_one_number_the_nearest_or_largest_is_taken_the_predicted_tracked():
    image, scenes = tags_around(7, 7, 7, 7)
    detector = make_detector(AprilTag(id=7), CAMERA)
    found = sorted(detector.detect_all(image), key=lambda each: each.point_px[0])
    for before, one in zip(found, sorted(scenes, key=lambda s: s.point[0]), strict=True):
        for find in (detector.detect, detector.search):
            assert find(image, one.point + (30, -20)).point_px == pytest.approx(one.point, abs=0.1)
        tracked = detector.track(image, shifted(before, (8, 8)))
        assert tracked.point_px == pytest.approx(one.point, abs=0.1)
    largest = max(scenes, key=lambda one: np.ptp(one.corners, axis=0).mean())
    assert detector.detect(image).point_px == pytest.approx(largest.point, abs=0.1)


@pytest.mark.parametrize("roll", [np.pi / 4.0, -np.pi / 4.0])
def test_two_tags_of_one_number_seen_flat_above_each_other_are_two(roll):
    """Their middles are nearer than half the long diagonal of either."""
    one = scene(CAMERA, TAG, pose(0.0, 0.0, 0.5, (0.0, 0.0, roll)), RENDERING)
    height, width = one.image.shape
    flat = cv2.resize(one.image, (width, height // 4), interpolation=cv2.INTER_AREA)
    half = round(0.16 * np.ptp(one.corners[:, 0]))
    part = flat[round(one.point[1] / 4.0) - half :][: 2 * half]
    found = make_detector(TagFamily()).detect_all(np.vstack([part, part]))
    assert [each.target.id for each in found] == [TAG.id, TAG.id]


# hidden, cut and blinded tags


def test_a_half_hidden_tag_is_none_neither_found_nor_tracked():
    for roll, side, grey in some_of([0.0, 0.6, 2.2], SIDES, [0, 90, 255]):
        with named(roll, side, grey):
            one = cropped(scene(CAMERA, TAG, pose(0.02, 0.01, 0.8, (0, 0, roll)), RENDERING))
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
    half_px = 0.5 * TAG.edge_m * CAMERA.focal[0]
    size = np.array([CAMERA.width, CAMERA.height])
    middle = 0.5 * (size - 1.0) + np.array(side) * (0.5 * size - half_px + beyond_px)
    x, y = (middle - CAMERA.principal) / CAMERA.focal
    return scene(CAMERA, TAG, pose(x, y, 1.0), RENDERING)


@pytest.mark.parametrize(("side", "beyond_px"), list(zip(SIDES, [2.0, 12.0] * 2, strict=True)))
def test_a_tag_in_the_image_to_its_quiet_zone_is_found_and_one_that_the_edge_cuts_is_none(
    side, beyond_px
):
    """A side that is not in the image is nowhere."""
    detector, cut = make_detector(TAG, CAMERA), at_side(side, beyond_px)
    assert detector.detect(cut.image) is None
    quiet_px = np.ptp(cut.corners[:, 0]) / 8.0
    one = at_side(side, -2.0 - quiet_px)
    found = detector.detect(one.image)
    assert found.corners_px == pytest.approx(one.corners, abs=0.1)
    assert detector.track(cut.image, found) is None


@pytest.mark.parametrize("away_px", [-1, 2])
def test_a_tag_at_the_images_edge_is_found_with_a_sigma_as_large_as_its_error(away_px):
    rng, detector, errors = np.random.default_rng(4), make_detector(TAG), []
    for z in (0.4, 0.8):
        for turn in rng.uniform(-0.4, 0.4, (4, 3)):
            one = scene(CAMERA, TAG, pose(0.0, 0.0, z, turn), RENDERING, rng)
            end = int(one.corners[:, 0].max() + 0.5) + 1 + away_px
            found = detector.detect(np.ascontiguousarray(one.image[:, :end]))
            errors.append((found.corners_px - one.corners) / found.corners_sigma_px)
    assert 0.5 < rms(errors) < 1.6


def test_glare_beside_the_tag_does_not_matter_and_on_it_may_hide_but_not_move_it():
    """Corners that are found are right to 0.1 px rms, and with a highlight on the tag to 0.3 px."""
    edge_px = TAG.edge_m * CAMERA.focal[0] / 0.8
    one = scene(CAMERA, TAG, pose(0.02, 0.01, 0.8, (0.1, 0.2, 0.3)), RENDERING)
    for angle, away in [(0.0, 1.1), (0.8, 2.5), (np.pi / 2, 1.1), (3.5, 1.5)]:
        with named(angle, away):
            image = glare(away * edge_px, 0.2 * edge_px, angle)(one.image, one.point)
            found = make_detector(TAG, CAMERA).detect(image)
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
