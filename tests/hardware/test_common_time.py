"""Pixels of eyes that expose at different times, as of one time."""

from types import SimpleNamespace

import numpy as np
import pytest

from vergence import load_head
from vergence.hardware.pairing import SearchedImage, SearchedPair, merge_pair, pixels_at_common_time
from vergence.models.parts import EYES


@pytest.mark.parametrize("name", ["turrets", "simulated"])
def test_a_resting_target_is_where_a_synchronised_pair_would_see_it(name: str) -> None:
    head, rng = load_head(name), np.random.default_rng(4)
    point = np.array([0.05, -0.1, 0.8])
    common = head.fixate(point)
    for _ in range(20):
        exposed = np.tile(common, (2, 1))
        exposed[:, EYES] += rng.normal(0.0, 0.02, (2, 4))
        pixels = np.stack([head.project(exposed[eye], point)[eye] for eye in range(2)])
        found = pixels_at_common_time(head, pixels, exposed, common)
        assert found == pytest.approx(head.project(common, point), abs=1e-6)


def test_a_neck_that_turns_takes_nothing_away() -> None:
    head = load_head("simulated")
    world, common = np.array([0.05, -0.1, 1.2, 1.0]), head.rest()
    exposed = np.tile(common, (2, 1))
    exposed[0, 0], exposed[1, 0] = 0.01, -0.01
    T_N_0 = np.linalg.inv(head.base_pose(exposed))
    here = head.base_pose(common) @ world
    points = T_N_0[..., :3, :] @ here
    pixels = np.stack([head.project(exposed[eye], points[eye])[eye] for eye in range(2)])
    found = pixels_at_common_time(head, pixels, exposed, common)
    assert found == pytest.approx(head.project(common, world[:3]), abs=1e-6)


def test_lines_that_do_not_meet_are_taken_far_away() -> None:
    head = load_head("turrets")
    q = head.rest()
    pixels = head.cameras.principal + np.array([[-30.0, 0.0], [30.0, 0.0]])
    found = pixels_at_common_time(head, pixels, np.tile(q, (2, 1)), q)
    assert found == pytest.approx(pixels, abs=1e-6)


def test_a_pair_is_seen_from_the_joint_angles_of_each_exposure() -> None:
    head, point, exposed_s = load_head("turrets"), np.array([0.05, -0.1, 0.8]), (0.01, 0.018)
    fixated = head.fixate(point)

    def at(now_s: float):
        angles = fixated.copy()
        angles[EYES] += now_s * np.array([1.0, -2.0, 1.5, 0.5])
        return angles

    pixels = [head.project(at(now_s), point)[eye] for eye, now_s in enumerate(exposed_s)]
    images = zip(exposed_s, pixels, strict=True)
    pair = SearchedPair(*(SearchedImage(now_s, 0.05, pixel) for now_s, pixel in images))
    common_s, found = merge_pair(head, pair, SimpleNamespace(at=at))
    assert common_s == pytest.approx(0.014)
    assert found == pytest.approx(head.project(at(0.014), point), abs=1e-6)


def test_rays_that_diverge_keep_their_directions() -> None:
    head = load_head("turrets")
    common = head.rest()
    exposed = np.stack([common, common])
    exposed[0, EYES.start] += 0.03
    pixels = head.cameras.principal + np.array([[-30.0, 0.0], [30.0, 0.0]])
    found = pixels_at_common_time(head, pixels, exposed, common)
    left = head.camera_poses(exposed[0])[0] @ [-30.0 / head.cameras.focal[0, 0], 0.0, 1.0, 0.0]
    far = head.camera_poses(common)[0, :3, 3] + 1e4 * left[:3]
    assert found[0] == pytest.approx(head.project(common, far)[0], abs=0.1)
