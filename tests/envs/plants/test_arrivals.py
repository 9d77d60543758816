"""Arrival of images: order, random jitter, exposure stamps."""

import itertools

import numpy as np
import pytest

from tests.envs.trials import assert_uniform, start_of, steps
from vergence import HeadModel
from vergence.envs.plant import make_plant

T = 1 / 120
NOMINAL_S = 8 * T


@pytest.fixture
def stamped(exact: HeadModel) -> HeadModel:
    """A head whose cameras tell when a frame was exposed."""
    return exact.replace(timing={"exposure_stamps": True})


def arrivals(readings) -> tuple[np.ndarray, np.ndarray]:
    """Exposures and receipts of all images of all heads that came, s."""
    pairs = [
        np.stack([now.exposure_s, now.received_s])[:, now.frame != last.frame]
        for last, now in itertools.pairwise(readings)
    ]
    return tuple(np.concatenate(pairs, axis=1))


def test_lateness_is_uniform_up_to_the_jitter(stamped) -> None:
    jitter_s = 0.006  # less than from one frame to the next: no image waits for another
    plant = make_plant("kinematic", stamped, 32, jitter_s=jitter_s)
    exposed, received = arrivals(steps(plant, start_of(32), 150)[0])
    late = (received - exposed - NOMINAL_S) / jitter_s
    assert late.size > 4000
    assert_uniform(late)


def test_an_image_never_overtakes_one_that_was_exposed_earlier(stamped) -> None:
    jitter_s = 6 * T
    plant = make_plant("kinematic", stamped, 64, jitter_s=jitter_s)
    readings, _q, _v = steps(plant, start_of(64), 300)
    waited = 0
    for last, now in itertools.pairwise(readings):
        assert (now.exposure_s >= last.exposure_s).all()
        assert (now.received_s >= last.received_s).all()
        assert (now.received_s <= now.time_s + 1e-9).all()
        new = now.frame != last.frame
        late = (now.received_s - now.exposure_s - NOMINAL_S)[new]
        assert (late >= -1e-12).all()
        assert (late <= jitter_s + 1e-12).all()
        waited += ((now.frame - last.frame) > 1).sum()
    assert waited > 100  # those that wait come together
    # nothing is lost: of 300 frames those have come that were exposed long enough ago
    due = 300 - 8 - 6 + 8
    assert (readings[-1].frame >= due).all()
    assert (readings[-1].frame <= 300 + 6).all()


def test_a_stamp_is_the_exposure_or_else_the_receipt_less_the_latency(exact, stamped) -> None:
    options = {"latency_s": 0.09, "jitter_s": 0.01, "frame_rate_hz": 50.0, "frame_phase": 0.4}
    turn = [0, 0, 0, 0.4, 0, 0, 0]
    runs = [
        steps(make_plant("kinematic", head, 8, **options), start_of(8), 120, turn)
        for head in (exact, stamped)
    ]
    for dated, true in zip(runs[0][0], runs[1][0], strict=True):
        assert np.array_equal(dated.received_s, true.received_s)
        assert np.array_equal(dated.pixels, true.pixels, equal_nan=True)
        assert dated.exposure_s == pytest.approx(dated.received_s - NOMINAL_S, abs=1e-12)
        frame = true.exposure_s * 50.0 - 0.4
        assert frame == pytest.approx(np.round(frame), abs=1e-9)
    off = np.subtract(*[[reading.exposure_s for reading in run[0]] for run in runs])
    # 90 ms and up to 10 more, where 67 are nominal
    assert off.min() > 0.09 - NOMINAL_S - 1e-9
    assert off.max() < 0.1 - NOMINAL_S + 1e-9
    assert np.ptp(off) > 0.008


def test_angles_at_exposure_lie_between_two_readings_of_the_joints(stamped) -> None:
    head = stamped.replace(timing={"feedback_latency_s": 0.004})
    plant = make_plant("mujoco", head, 1, frame_rate_hz=47.0, frame_phase=0.3)
    way = np.array([0, 0, 0, 0.5, 0.4, -0.5, 0.3])
    readings, _q, _v = steps(plant, start_of(), 90, lambda k: np.sin(0.2 * k) * way)
    told = np.array([reading.positions[0] for reading in readings])
    dates = np.array([reading.joints_s[0] for reading in readings])
    assert dates == pytest.approx(T * np.arange(91) - 0.004, abs=1e-12)
    between = 0
    for reading in readings:
        when = reading.exposure_s[0]
        expected = [np.interp(when, dates, told[:, j]) for j in range(7)]
        assert reading.positions_at_exposure[0] == pytest.approx(expected, abs=1e-12)
        share = (when / T) % 1.0
        between += 0.1 < share < 0.9
    assert between > 40
