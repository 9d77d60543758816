"""The loop's faults and times where images are drawn and a detector looks at them."""

import numpy as np
import pytest

from tests.envs.trials import AHEAD, start_of, steps
from vergence import HeadModel
from vergence.envs.plant import make_plant


def rendered(head: HeadModel, num: int, count: int, **options: object):
    """Readings of eyes at rest before a target straight ahead."""
    plant = make_plant("rendered", head, num, **options)
    readings, _q, _v = steps(plant, start_of(num), count)
    plant.close()
    return readings


def test_images_show_nothing_before_the_onset(simulated: HeadModel) -> None:
    onset_s = 0.08
    for reading in rendered(simulated, 1, 24, onset_s=onset_s):
        assert reading.visible.all() == (reading.exposure_s[0] > onset_s - 1e-9)


def test_a_board_that_jumps_is_drawn_where_it_was_until_the_onset(simulated: HeadModel) -> None:
    before, onset_s = (0.05, -0.1, 1.0), 0.05
    plant = make_plant("rendered", simulated, 1, onset_s=onset_s)
    readings, _q, _v = steps(plant, start_of(1, AHEAD, before), 20)
    for reading in readings:
        point = AHEAD if reading.exposure_s[0] > onset_s - 1e-9 else before
        expected = simulated.project(np.zeros(7), point)
        assert reading.pixels[0] == pytest.approx(expected, abs=0.3)


def test_faults_are_those_of_the_other_plants(simulated: HeadModel) -> None:
    faults = {
        "dropped_frame_probability": 0.3, "missed_detection_probability": 0.2, "jitter_s": 0.03,
        "frame_rate_hz": 70.0, "frame_phase": 0.6, "clock_drift": 0.01, "latency_s": 0.05,
    }  # fmt: skip
    drawn = rendered(simulated, 2, 50, **faults)
    plant = make_plant("mujoco", simulated, 2, **faults)
    exact, _q, _v = steps(plant, start_of(2), 50)
    missed = 0
    for one, other in zip(drawn, exact, strict=True):
        for name in ("frame", "exposure_s", "received_s", "visible"):
            a, b = getattr(one, name), getattr(other, name)
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
        missed += (~one.visible & (one.exposure_s >= 0.0)[:, None]).sum()
    assert missed > 5


@pytest.mark.slow
def test_outliers_lie_on_top_of_what_the_detector_found(simulated: HeadModel) -> None:
    plain = rendered(simulated, 2, 30)
    beside = rendered(simulated, 2, 30, outlier_probability=0.2, outlier_px=60.0)
    moved = np.array([b.pixels - a.pixels for a, b in zip(plain, beside, strict=True)])[8:]
    away = np.linalg.norm(moved, axis=-1)
    hit = away > 1e-9
    # 92 detections, four standard deviations
    assert hit.mean() == pytest.approx(0.2, abs=0.17)
    assert away.max() <= 60.0
    assert away[hit].max() > 20.0
    assert (hit[..., 0] != hit[..., 1]).any()


def test_images_are_drawn_at_their_own_instants(simulated: HeadModel) -> None:
    head = simulated.replace(timing={"exposure_stamps": True})
    options = {"frame_rate_hz": 47.0, "frame_phase": 0.37}
    command = [0.0, 0.0, 0.0, 0.4, 0.3, -0.4, 0.3]
    runs = [
        steps(make_plant(name, head, 1, **options), start_of(), 45, command)[0]
        for name in ("rendered", "mujoco")
    ]
    errors = []
    for one, other in zip(*runs, strict=True):
        assert np.array_equal(one.exposure_s, other.exposure_s)
        errors.append(one.pixels - other.pixels)
    seen = np.isfinite(errors).all(axis=(1, 2, 3))
    assert seen.sum() > 30
    # the detector's errors and the other's noise; a millisecond is 0.3 px of these motions
    assert np.abs(np.mean(np.array(errors)[seen], axis=0)).max() < 0.1
