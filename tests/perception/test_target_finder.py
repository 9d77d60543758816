"""Several targets in one image: each once, by the first text that names it."""

import numpy as np
import pytest

from tests.naming import refused
from tests.perception.drawn import Studio, corners_in_space, pose_at
from vergence import load_head
from vergence.perception.finding import TargetFinder, parse_targets, tag_number
from vergence.perception.locate import _match
from vergence.vision import Camera
from vergence.vision.targets import AprilTag

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
