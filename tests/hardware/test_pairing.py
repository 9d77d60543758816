"""Pairs of two eyes' images: each image comes out once, with its partner if it has one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vergence.hardware.pairing import Pairing, SearchedImage

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
        assert len(drain(pairing, 1.0 + i * FRAME_S + 0.029)) == 0
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
    assert abs(pair.exposed_s - 1.005) < 1e-12
    assert pair.ready_s == 1.2
