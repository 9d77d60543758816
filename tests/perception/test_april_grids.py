"""AprilGrids in photographs of both eyes, and what is there in place of one."""

import numpy as np
import pytest

from tests.perception.drawn import Studio, corners_in_space, pose_at
from vergence import load_head
from vergence.perception.finding import TargetFinder, parse_targets
from vergence.perception.locate import _match
from vergence.perception.notes import describe_similar_targets
from vergence.vision import AprilGrid, Camera
from vergence.vision.targets import AprilTag, TagFamily

HEAD = load_head("simulated")
GRID = AprilGrid(columns=5, rows=4, tag_m=0.03)


@pytest.mark.slow
def test_a_grid_is_one_target_whose_edges_are_as_stated():
    pose = pose_at([0.0, -0.02, 0.4], [0.2, 0.1, 0.1])
    images = Studio(HEAD, GRID).take(pose, np.random.default_rng(0))
    targets = parse_targets([str(GRID)])
    found = [TargetFinder(targets, Camera.of(HEAD, e)).find(images[e]) for e in range(2)]
    assert [len(each) for each in found] == [1, 1]
    (one,), _ = _match(HEAD, HEAD.rest(), "a", *found)
    assert one.valid.all()
    errors = one.fix.point - corners_in_space(GRID, pose)
    assert np.sqrt(np.mean((errors / one.fix.sigma) ** 2)) < 1.5
    assert one.spacing.mean_m == pytest.approx(0.03, rel=0.005)
    assert one.spacing.edge_count == 4 * 20  # edges of tags; the gaps between them are no edges
    assert (np.abs(one.centre.point - pose[:3, 3]) < 4.0 * one.centre.sigma).all()


@pytest.mark.slow
def test_what_is_there_in_place_of_a_grid_is_said():
    rng = np.random.default_rng(0)
    grid = Studio(HEAD, GRID).take(pose_at([0.0, -0.02, 0.4]), rng)[0][230:570, 330:710]
    tag = Studio(HEAD, AprilTag(id=7)).take(pose_at([0.0, 0.0, 0.5]), rng)[0]
    there = "aprilgrid:5x4:30:0.3 (tags, and their gap by their edge) is there"
    for asked in ("aprilgrid:4x5:30:0.3", "aprilgrid:5x4:30:0.2"):
        assert describe_similar_targets(grid, parse_targets([asked])) == there
    assert describe_similar_targets(grid, parse_targets(["aprilgrid:5x4:30:0.295"])) == ""
    assert describe_similar_targets(grid, [TagFamily()]).startswith("aprilgrid:5x4:TAG:0.3")
    assert (
        describe_similar_targets(tag, [GRID])
        == "tag:36h11:7 (a single tag, its border one bit wide) is there"
    )
