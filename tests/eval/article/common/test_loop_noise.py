"""The loop's noise bandwidth, against closed forms and against loops that run."""

from dataclasses import replace

import numpy as np
import pytest

from vergence.eval.article.common.closed_loop import ClosedLoop, hold_gaze
from vergence.eval.article.common.loop_noise import (
    LinearLoop,
    impulse_response,
    noise_bandwidth_hz,
    noise_gain,
)
from vergence.models.head_file import load_head

PERIOD = 1.0 / 120.0
RIG = LinearLoop(gain=4.0, period_s=PERIOD, delay_periods=8, lag_s=0.03)


def test_without_delay_and_lag_it_is_that_of_an_exponential_average():
    for gain in (0.5, 4.0, 20.0):
        loop = LinearLoop(gain=gain, period_s=PERIOD, delay_periods=0, lag_s=0.0)
        share = gain * PERIOD
        assert noise_gain(loop) ** 2 == pytest.approx(share / (2.0 - share))
    assert noise_gain(replace(RIG, gain=30.0)) == np.inf


def test_a_slow_loop_has_the_bandwidth_of_a_first_order_low_pass():
    assert noise_bandwidth_hz(replace(RIG, gain=0.1)) == pytest.approx(0.1 / 4.0, rel=0.03)


def test_the_variance_is_the_sum_of_the_squared_impulse_response():
    for gain in (1.0, 4.0):
        loop = replace(RIG, gain=gain)
        response = impulse_response(loop, 4000)
        assert np.sum(response**2) == pytest.approx(noise_gain(loop) ** 2, rel=1e-9)


def test_a_constant_bias_reaches_the_eyes_in_full():
    # the axis moves against the bias: what is measured settles at zero
    assert impulse_response(RIG, 4000).sum() == pytest.approx(-1.0, abs=1e-9)


def test_delay_and_a_lower_rate_let_more_noise_through():
    assert noise_gain(RIG) > noise_gain(replace(RIG, delay_periods=0, lag_s=0.0))
    assert noise_gain(RIG.at_rate(30.0)) > noise_gain(RIG)


@pytest.mark.slow
def test_loops_that_run_scatter_as_much():
    head = load_head("simulated")
    loop = ClosedLoop(
        head=head, target={"kind": "static", "point": (0.0, -0.1, 1.0), "start": "fixation"},
        plant="kinematic", num=60, samples=600,
    )  # fmt: skip
    record = hold_gaze(loop)
    axis = record.true_pixels_at_exposure - head.cameras.principal
    noise = record.pixels - record.true_pixels_at_exposure
    # 60 heads x 4 axes x 5 s at 2 x 1.36 Hz are 3,300 independent values: 1.2 %
    assert axis.std() / noise.std() == pytest.approx(noise_gain(LinearLoop.of(head, 4.0)), rel=0.05)
