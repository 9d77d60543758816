"""Every family of the AprilTag library: found upright, by its number, and not taken for another."""

from dataclasses import replace

import cv2
import numpy as np
import pyapriltags
import pytest

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import Scene, cropped, rig, scene, several
from vergence.vision import AprilTag, TagFamily, make_detector
from vergence.vision.tag_families import CORRECTED_BITS, tag_family
from vergence.vision.targets import texture

FAMILIES = tuple(CORRECTED_BITS)
CELL_M = 0.016


def tag(family: str, identity: int = 0) -> AprilTag:
    """Tag with cells of 10 px at 1 m before the simulated rig."""
    return AprilTag(family=family, id=identity, edge_m=CELL_M * tag_family(family).width_at_border)


def drawn(target: AprilTag, roll: float = 0.0, turn: tuple[float, float] = (0.0, 0.0)) -> Scene:
    camera, rendering = rig("simulated")
    T_C_T = pose(0.013, -0.021, 1.0) @ pose(0, 0, 0, (0, 0, roll)) @ pose(0, 0, 0, (*turn, 0))
    return scene(camera, target, T_C_T, rendering, np.random.default_rng(1))


ROLLS = dict(zip(FAMILIES, [0.0, 0.8, np.pi / 2, np.pi, -1.0] * 2, strict=False))


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_tag_is_found_by_its_number_its_upper_left_corner_first(family):
    """To 0.1 px: taken for another corner it would be beside by the edge, 60 px and more."""
    count, roll = len(tag_family(family).code_words), ROLLS[family]
    for identity in (0, count // 2, count - 1):
        target = tag(family, identity)
        one = drawn(target, roll, (0.2, -0.3))
        found = make_detector(target, rig("simulated")[0]).detect(one.image)
        assert found.target == target
        assert found.corners_px == pytest.approx(one.corners, abs=0.1)
        assert found.point_px == pytest.approx(one.point, abs=0.1)


@pytest.mark.slow
def test_a_family_finds_its_tags_and_says_which():
    for family in FAMILIES:
        with named(family):
            last = len(tag_family(family).code_words) - 1
            one = cropped(drawn(tag(family, last)))
            (found,) = make_detector(TagFamily(family=family, edge_m=0.1)).detect_all(one.image)
            assert found.target == AprilTag(family=family, id=last, edge_m=0.1)


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
    detector = pyapriltags.Detector(families=f"tag{family}")
    (read,) = detector.detect(one.image)
    assert read.tag_id == 7
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    seen = cv2.perspectiveTransform(corners[None], read.homography)[0] - 0.5
    assert seen == pytest.approx(one.corners, abs=1.0)


def tags_around(*identities: int):
    """A camera, its image of tags beside and above each other, at several sizes, and each tag."""
    camera, rendering = rig("simulated")
    places = [(-0.35, -0.2, 1.0), (0.3, -0.15, 0.9), (-0.2, 0.2, 1.1), (0.35, 0.25, 1.2)]
    placed = [
        (AprilTag(id=identity), pose(*place, (0.1, -0.1, 0.7 * k)))
        for k, (identity, place) in enumerate(zip(identities, places, strict=False))
    ]
    return camera, *several(camera, placed, rendering)


def test_of_several_tags_all_are_found_by_their_numbers_or_the_one_asked_for():
    camera, image, scenes = tags_around(586, 3, 44, 0)
    found = make_detector(TagFamily(), camera).detect_all(image)
    assert [each.target.id for each in found] == [0, 3, 44, 586]
    for each, k in zip(found, (3, 1, 2, 0), strict=True):
        assert each.corners_px == pytest.approx(scenes[k].corners, abs=0.1)
    detector = make_detector(AprilTag(id=44), camera)
    (alone,) = detector.detect_all(image)
    for found in (alone, detector.detect(image), detector.search(image, scenes[0].point)):
        assert found.target.id == 44
        assert found.point_px == pytest.approx(scenes[2].point, abs=0.1)


def test_of_prints_of_one_number_the_nearest_or_largest_is_taken_the_predicted_tracked():
    camera, image, scenes = tags_around(7, 7, 7, 7)
    detector = make_detector(AprilTag(id=7), camera)
    found = sorted(detector.detect_all(image), key=lambda each: each.point_px[0])
    for before, one in zip(found, sorted(scenes, key=lambda s: s.point[0]), strict=True):
        for find in (detector.detect, detector.search):
            assert find(image, one.point + (30, -20)).point_px == pytest.approx(one.point, abs=0.1)
        moved = before._replace(
            point_px=before.point_px + (8, 8), corners_px=before.corners_px + (8, 8)
        )
        assert detector.track(image, moved).point_px == pytest.approx(one.point, abs=0.1)
    largest = max(scenes, key=lambda one: np.ptp(one.corners, axis=0).mean())
    assert detector.detect(image).point_px == pytest.approx(largest.point, abs=0.1)


@pytest.mark.parametrize(("family", "edge_px"), [("16h5", 120.0), ("Standard41h12", 60.0)])
def test_a_sharp_tag_whose_blocks_of_light_might_be_its_cells_is_found(family, edge_px):
    """A block for each cell would have one colour, and levels of its own for it."""
    camera, rendering = rig("simulated")
    target = AprilTag(family=family, id=0, edge_m=0.12)
    detector = make_detector(target, camera)
    sharp = replace(rendering, blur_px=0.35)
    depth_m = target.edge_m * camera.focal[0] / edge_px
    for turn in ((0.0, 0.0, 0.0), (0.2, -0.1, 0.4)):
        one = scene(camera, target, pose(0.0, 0.0, depth_m, turn), sharp)
        found = detector.detect(one.image)
        assert np.abs(found.corners_px - one.corners).max() < 0.1
