"""Several targets in one image: each once, by the first text that names it."""

import numpy as np
import pytest

from tests.eval.refusals import not_refused
from tests.perception.drawn import Studio, pose_at
from vergence import load_head
from vergence.perception.finding import TargetFinder, parse_targets, tag_number
from vergence.perception.locate import _match
from vergence.vision import Camera
from vergence.vision.targets import AprilTag, CharucoBoard

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
def test_a_charuco_board_is_one_target():
    board = CharucoBoard(columns=6, rows=5, square_m=0.03, marker_m=0.022)
    studio = Studio(HEAD, board)
    images = studio.take(pose_at([0.0, -0.05, 0.6]), np.random.default_rng(0))
    targets = parse_targets(["charuco:6x5:30:22:4X4_50"])
    found = [TargetFinder(targets, Camera.of(HEAD, e)).find(images[e]) for e in range(2)]
    assert [len(each) for each in found] == [1, 1]
    (one,), _ = _match(HEAD, HEAD.rest(), "a", *found)
    assert one.valid.sum() >= 16
    assert one.spacing.mean_m == pytest.approx(0.03, rel=0.005)
    assert (np.abs(one.centre.point - [0.0, -0.05, 0.6]) < 4.0 * one.centre.sigma).all()


def test_no_target_and_texts_that_are_none_are_refused():
    cases = [(texts, "target: expected") for texts in ([], ["tag"], ["nothing:1"])]
    assert not_refused(parse_targets, cases) == []
