"""Health of a loop: gaps beyond their predicted spread, and late periods."""

import numpy as np
import pytest

from vergence.envs.reading import Reading
from vergence.errors import VergenceWarning
from vergence.models.head_file import load_head
from vergence.recording.health import MAX_GAP_RATIO, LoopHealth, warn_of_gap

HEAD = load_head("simulated").replace(sensor={"detection_noise_px": 0.3})
PERIOD_S = HEAD.timing.period_s
LATENCY_S = HEAD.timing.latency_s
POINT = np.array([0.05, -0.05, 1.0])


def readings(count, *, right_down_px=0.0, speed_rad_s=0.0, seed=0):
    """Readings of a still head with noisy pixels, a new image in each period."""
    rng = np.random.default_rng(seed)
    q = HEAD.fixate(POINT)
    for step in range(count):
        pixels = HEAD.project(q, POINT) + rng.normal(0.0, 0.3, (2, 2))
        pixels[1, 1] += right_down_px
        reading = Reading._make(part[0] for part in Reading.empty(1))
        yield reading._replace(
            time_s=np.float64(PERIOD_S * step),
            exposure_s=np.float64(PERIOD_S * step - LATENCY_S),
            pixels=pixels,
            visible=np.ones(2, dtype=bool),
            positions_at_exposure=q,
            velocities=np.full(7, speed_rad_s),
        )


def judged(some):
    health = LoopHealth(HEAD)
    for reading in some:
        health.add(reading)
    return health


@pytest.mark.slow
def test_noise_alone_is_not_reported():
    ratios = [judged(readings(40, seed=seed)).gap_ratio for seed in range(8)]
    assert 0.7 < np.median(ratios) < 1.3
    assert max(ratios) < MAX_GAP_RATIO


def test_a_camera_that_has_moved_is_reported():
    health = judged(readings(40, right_down_px=5.0))
    assert health.gap_ratio > MAX_GAP_RATIO
    assert any("warning" in line and "camera" in line for line in health.words())
    # gaps of moving eyes are not judged
    assert np.isnan(judged(readings(40, right_down_px=5.0, speed_rad_s=0.5)).gap_ratio)
    rows = zip(*readings(40, right_down_px=5.0), strict=True)
    with pytest.warns(VergenceWarning, match="a zero .* or a camera is off"):
        warn_of_gap(HEAD, Reading._make(np.stack(part)[:, np.newaxis] for part in rows))


def test_missed_periods_are_counted_within_a_gaze():
    some = list(readings(10))
    health = judged([*some[:4], *some[6:], *some[:5]])
    assert health.missed_periods == 2
    assert health.periods == 9 + 4


def test_a_gaze_is_judged_though_the_eyes_moved_later_in_the_one_before():
    moving = readings(40, speed_rad_s=0.5)
    health = judged([*moving, *readings(40, right_down_px=5.0)])
    assert health.gap_ratio > MAX_GAP_RATIO
