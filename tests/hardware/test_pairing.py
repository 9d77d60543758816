"""Pairs of two eyes' images: each image comes out once, with its partner if it has one."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence import load_head
from vergence.hardware.pairing import (
    Pairing,
    SearchedImage,
    SearchedPair,
    merge_pair,
    pixels_at_common_time,
)
from vergence.models.parts import EYES

FRAME_S = 1.0 / 30.0
TOLERANCE_S = 0.6 * FRAME_S
NOWHERE = np.full(2, np.nan)


def sight(exposed_s, ready_s=None):
    return SearchedImage(exposed_s, exposed_s + 0.1 if ready_s is None else ready_s, NOWHERE)


def drain(pairing, now_s):
    out = []
    while (sights := pairing.next(now_s)) is not None:
        out.append(sights)
    return out


def run(left, right, pairing=None):
    """Pairs made of images with these exposure times, each added as it is ready."""
    pairing = pairing or Pairing(TOLERANCE_S, FRAME_S)
    images = [(one.ready_s, eye, one) for eye, times in enumerate((left, right)) for one in times]
    out = []
    for ready_s, eye, one in sorted(images, key=lambda image: image[:2]):
        pairing.add(eye, one)
        out += drain(pairing, ready_s)
    return out + drain(pairing, 1e9)


def exposures(period=FRAME_S):
    """Images of one eye in order: times of exposure, and times of being ready in order too."""
    steps = st.tuples(st.floats(0.1 * period, 3.0 * period), st.floats(0.0, period))

    def made(rows):
        exposed = np.cumsum([step for step, _late in rows])
        ready = np.maximum.accumulate(exposed + [late for _step, late in rows])
        return [sight(*row) for row in zip(exposed.tolist(), ready.tolist(), strict=True)]

    return st.lists(steps, max_size=12).map(made)


@pytest.mark.slow
@given(exposures(), exposures())
def test_each_image_comes_out_once_in_order_and_in_pairs_within_the_tolerance(left, right):
    pairing = Pairing(TOLERANCE_S, FRAME_S)
    out = run(left, right, pairing)
    for eye, images in enumerate((left, right)):
        came = [sights[eye] for sights in out if sights[eye] is not None]
        assert [id(one) for one in came] == [id(one) for one in images]
    pairs = [sights for sights in out if None not in sights]
    assert all(abs(one.exposed_s - other.exposed_s) <= TOLERANCE_S for one, other in pairs)
    assert pairing.counts.pairs == len(pairs)
    assert pairing.counts.unpaired_left == len(left) - len(pairs)
    assert pairing.counts.unpaired_right == len(right) - len(pairs)


@given(
    st.floats(0.0, 0.5), st.booleans(),
    st.lists(st.tuples(st.floats(0.0, 0.1), st.floats(0.0, 0.1)), min_size=2, max_size=30),
)  # fmt: skip
def test_free_running_cameras_always_pair(apart, right_first, jitters):
    early = [(i + jitter) * FRAME_S for i, (jitter, _) in enumerate(jitters)]
    late = [(i + apart + jitter) * FRAME_S for i, (_, jitter) in enumerate(jitters)]
    left, right = (late, early) if right_first else (early, late)
    pairing = Pairing(TOLERANCE_S + 1e-9, FRAME_S)  # the sums above are rounded
    out = run(list(map(sight, left)), list(map(sight, right)), pairing)
    assert len(out) == len(jitters)
    assert all(None not in sights for sights in out)


@pytest.mark.slow
@given(st.floats(-0.35, 0.35), st.sets(st.integers(0, 9)), st.sets(st.integers(0, 9)))
def test_a_dropped_frame_leaves_its_partner_alone_and_no_other(apart, lost_left, lost_right):
    left = [sight(i * FRAME_S) for i in range(10) if i not in lost_left]
    right = [sight((i + apart) * FRAME_S) for i in range(10) if i not in lost_right]
    out = run(left, right)
    alone = [one.left or one.right for one in out if None in one]
    assert len(alone) == len(lost_left ^ lost_right)
    for one in out:
        if None not in one:
            assert abs(one.exposed_s - (one.left.exposed_s + 0.5 * apart * FRAME_S)) < 1e-9


def test_a_dead_eye_holds_the_other_back_for_the_wait_and_no_longer():
    pairing = Pairing(TOLERANCE_S, wait_s=0.03)
    for i in range(4):
        pairing.add(1, sight(i * FRAME_S, ready_s=1.0 + i * FRAME_S))
        assert drain(pairing, 1.0 + i * FRAME_S + 0.029) == []
        (lone,) = drain(pairing, 1.0 + i * FRAME_S + 0.031)
        assert lone.left is None
        assert lone.right.exposed_s == i * FRAME_S
    assert pairing.counts.unpaired_right == 4


def test_a_later_image_of_the_other_eye_ends_the_wait_at_once():
    pairing = Pairing(TOLERANCE_S, wait_s=10.0)
    pairing.add(0, sight(0.0))
    assert pairing.next(0.2) is None
    pairing.add(1, sight(FRAME_S))
    (lone,) = drain(pairing, 0.2)
    assert lone.right is None


def test_a_pair_is_dated_in_the_middle_and_ready_with_the_later_one():
    (pair,) = run([sight(1.0, ready_s=1.2)], [sight(1.01, ready_s=1.15)])
    assert (pair.exposed_s, pair.ready_s) == (pytest.approx(1.005), 1.2)


# ---- pixels as of one time ----

TURRETS, POINT = load_head("turrets"), np.array([0.05, -0.1, 0.8])


@pytest.mark.parametrize("name", ["turrets", "simulated"])
def test_a_resting_target_is_where_a_synchronised_pair_would_see_it(name):
    head, rng = load_head(name), np.random.default_rng(4)
    common = head.fixate(POINT)
    for _ in range(20):
        exposed = np.tile(common, (2, 1))
        exposed[:, EYES] += rng.normal(0.0, 0.02, (2, 4))
        pixels = np.stack([head.project(exposed[eye], POINT)[eye] for eye in range(2)])
        found = pixels_at_common_time(head, pixels, exposed, common)
        assert found == pytest.approx(head.project(common, POINT), abs=1e-6)


def test_a_neck_that_turns_takes_nothing_away():
    head = load_head("simulated")
    world, common = np.array([0.05, -0.1, 1.2, 1.0]), head.rest()
    exposed = np.tile(common, (2, 1))
    exposed[0, 0], exposed[1, 0] = 0.01, -0.01
    T_N_0 = np.linalg.inv(head.base_pose(exposed))
    points = T_N_0[..., :3, :] @ (head.base_pose(common) @ world)
    pixels = np.stack([head.project(exposed[eye], points[eye])[eye] for eye in range(2)])
    found = pixels_at_common_time(head, pixels, exposed, common)
    assert found == pytest.approx(head.project(common, world[:3]), abs=1e-6)


def test_a_pair_is_seen_from_the_joint_angles_of_each_exposure():
    fixated, exposed_s = TURRETS.fixate(POINT), (0.01, 0.018)

    def at(now_s):
        angles = fixated.copy()
        angles[EYES] += now_s * np.array([1.0, -2.0, 1.5, 0.5])
        return angles

    pixels = [TURRETS.project(at(now_s), POINT)[eye] for eye, now_s in enumerate(exposed_s)]
    images = zip(exposed_s, pixels, strict=True)
    pair = SearchedPair(*(SearchedImage(now_s, 0.05, pixel) for now_s, pixel in images))
    common_s, found = merge_pair(TURRETS, pair, SimpleNamespace(at=at))
    assert common_s == pytest.approx(0.014)
    assert found == pytest.approx(TURRETS.project(at(0.014), POINT), abs=1e-6)


@pytest.mark.parametrize("turned_rad", [0.0, 0.03])
def test_rays_that_diverge_keep_their_directions(turned_rad):
    common, cameras = TURRETS.rest(), TURRETS.cameras
    exposed = np.stack([common, common])
    exposed[0, EYES.start] += turned_rad
    pixels = cameras.principal + np.array([[-30.0, 0.0], [30.0, 0.0]])
    found = pixels_at_common_time(TURRETS, pixels, exposed, common)
    left = TURRETS.camera_poses(exposed[0])[0] @ [-30.0 / cameras.focal[0, 0], 0.0, 1.0, 0.0]
    far = TURRETS.camera_poses(common)[0, :3, 3] + 1e4 * left[:3]
    assert found[0] == pytest.approx(TURRETS.project(common, far)[0], abs=0.1)
    assert found[1] == pytest.approx(pixels[1], abs=1e-6)
